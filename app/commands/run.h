#pragma once

#include <cstddef>
#include <set>
#include <vector>

#include "app/bench_config.h"
#include "app/make_bench.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"

namespace abcal {

/// Measures what is missing, closes the run, analyses and prints. Shared by run, resume and replay.
/// @return what the program shall return to the shell.
int measure_and_report(Bench& bench, const BenchConfig& config, RunFile file,
                       const std::vector<PlannedAngle>& plan, const RunProgress& so_far, bool json);

}  // namespace abcal
