#pragma once

#include <cstdio>
#include <string>

namespace abcal {

/// Whether a person looks at this stream: colours and moving bars are for a terminal only.
bool is_terminal(std::FILE* stream);

enum class Emphasis { kNone, kGood, kWarning, kBad, kHeading };

/// `text` in a colour if `stream` is a terminal and NO_COLOR is not set, else as it is.
std::string emphasised(std::FILE* stream, Emphasis emphasis, const std::string& text);

}  // namespace abcal
