#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// An encoder angle, at the middle between the question and its answer.
struct AngleSample {
  Clock::Instant at;
  double angle_deg = 0.0;
};

/// Moves the axes of the stage to the angles of the plan and waits until they are at rest there: every angle
/// is approached from below, and the encoder must stay inside the position window.
class Motion {
 public:
  /// Both must outlive this.
  Motion(RunContext& context, RotationStage& stage) : context_(context), stage_(stage) {}

  /// Searches the reference of an axis and waits until it is found.
  /// @throws InstrumentError kStalled after homing_timeout_s, kNotReady: not found. RunInterrupted.
  void home(StageAxis axis);

  /// Turns an axis to an angle, from below (a worm drive has backlash), and waits until it is at rest inside
  /// the window.
  /// @return when it was first found there; nullopt if it was there already.
  /// @throws InstrumentError kStalled: it did not arrive, or stopped outside the window. RunInterrupted.
  std::optional<Clock::Instant> move_to(StageAxis axis, Angle target);

  /// Turns an axis at a rate to an angle and waits until it is at rest there. The acceleration belongs to the
  /// turn. @param look  called between two questions to the encoder
  /// @return the encoder's angles while it turned
  /// @throws InstrumentError as move_to(); kRefused: the stage cannot turn at this rate
  std::vector<AngleSample> sweep(StageAxis axis, Angle target, double rate_deg_per_s,
                                 const std::function<void()>& look);

  /// The positions of the axes are no longer known: the next move_to() moves even to the same angle.
  void forget_positions() { known_.fill(std::nullopt); }

  /// Whether both encoder angles are inside the position window around the commanded angles.
  bool is_inside_window(const PlannedAngle& angle, Angle encoder_x, Angle encoder_z) const;
  /// By the present encoder angles.
  bool is_inside_window(const PlannedAngle& angle);

  Angle encoder_angle(StageAxis axis) { return stage_.encoder_angle(axis); }

 private:
  struct Move {
    StageAxis axis;
    Angle target;
    Angle window;
    int polls = 1;  ///< This many in a row must find the axis stopped inside the window.
  };
  Clock::Instant carry_out(const Move& move);
  Clock::Instant wait_for_arrival(const Move& move, double expected_s);
  [[noreturn]] void fail_outside_window(const Move& move, Angle encoder) const;
  [[noreturn]] void fail_still_moving(const Move& move, double elapsed_s, double expected_s);

  RunContext& context_;
  RotationStage& stage_;
  std::array<std::optional<Angle>, 2> known_;  ///< Where each axis was turned to last.
};

}  // namespace abcal
