#include "app/operate/session/signing_key.h"

#include <fmt/format.h>

#include <cstdlib>
#include <stdexcept>

#include "app/ground/system/private_file.h"
#include "protocol/record/signature.h"

namespace abcal {

std::string read_signing_key() {
  const char* file = std::getenv("ABCAL_SIGNING_KEY");
  if (file == nullptr || *file == '\0') return {};
  std::string pem = read_private_file(file, "key");
  try {
    require_private_key(pem);
  } catch (const std::invalid_argument& problem) {
    throw std::invalid_argument(fmt::format("key {}: {}", file, problem.what()));
  }
  return pem;
}

}  // namespace abcal
