#pragma once

#include <string>
#include <string_view>
#include <vector>

/// Pieces of text that instruments and files send: cutting, no copies. Every layer may include this.
namespace abcal::pieces {

inline constexpr std::string_view kWhiteSpace = " \t\r\n";

constexpr bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

/// ASCII in lower case; other characters stay.
inline std::string lower(std::string_view text) {
  std::string out(text);
  for (char& c : out)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return out;
}

/// `text` without `blanks` at its ends.
inline std::string_view trimmed(std::string_view text, std::string_view blanks = kWhiteSpace) {
  const std::size_t first = text.find_first_not_of(blanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(blanks) - first + 1);
}

/// The parts between separators, empty ones included: one more than there are separators.
inline std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  for (;;) {
    const std::size_t end = text.find(separator);
    parts.push_back(text.substr(0, end));
    if (end == std::string_view::npos) return parts;
    text.remove_prefix(end + 1);
  }
}

/// The words between blanks, none empty.
inline std::vector<std::string_view> words(std::string_view text, std::string_view blanks = kWhiteSpace) {
  std::vector<std::string_view> found;
  for (std::size_t at = 0; (at = text.find_first_not_of(blanks, at)) != std::string_view::npos;) {
    const std::size_t end = text.find_first_of(blanks, at);
    found.push_back(text.substr(at, end - at));
    if (end == std::string_view::npos) break;
    at = end;
  }
  return found;
}

}  // namespace abcal::pieces
