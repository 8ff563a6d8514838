#pragma once

#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/commands/terminal_listener.h"
#include "app/measure/session/bench_check.h"

namespace abcal {

/// A progress bar for the small turn, and nothing else.
TerminalListener::Options small_turn_at_terminal();

/// Checks the bench as `abcal check` does, with a progress bar while it turns.
/// @throws RunInterrupted, InstrumentError if a port cannot be opened
std::vector<Finding> check_at_terminal(const BenchConfig& config, bool no_motion);

/// Prints the findings and the verdict as text. @return the exit code
int print_findings(const std::vector<Finding>& findings);

}  // namespace abcal
