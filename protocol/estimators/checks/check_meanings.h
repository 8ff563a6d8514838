#pragma once

#include <string_view>

#include "drivers/text/message.h"

namespace abcal {

/// Check::name as a message: "drift of u"; bare for a name that no check has.
Message name_of_check(std::string_view check);

/// The question that a check of a result answers, as one sentence that holds whether it passed or failed.
/// @param check  Check::name: "mounting slip", "drift of u"
/// @return empty for a name that no check has
std::string_view meaning_of_check(std::string_view check);

/// The meaning of a flag of an angle, as one sentence.
/// @param flag  one flag in the words of describe_flags()
/// @return empty for words that no flag has
std::string_view meaning_of_flag(std::string_view flag);

}  // namespace abcal
