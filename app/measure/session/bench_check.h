#pragma once

#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/session/session_events.h"
#include "app/measure/session/small_turn.h"

namespace abcal {

/// One check of `abcal check` and its outcome.
struct Finding {
  enum class Grade { kGood, kWarning, kProblem, kLeftOut };
  Grade grade = Grade::kGood;
  Message what;    ///< "stage", "travel", "noise at rest", ...; of several items with its number.
  Message found;   ///< With units.
  Message advice;  ///< Recommended action; empty: none.
};

/// Finding::what of the comparison of an item with what its instrument reports.
inline constexpr Term kItemFinding = "item";
/// Finding::what of the comparison of signs and axes with gravity.
inline constexpr Term kSignsFinding = "signs and axes";

/// "good", "warning", "problem", "left out"
std::string_view to_string(Finding::Grade grade);

struct CheckOptions {
  bool no_motion = false;
  /// Receives the events of the small turn, which is measured as a run (RunBeganEvent without a file); may be
  /// empty.
  SessionListener listener;
  std::stop_token stop;  ///< Halts the stage and ends the check.
};

/// Talks to both instruments of a bench: identity, whether the item is the one of the bench file, travel
/// against the plan, speed, reference, readings at rest, rate, and (unless `no_motion`) a small turn of both
/// axes, which shows whether signs and axes agree with gravity. The stage ends at zero, or halted.
/// @throws RunInterrupted; an instrument that fails is a finding.
std::vector<Finding> check_bench(Bench& bench, const BenchConfig& config, const CheckOptions& options);

/// Checks whether the readings change between poses as gravity requires of an accelerometer whose u, v, w
/// point roughly along the platter's x, y, z. If not, names every simple reason that would explain them: a
/// sign of a stage axis, swapped or reversed accelerometer axes. The first pose is the one compared with.
Finding judge_signs(const std::vector<PoseReading>& poses);

}  // namespace abcal
