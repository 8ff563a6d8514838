#pragma once

#include <string>

namespace abcal {

/// Text that XML, HTML and a terminal accept: bytes that are not UTF-8 become U+FFFD, control characters but
/// line break and tab become blanks.
std::string valid_text(const std::string& text);

}  // namespace abcal
