#pragma once

#include <Eigen/Core>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <vector>

#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_file.h"
#include "protocol/run/run_context.h"
#include "protocol/run/run_instruments.h"
#include "protocol/run/run_observer.h"

namespace abcal {

/// Measurements that an interrupted run already contains; empty for a new run.
struct RunProgress {
  std::set<std::size_t> measured;  ///< Positions in the plan.
  RunTiming spent;
  /// The latest angle that is suitable for a comparison. It is measured again before the run continues, after
  /// both axes were homed again. Tolerances, noise and drift must explain any change of its readings (false
  /// alarm: once in 1e6).
  struct LastAngle {
    std::size_t position = 0;
    std::map<int, DwellRecord> dwells;  ///< By number of the item.
  };
  std::optional<LastAngle> last;
  /// Temperatures at the first angle, by number of the item, if it is measured already.
  std::map<int, double> first_temperatures_degc;
};

/// The plan of a run, its settings and the angles measured already.
struct RunTask {
  const std::vector<PlannedAngle>& plan;
  RunSettings settings;
  RunProgress so_far;
};

/// Whether a repetition of the angle can show that the accelerometer has moved: not if an output was stuck,
/// clipped or not finite, because that dwell is already known to be wrong.
bool can_be_compared_with(const DwellRecord& dwell);

/// The largest change of an output (R) between two measurements of one angle that tolerances (zero and step
/// of the axes), noise and drift explain: kFalseAlarmDeviate standard uncertainties of the change.
Eigen::Vector3d explained_change(const DwellRecord& before, const DwellRecord& after,
                                 const Tolerances& tolerances);

/// Measures every angle of the plan that is not in `task.so_far.measured`, each committed to `file` before
/// the stage moves on; then parks the stage at zero and stops the accelerometer. Homes the axes first where
/// that is needed.
///
/// An angle is measured again (limits: repeats) where the readings spread or creep more than usual, an output
/// does not change at all, or an axis has left the position window; then it is flagged, or the run ends where
/// the axis does not stay. If the temperature is outside its limits, the run waits (temperature_wait_s).
///
/// If a port vanishes, waits for it (limits: replug_timeout_s, max_replugs), and continues as after an
/// interruption: same instruments, the axes homed again if the stage was lost, the last angle measured
/// again and compared, the angle under way repeated.
///
/// If one of several items sends no more readings, or its port does not return, it is dropped, and the run
/// continues with the others. Readings of any item that cannot be true, or contradict gravity, end the run.
///
/// If the run ends early, the stage is halted, the accelerometer stopped, and the run left interrupted with
/// the reason in its file: the first cause, also where a halt made the call under way fail.
/// @throws InstrumentError (its text reports if the stage did not acknowledge the halt), RunFileError,
/// RunInterrupted.
/// @return the time spent on each activity, `task.so_far.spent` included.
RunTiming run_experiments(const RunInstruments& instruments, const RunTask& task, RunFile& file,
                          RunObserver& observer, const std::stop_token& stop);

}  // namespace abcal
