#pragma once

#include <string>

namespace abcal {

/// Whether a person sits at the terminal, so that wait_for_enter() can be used.
bool is_person_at_terminal();

/// Prints a request on standard error and waits until a person at the terminal has pressed Enter.
/// @param when  for the message of an interrupt: "between two runs"
/// @throws RunInterrupted by an interrupt; std::runtime_error: the terminal was closed
void wait_for_enter(const std::string& request, const std::string& when);

}  // namespace abcal
