#include "app/document/valid_text.h"

#include "app/document/json_text.h"

namespace abcal {

std::string valid_text(const std::string& text) {
  std::string valid = nlohmann::json::parse(json_text(nlohmann::json(text)));
  for (char& c : valid) {
    if (static_cast<unsigned char>(c) < 0x20 && c != '\n' && c != '\t') c = ' ';
  }
  return valid;
}

}  // namespace abcal
