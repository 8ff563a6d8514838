#pragma once

#include <string>

namespace abcal {

/// Text as XML, HTML and a terminal can hold it: what is not UTF-8 becomes U+FFFD, control characters but
/// line break and tab become blanks.
std::string valid_text(const std::string& text);

}  // namespace abcal
