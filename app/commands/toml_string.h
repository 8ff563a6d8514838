#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace abcal {

/// A string of TOML: the escapes of JSON are among those of TOML.
/// @param not_utf8  treatment of bytes that are not UTF-8
/// @throws nlohmann::json::type_error for them, if `not_utf8` is strict
inline std::string toml_string(const std::string& text, nlohmann::json::error_handler_t not_utf8 =
                                                            nlohmann::json::error_handler_t::strict) {
  return nlohmann::json(text).dump(-1, ' ', false, not_utf8);
}

}  // namespace abcal
