#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"
#include "protocol/plan/limits.h"

namespace abcal {

/// One mistake in a bench file, a plan or an imported file, described so that a person can correct it.
struct Problem {
  std::string where;        ///< "line 12, [protocol] steps", "axis X".
  std::string found;        ///< The text or value that was found.
  std::string required;     ///< The required value, or the action to take.
  std::string excerpt{};    ///< The line of the file, if it has one.
  std::size_t column{0};    ///< The place in the excerpt, in characters from 1; 0: none.
  std::string corrected{};  ///< The line as it may be meant; empty: no guess.
};

/// "line 12, [protocol] steps: found 2; required: 3 to 3600".
std::string to_string(const Problem& problem);

/// The problems of a file one below the other, indented, each with its line, a caret below the place, and the
/// line as it may be meant. Begins with a line break, unless there are none.
std::string list_of(const std::vector<Problem>& problems);

/// The estimators by name; the program has one entry for each (app/results/analysis/estimators).
inline constexpr std::array<std::string_view, 3> kEstimatorNames{"abc", "joint", "norm"};
/// Name of the chosen estimator's entry in a run file and a CSV.
inline constexpr std::string_view kEstimatorLabel = "protocol.estimator";
/// The estimator whose result is the result of a run, unless `[protocol] estimator` names another.
inline constexpr std::string_view kDefaultEstimator = "joint";
/// The published protocol: for records that do not name an estimator.
inline constexpr std::string_view kPublishedEstimator = "abc";

/// The ways in which an experiment can be measured, by name (`[protocol] motion`): the stage stops at each
/// angle, or it turns through each circle at a constant rate (docs/constant_rate.md).
inline constexpr std::array<std::string_view, 2> kMotionNames{"steps", "constant_rate"};

/// The order in which the axes move from one angle to the next.
enum class AxesOrder {
  kXThenZ,    ///< X moves and stops, then Z.
  kTogether,  ///< Both move at once.
};
/// "x then z", "together": as run files and tables write it.
std::string_view to_string(AxesOrder order);
/// @return nothing for any other word
std::optional<AxesOrder> axes_order_named(std::string_view word);

/// How the three rotation experiments are measured (`[protocol]` of a bench file). Times in seconds.
struct ProtocolConfig {
  int steps = 72;                    ///< N, angles of each experiment.
  Angle step = Angle::degrees(5.0);  ///< D, desired rotation step.
  /// 1: the published protocol; 2: half the angles of each experiment in each of two faces
  /// (protocol/plan/faces.h). N is then even.
  int faces = 1;
  std::string motion{kMotionNames[0]};
  /// Constant rate: those of the sweeps of a circle in their order, up and down in turn; where there are more
  /// sweeps, the list begins again.
  std::vector<double> rate_deg_per_s{60.0, 20.0};
  int sweeps = 2;  ///< Constant rate: sweeps of each circle.
  int stops = 0;   ///< Constant rate: dwells at rest in each circle, evenly spaced.
  /// Constant rate: with which the stage starts and ends a sweep.
  double acceleration_deg_per_s2 = 80.0;
  bool closing_angle = true;  ///< Measure the first angle again, at alpha + 360 degrees.
  bool check_poses = true;    ///< Measure two poses at the start, between experiments and at the end.
  /// "abc", "joint", "norm": chosen before the first angle, so that the choice cannot depend on the result.
  std::string estimator{kDefaultEstimator};
  Angle approach = Angle::degrees(1.0);  ///< Every angle is reached from below, by this much; 0: either side.
  Angle position_window = Angle::degrees(0.01);  ///< Largest distance of the encoder from the command.
  int window_polls = 3;                          ///< Consecutive polls that must find it stopped and inside.
  double poll_interval_s = 0.01;
  double motion_timeout_s = 30.0;  ///< Longest wait for a move beyond the time its speed needs.
  double homing_timeout_s = 120.0;
  double settle_s = 5.0;  ///< From stopped to the first reading used.
  /// settle_s = "auto": the dwell begins when the outputs show that the item is at rest; settle_s is not
  /// used.
  bool settle_auto = false;
  double quiet_timeout_s = 10.0;    ///< Longest further wait for the accelerometer to be quiet; then flagged.
  int dwell_readings = 1000;        ///< Readings averaged at one angle.
  double mains_hz = 0.0;            ///< > 0: the dwell lasts a whole number of mains periods.
  double reading_timeout_s = 2.0;   ///< An accelerometer without any reading for this time counts as silent.
  double warm_up_s = 0.0;           ///< Waited, with everything on, before the first angle.
  double replug_timeout_s = 120.0;  ///< Longest wait for the return of a port that vanished.
  double stability_s = 0.0;  ///< Outputs and temperature must be stable for this time before the first angle.
  double stability_timeout_s = 3600.0;  ///< Longest wait for that.

  bool is_constant_rate() const { return motion == kMotionNames[1]; }
  bool operator==(const ProtocolConfig&) const = default;
};

}  // namespace abcal
