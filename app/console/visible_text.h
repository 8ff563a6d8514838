#pragma once

#include <string>
#include <string_view>

namespace abcal::console {

/// Whether a text has characters that change the direction of writing (Unicode's Bidi_Control): with them it
/// looks different from its contents.
bool has_direction_controls(std::string_view utf8);

/// A text in which these characters are shown: "[U+202E]".
std::string with_visible_direction_controls(std::string_view utf8);

}  // namespace abcal::console
