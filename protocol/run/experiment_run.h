#pragma once

#include <cstddef>
#include <set>
#include <stdexcept>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/plan/run_config.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The run was stopped by a person; the stage was halted and the run file can be resumed.
class RunInterrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

enum class RunPhase { kHoming, kWarmingUp, kMoving, kSettling, kDwelling, kParking };
std::string_view to_string(RunPhase phase);

/// Told what a run does, while it does it. Must return at once: the hardware never waits for a screen.
class RunObserver {
 public:
  virtual ~RunObserver() = default;
  /// `position` is the index in the plan of the angle that is being worked on.
  virtual void phase(std::size_t position, RunPhase phase) = 0;
  virtual void dwell(std::size_t position, const DwellRecord& dwell) = 0;
  /// Something a person should know; it is in the run file too.
  virtual void notice(std::string_view text) = 0;
};

/// The instruments of a run, and the time they live in.
struct RunInstruments {
  RotationStage& stage;
  Accelerometer& accelerometer;
  Clock& clock;
};

/// Measures every angle of `plan` that is not in `measured`, each committed to `file` before the stage moves
/// on; then parks the stage at zero and stops the accelerometer. References the axes first where that is
/// needed.
///
/// Whatever ends it early, the stage is halted, the accelerometer stopped, and the run left interrupted with
/// the reason in its file.
/// @throws InstrumentError (its text says if the stage did not acknowledge the halt), RunFileError,
/// RunInterrupted.
/// @return where the time went, `already_spent` included.
RunTiming run_experiments(const RunInstruments& instruments, const std::vector<PlannedAngle>& plan,
                          const std::set<std::size_t>& measured, const ProtocolConfig& protocol,
                          const LimitsConfig& limits, RunTiming already_spent, RunFile& file,
                          RunObserver& observer, const std::stop_token& stop);

}  // namespace abcal
