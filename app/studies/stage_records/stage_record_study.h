#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "app/studies/trials/error_group.h"

namespace abcal {

/// Experiments that measure better than one run of three circles (docs/theory/series.md).
enum class StageExperiment {
  kTwoFaces,         ///< Two faces, 6 x 36, one run.
  kTwoMountings,     ///< As it is and turned by 90 degrees about X, two faces, 6 x 18 each.
  kSixMountings,     ///< 3 x 12 each.
  kTwelveMountings,  ///< 3 x 24 each, on a stage that repeats.
  kWithRecord,       ///< A new item, 3 x 24, with the record that twelve mountings of another one taught.
  kTwoMountingsWithRecord,  ///< A new item in two mountings, two faces, 6 x 18 each, with that record.
  kYearLater,               ///< As kWithRecord, a year later on a stage that has changed slowly.
  kTwoMountingsAtRate,      ///< As it is and turned by 90 degrees about X, at 60 and 20 degrees/s each.
  kTwoThatDiffer,           ///< As kTwoMountings, of an item that changes by 1e-5 from run to run, as stated.
  kAtRateWithRecord,        ///< A new item at 60 and 20 degrees/s, with the record of twelve mountings.
  kTrayAtRateWithRecord,    ///< Eight new items in one run at 60 and 20 degrees/s, with that record.
};
inline constexpr std::size_t kStageExperiments = 11;

/// Groups of outputs: s, O, s_vz and s_wy in the frame of the stage, phi.
inline constexpr std::size_t kStageGroups = 4;
const std::array<std::string_view, kStageGroups>& stage_group_names();

struct StageRecordOptions {
  int stages = 1000;  ///< For each experiment a new stage, and a new record.
  int stages_at_rate =
      1000;  ///< So many of them, at most, for the experiments at constant rates, which take longest.
  std::uint64_t seed = 1;
  int threads = 1;
  std::stop_token stop = {};
  std::function<void(int done, int planned)> progress = {};
};

struct StageExperimentOutcome {
  StageExperiment experiment{};
  std::string words;
  int stages = 0;
  int failed = 0;  ///< Fits without a solution.
  std::array<ErrorGroup, kStageGroups> groups;
};

/// How often the test of a record contradicts it (docs/theory/series.md).
struct RecordAlarms {
  int sound = 0, sound_contradicted = 0;      ///< Runs on the stage of the record.
  int knocked = 0, knocked_contradicted = 0;  ///< Runs after a knock: the fine map has changed.
  int other = 0, other_contradicted = 0;      ///< Runs on another stage.
};

struct StageRecordStudy {
  int stages = 0;
  std::uint64_t seed = 0;
  bool interrupted = false;
  std::vector<StageExperimentOutcome> outcomes;
  RecordAlarms alarms;
  /// Groups whose z contradicts 1 at 5 % for all groups together (Holm).
  std::vector<std::string> contradictions() const;
  /// Groups whose uncertainty is larger than the figure of the design.
  std::vector<std::string> missed() const;
};

/// Simulates the experiments on stages drawn from the default sizes, with noise of 1e-5 a mean. The same for
/// any number of threads.
/// @throws std::invalid_argument no stages, no threads
StageRecordStudy run_stage_record_study(const StageRecordOptions& options);

}  // namespace abcal
