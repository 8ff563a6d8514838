#pragma once

#include <string>

#include "app/bench/bench_config.h"
#include "app/session/run_session.h"

namespace abcal {

/// What the bench file says that is allowed, but should be known.
void print_warnings(const BenchConfig& config);

/// Prints the result of a complete run on standard output.
/// @return what the program shall return to the shell.
int print_outcome(const RunOutcome& outcome, bool json);

}  // namespace abcal
