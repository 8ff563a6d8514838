#pragma once

#include <optional>
#include <string>

namespace abcal {

/// A line that a person types at standard input, without its end. Signals end the program orderly from now on
/// (interrupt_token()).
/// @return nullopt if interrupted, or if standard input is at its end
std::optional<std::string> typed_line();

}  // namespace abcal
