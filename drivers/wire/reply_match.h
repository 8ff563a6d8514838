#pragma once

#include <string_view>

#include "drivers/instrument/reply_pattern.h"

namespace abcal::wire {

// The time for both grows with the parts of the pattern and the bytes of the reply; the memory is constant.

/// Whether the whole reply fits the pattern. A reply of more than kLongestHaltReply bytes does not.
bool matches(const ReplyPattern& pattern, std::string_view reply) noexcept;

/// Whether any part of the bytes fits the pattern, wherever it begins and ends. Only the newest (last)
/// kLongestHaltReply bytes count.
bool occurs_in(const ReplyPattern& pattern, std::string_view bytes) noexcept;

}  // namespace abcal::wire
