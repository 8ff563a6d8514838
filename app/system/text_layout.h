#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// Width of a terminal for which the program's first screen is made, in columns.
inline constexpr std::size_t kTerminalColumns = 80;

/// Columns that a UTF-8 text takes on a terminal: two for a wide character (Chinese, Japanese, Korean), none
/// for one that combines with the character before it.
std::size_t display_width(std::string_view text);

/// Fills the text with blanks to `width` columns; a longer text is returned as it is.
std::string padded(std::string_view text, std::size_t width, bool to_the_right = false);

enum class LongWords {
  kKeep,   ///< A word that is longer than the line stays whole: names of files, hashes.
  kBreak,  ///< It continues on the next line.
};

/// The words of a text in lines of at most `width` columns; at least one line.
std::vector<std::string> lines_of(std::string_view text, std::size_t width,
                                  LongWords long_words = LongWords::kKeep);

/// The words of a text in lines that end with "\n" and are at most `width` columns wide, their beginnings
/// included.
/// @param first, next  beginning of the first and of every other line; `next` is at least as wide
std::string wrapped(std::string_view text, const std::string& first, const std::string& next,
                    std::size_t width, LongWords long_words = LongWords::kKeep);

}  // namespace abcal
