#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace abcal {

/// A line that is not TOML, explained.
struct TomlMistake {
  std::string found;     ///< "a decimal comma"
  std::string required;  ///< "a decimal point"
  /// The line as it may be meant. Empty: no guess. A line of white space: the line is to be removed.
  std::string corrected;
};

/// Explains a line at which a parser of TOML stopped, by what people write who know other formats: decimal
/// commas, typographic quotes, True, text without quotes, a unit behind a number, a colon in place of the
/// equals sign, backslashes, sections without their bracket.
/// @param line  without its line break
/// @param column  at which the parser stopped, in bytes from 0
/// @param is_second  the parser found a key or a section for the second time
TomlMistake explain_toml_mistake(std::string_view line, std::size_t column, bool is_second);

}  // namespace abcal
