#pragma once

#include <string>

#include "app/faces/commands/terminal_listener.h"
#include "app/faces/run/run_session.h"
#include "app/ground/bench_file/bench_config.h"

namespace abcal {

/// Prints the warnings of a bench file: accepted, but unusual.
void print_warnings(const BenchConfig& config);

/// A session whose events are shown at the terminal; Ctrl-C stops it. `terminal` must outlive the session.
RunSession::Options session_options(TerminalListener& terminal);

/// Prints the result of a complete run on standard output.
/// @return the exit code of the program.
int print_outcome(const RunOutcome& outcome, bool json);

/// As session_options(); prints the result of the run as soon as it is known, and sets `exit_code`.
RunSession::Options printing_session_options(TerminalListener& terminal, bool json, int& exit_code);

}  // namespace abcal
