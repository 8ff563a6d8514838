#include "app/system/input_file.h"

#include <fstream>
#include <sstream>
#include <stdexcept>

namespace abcal {

std::string bytes_of_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream bytes;
  bytes << file.rdbuf();
  // An empty file leaves nothing to insert, which is no error.
  if (!file.is_open() || file.bad())
    throw std::invalid_argument(path.string() + ": no such file, or it cannot be read");
  return bytes.str();
}

}  // namespace abcal
