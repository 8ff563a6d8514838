#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace abcal {

/// The text of a JSON value, on one line unless it is indented. Bytes that are not UTF-8, which an instrument
/// or a person may have sent, become U+FFFD.
template <class Json = nlohmann::json>
std::string json_text(const Json& json, int indent = -1) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

}  // namespace abcal
