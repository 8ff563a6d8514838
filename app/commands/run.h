#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/bench/bench_config.h"
#include "app/bench/make_bench.h"
#include "app/bench/transcript.h"
#include "app/session/run_bench.h"
#include "protocol/analysis/calibration_result.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"

namespace abcal {

void print_warnings(const BenchConfig& config);

/// Says on standard error who is there and how long it will take.
/// @throws PlanError
std::vector<PlannedAngle> plan_and_introduce(const Bench& bench, const BenchConfig& config,
                                             const Identities& who);

/// Creates the file of a run and notes in it that it begins, and the environment. `transcript`, if given,
/// keeps the bytes of the instruments in it.
RunFile begin_run(Bench& bench, const BenchConfig& config, const Identities& who,
                  const std::vector<PlannedAngle>& plan, const std::filesystem::path& path,
                  Transcript* transcript);

/// An interrupted run, opened to go on.
struct InterruptedRun {
  RunFile file;
  StoredRun stored;
  BenchConfig config;  ///< With what it was begun, as it stands in the file.
  RunProgress so_far;
};
/// @throws RunFileError if it is closed, or being written.
InterruptedRun open_interrupted_run(const std::filesystem::path& path);

/// Identifies the instruments, compares them with those of the run, and marks it as running again.
/// @throws InstrumentError kWrongIdentity
void continue_run(InterruptedRun& run, Bench& bench);

/// A closed run and what its analyses say.
struct FinishedRun {
  std::string sha256;
  StoredRun stored;
  std::vector<CalibrationResult> results;  ///< One an estimator, in the order of kEstimators.
};
/// Closes a run whose angles are all measured, analyses it and keeps the analyses beside it.
FinishedRun finish_run(Bench& bench, const BenchConfig& config, RunFile file, const RunTiming& timing);

/// Where every angle is measured, but the program ended before it had closed the run and analysed it: does
/// so.
/// @return nothing if there is nothing left to be done so.
std::optional<FinishedRun> finish_killed_run(const std::filesystem::path& path);

/// Measures what is missing, closes the run, analyses and prints. Shared by run, resume and replay.
/// @return what the program shall return to the shell.
int measure_and_report(Bench& bench, const BenchConfig& config, RunFile file,
                       const std::vector<PlannedAngle>& plan, const RunProgress& so_far, bool json);

}  // namespace abcal
