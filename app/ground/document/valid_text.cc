#include "app/ground/document/valid_text.h"

#include <nlohmann/json.hpp>

namespace abcal {

std::string valid_text(const std::string& text) {
  using Json = nlohmann::json;
  std::string valid = Json::parse(Json(text).dump(-1, ' ', false, Json::error_handler_t::replace));
  for (char& c : valid) {
    if (static_cast<unsigned char>(c) < 0x20 && c != '\n' && c != '\t') c = ' ';
  }
  return valid;
}

}  // namespace abcal
