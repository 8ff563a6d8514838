#pragma once

#include <array>

#include "drivers/instrument/angle.h"
#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// How fast one axis may go.
struct MotionLimits {
  double speed_deg_per_s = 20.0;
  double acceleration_deg_per_s2 = 80.0;
  double deceleration_deg_per_s2 = 80.0;
};

/// One commanded motion of one axis: constant acceleration to the speed, cruise, constant deceleration to
/// rest at the target (trapezoidal, or triangular where the way is short). It may start while still moving.
class AxisMotion {
 public:
  /// Always at rest at `position`.
  explicit AxisMotion(Angle position = {}, Clock::Instant since = {});

  /// From `position` with `velocity_deg_per_s` at `start` to rest at `target`.
  /// @throws std::invalid_argument if the target is not finite or a limit is not positive.
  static AxisMotion move(Clock::Instant start, Angle position, double velocity_deg_per_s, Angle target,
                         const MotionLimits& limits);

  /// From `position` with `velocity_deg_per_s` at `start` to rest as soon as the deceleration allows.
  static AxisMotion halt(Clock::Instant start, Angle position, double velocity_deg_per_s,
                         const MotionLimits& limits);

  /// A fault: from `instant` on the axis does not move on, yet is never done.
  void stall_at(Clock::Instant instant);

  Angle position(Clock::Instant t) const;
  double velocity_deg_per_s(Clock::Instant t) const;
  bool moving(Clock::Instant t) const { return t < end_; }

  Clock::Instant start() const { return start_; }
  Clock::Instant end() const { return end_; }                  ///< Instant::max() once stalled.
  Clock::Instant planned_end() const { return planned_end_; }  ///< End of the motion if it never stalled.
  Angle target() const { return target_; }
  double peak_speed_deg_per_s() const { return peak_speed_; }
  /// +1 or -1: the sense in which the motion ends; 0: it did not move.
  int direction() const { return direction_; }

 private:
  struct Phase {
    double duration_s = 0.0;
    double position_deg = 0.0;  ///< At its start.
    double velocity = 0.0;      ///< deg/s, at its start.
    double acceleration = 0.0;  ///< deg/s2
  };
  struct State {
    double position_deg;
    double velocity;
  };
  State state_at(Clock::Instant t) const;
  void add_phase(double duration_s, double acceleration);

  Clock::Instant start_;
  Clock::Instant end_;
  Clock::Instant planned_end_;
  Clock::Instant stalled_since_ = Clock::Instant::max();
  Angle start_position_;
  double start_velocity_ = 0.0;
  Angle target_;
  std::array<Phase, 4> phases_{};
  int phase_count_ = 0;
  double peak_speed_ = 0.0;
  int direction_ = 0;
};

}  // namespace abcal::sim
