#pragma once

#include <charconv>
#include <optional>
#include <string_view>
#include <system_error>

namespace abcal::pieces {

/// The number that all of a text is, as std::from_chars() reads it: without blanks, and with no sign but "-".
/// @param how  a base, or a std::chars_format
template <class Number, class... How>
std::optional<Number> number(std::string_view text, How... how) {
  Number value{};
  const char* const end = text.data() + text.size();
  const auto [stopped, error] = std::from_chars(text.data(), end, value, how...);
  return error == std::errc() && stopped == end ? std::optional(value) : std::nullopt;
}

/// `text` without its plus sign; "+-1" keeps it, and is no number.
inline std::string_view without_plus(std::string_view text) {
  return text.starts_with('+') && !text.starts_with("+-") ? text.substr(1) : text;
}

}  // namespace abcal::pieces
