#pragma once

#include <string_view>

namespace abcal {

/// What a check of a result asks, in a sentence for its reader, whether it passed or failed.
/// @param check  Check::name: "mounting slip", "drift of u"
/// @return empty for a name that no check has
std::string_view meaning_of_check(std::string_view check);

/// What a flag says of an angle, in a sentence.
/// @param flag  one flag in the words of describe_flags()
/// @return empty for words that no flag has
std::string_view meaning_of_flag(std::string_view flag);

}  // namespace abcal
