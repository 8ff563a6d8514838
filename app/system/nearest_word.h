#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// The word that a person may have meant: the nearest of some by the number of characters that differ
/// (Levenshtein), if it is near enough to be a slip of the keyboard, or the only one that begins so. Empty:
/// none.
std::string nearest_word(std::string_view written, const std::vector<std::string>& words);

}  // namespace abcal
