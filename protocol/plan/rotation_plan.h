#pragma once

#include <array>
#include <cstddef>
#include <stdexcept>
#include <vector>

#include "drivers/instrument/angle.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// From where to where an axis may be commanded.
struct AxisTravel {
  Angle min = Angle::degrees(-360.0);
  Angle max = Angle::degrees(360.0);
};

/// One of the two poses at which every output sees 1/sqrt 3 of gravity, of either sign: g along (1, 1, 1) and
/// against it. Measured at the start, between the experiments and at the end (`[protocol] check_poses`), they
/// show a change of the gain or the offset of any output, even if the present experiment does not.
struct CheckPose {
  Angle x, z;
};
inline constexpr int kCheckPoses = 2;
/// Before modulo a turn: (54.7356, 45) and (234.7356, 45) degrees.
std::array<CheckPose, kCheckPoses> check_poses();

/// One angle of the plan. The commanded angles are alpha, or the other axis's initial turn, moved by whole
/// turns into the axis's travel.
struct PlannedAngle {
  int experiment = 0;    ///< 1, 2, 3 as in the paper; 0: a pose of no experiment.
  int n = 0;             ///< 1..N; the closing angle repeats the n of the first angle that was measured.
  bool closing = false;  ///< Measured last in its experiment, one turn after its first angle.
  Angle alpha;           ///< Desired rotation angle, (n-1) D; + 360 degrees at the closing angle.
  Angle x, z;            ///< Commanded angles.
  bool check = false;    ///< A check pose: experiment 0, n = 1 or 2, alpha = 0.
  int face = 1;          ///< 1 or 2 (protocol/plan/faces.h).
  /// Number of the sweep in its circle, from 1, in which the stage passes the angle; 0: at rest.
  int sweep = 0;
  double rate_deg_per_s = 0.0;  ///< That of the sweep; below zero: towards lower angles.

  /// The axis that turns in the experiment: 0 for X, 1 for Z.
  std::size_t turning_axis() const { return experiment == 3 ? 1 : 0; }
  Angle turning() const { return turning_axis() == 1 ? z : x; }
};

/// One past the last position of the sweep to which the angle at `position` belongs; position + 1 for an
/// angle at rest.
std::size_t end_of_sweep(const std::vector<PlannedAngle>& plan, std::size_t position);

/// Fewest readings of a step in a sweep that a plan accepts.
inline constexpr double kLeastReadingsOfStep = 8.0;
/// Readings that fall on a step that the stage passes at a rate of either sign.
double readings_of_step(const ProtocolConfig& config, double rate_deg_per_s, double rate_hz);

/// From where to where the axis is turned in a sweep: over all its steps, with the way that it needs to reach
/// its rate and to leave it, a quarter of a second at that rate before the first step, and the way that the
/// next sweep of the circle needs before its own.
struct SweepTravel {
  Angle from, to;
};
/// Whether a sweep can begin at the present position: at its beginning, or before it by less than a move
/// there would need.
bool can_sweep_from(Angle at, const SweepTravel& way, double rate_deg_per_s);
SweepTravel sweep_travel(const PlannedAngle& first, const PlannedAngle& last, const ProtocolConfig& config);

/// Whether angles of the second face are among them.
bool has_two_faces(const std::vector<PlannedAngle>& plan);

/// Whether angles of experiments 1 to 3 are among them. A levelling has none; its angles are not check poses.
bool has_experiments(const std::vector<PlannedAngle>& plan);

/// Reports every reason why a run cannot be planned.
class PlanError : public std::runtime_error {
 public:
  explicit PlanError(std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// The angles of the three experiments (paper, section 2.4: about X; about X with Z turned -90 degrees; about
/// Z with X turned -90 degrees) in the order in which they are measured: each experiment in one sweep of
/// rising commanded angle, inside the travel with room for the approach from below, so that no cable winds
/// up. With two faces (protocol/plan/faces.h) an experiment is two such sweeps, one for each face. With
/// `check_poses`, both check poses come first, between the experiments and last. The order of the
/// two and the whole turns of an axis that is held are those with which the axes turn least.
/// @throws PlanError if an angle cannot be reached; with two faces also for an odd number of steps.
std::vector<PlannedAngle> make_rotation_plan(const ProtocolConfig& config,
                                             const std::array<AxisTravel, 2>& travel);

/// How far each axis (X, Z) turns away from its zero, the approaches from below included: its cables must
/// reach this far. The stage starts and is parked at zero, and the travel bounds both ends, so no turn is
/// ever added to another.
std::array<AxisTravel, 2> cable_twist(const std::vector<PlannedAngle>& plan, const ProtocolConfig& config);

/// How long a plan takes, in seconds.
struct PlanDuration {
  double moving_s = 0.0;
  double settling_s = 0.0;
  double dwelling_s = 0.0;
  double total_s() const { return moving_s + settling_s + dwelling_s; }
};

/// How fast an axis turns. 0: not known.
struct AxisSpeed {
  double deg_per_s = 0.0;
  double deg_per_s2 = 0.0;  ///< Acceleration, and deceleration.

  /// Duration of one move; 0 where the speed is not known. Without acceleration it starts and stops at once.
  double duration_s(double distance_deg) const;
};

/// An estimate from the speeds of X and Z and the reading rate.
PlanDuration estimate_duration(const std::vector<PlannedAngle>& plan, const ProtocolConfig& config,
                               const std::array<AxisSpeed, 2>& speed, double rate_hz);

/// Readings averaged at one angle: dwell_readings, or the least number not below it that lasts a whole number
/// of mains periods.
int readings_per_dwell(const ProtocolConfig& config, double rate_hz);

/// Readings in one window that is tested for slope and spread before a dwell.
std::size_t quiet_window_size(const ProtocolConfig& config, double rate_hz);

/// With settle_s = "auto", the time from the stop to the end of visible motion is multiplied by this before a
/// dwell begins.
inline constexpr double kSettlingPatience = 2.0;

/// From the stop to the first reading used where all is quiet at once, in seconds: settle_s, or with "auto"
/// one window.
double least_settle_s(const ProtocolConfig& config, double rate_hz);

}  // namespace abcal
