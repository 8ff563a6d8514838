#pragma once

#include <string>
#include <string_view>

namespace abcal {

/// A text as one word of a shell: the whole text in single quotes.
inline std::string shell_word(const std::string& text) {
  std::string word = "'";
  for (const char c : text) word += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return word + "'";
}

/// A word of a command as a person would type it: quoted only where a shell would read it otherwise.
inline std::string typed_word(const std::string& text) {
  constexpr std::string_view kPlain = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./:+-,";
  return text.find_first_not_of(kPlain) == std::string::npos && !text.empty() ? text : shell_word(text);
}

}  // namespace abcal
