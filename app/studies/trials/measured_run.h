#pragma once

#include <cstdint>
#include <vector>

#include "protocol/plan/run_config.h"
#include "protocol/record/run_record.h"
#include "sim/bench_truth.h"
#include "sim/sim_bench.h"

namespace abcal {

/// One item on a simulated bench of a study.
struct StudyItem {
  sim::OutputTruth truth;
  EffectSizes sizes;
  ExpectedItem expected{};
  LimitsConfig limits{};
  double reading_hz = 100.0;
};

/// A bench of a study: simulated instruments at their driver interfaces, without bytes.
struct StudyBench {
  sim::StageTruth stage;
  ProtocolConfig protocol;
  std::vector<StudyItem> items;
};

/// A whole run, as it would be stored.
struct MeasuredRecords {
  std::vector<RunRecord> items;
  /// The measurand of each item, its mean over the time from the first angle to the last.
  std::vector<sim::TrueLineResponse> truths;
  double time_s = 0.0;  ///< From the first move to the park position.
};

/// Measures a bench as `abcal run` does, in simulated time, through a temporary run file.
/// @param number  of the bench, for the name of that file: another one for each at a time
MeasuredRecords measure_bench(const StudyBench& bench, std::uint64_t number);

}  // namespace abcal
