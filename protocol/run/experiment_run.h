#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
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
#include "protocol/plan/tolerances.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The run was stopped by a person; the stage was halted and the run file can be resumed.
class RunInterrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

enum class RunPhase {
  kHoming,
  kWarmingUp,
  kHolding,
  kMoving,
  kSettling,
  kDwelling,
  kTemperature,
  kReconnecting,
  kParking
};
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
  /// Asked between two angles, and again and again while it says so: the stage stays where it is.
  virtual bool hold_wanted() { return false; }
};

/// Opens the ports of a run again that vanished: a cable was pulled, a hub reset itself.
class Reconnector {
 public:
  virtual ~Reconnector() = default;
  /// Whether the stage is one of those that are gone.
  virtual bool stage_lost() const = 0;
  /// Opens what is gone, with drivers that know nothing yet of their instruments.
  /// @throws InstrumentError kCannotOpen, kLinkLost: not back yet; what is back stays open.
  virtual void reconnect() = 0;
};

/// The instruments of a run, and the time they live in.
struct RunInstruments {
  RotationStage& stage;
  Accelerometer& accelerometer;
  Clock& clock;
  Reconnector* reconnector = nullptr;  ///< Null: a port that vanishes ends the run.
};

/// What a run may rely on: what it holds already if it was interrupted, and how well the stage finds back.
struct RunProgress {
  std::set<std::size_t> measured;  ///< Positions in the plan.
  RunTiming spent;
  /// The angle measured last of those that can be compared with. It is measured again before the run goes on,
  /// after both axes were referenced anew, and must read the same within what tolerances, noise and drift
  /// explain at a false alarm in 1e6.
  struct LastAngle {
    std::size_t position = 0;
    DwellRecord dwell;
  };
  std::optional<LastAngle> last;
  Tolerances tolerances;
  // What the readings are compared with (protocol/run/plausibility.h).
  ExpectedItem expected;
  double g_loc_mps2 = kStandardGravity;
  std::optional<double> first_temperature_degc;  ///< Of the first angle, if it is measured already.
};

/// Whether an angle tells, when it is measured again, if the accelerometer has moved: not one where an output
/// was stuck, clipped or not finite, which is marked and wrong already.
bool can_be_compared_with(const DwellRecord& dwell);

/// The largest change of an output (R) between two measurements of one angle that tolerances (zero and step
/// of the axes), noise and drift explain, at a false alarm in 1e6: 4.9 standard uncertainties of the change.
Eigen::Vector3d explained_change(const DwellRecord& before, const DwellRecord& after,
                                 const Tolerances& tolerances);

/// Measures every angle of `plan` that is not in `so_far.measured`, each committed to `file` before the stage
/// moves on; then parks the stage at zero and stops the accelerometer. References the axes first where that
/// is needed.
///
/// An angle is measured again (limits: repeats) where the readings spread or creep more than usual, an output
/// does not change at all, or an axis has left the position window; then it is flagged, or the run ends where
/// the axis does not stay. Beyond its limits the temperature is waited for (temperature_wait_s).
///
/// Where a port vanishes, waits for it (limits: replug_timeout_s, max_replugs), and goes on as after an
/// interruption: same instruments, the stage referenced anew if it was the stage's, the last angle measured
/// again and compared, the angle under way repeated.
///
/// Whatever ends it early, the stage is halted, the accelerometer stopped, and the run left interrupted with
/// the reason in its file.
/// @throws InstrumentError (its text says if the stage did not acknowledge the halt), RunFileError,
/// RunInterrupted.
/// @return where the time went, `so_far.spent` included.
RunTiming run_experiments(const RunInstruments& instruments, const std::vector<PlannedAngle>& plan,
                          const RunProgress& so_far, const ProtocolConfig& protocol,
                          const LimitsConfig& limits, RunFile& file, RunObserver& observer,
                          const std::stop_token& stop);

}  // namespace abcal
