#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// How one axis of the controller relates to the axis of the protocol, and how far it may go on this bench
/// (`[stage.x]`, `[stage.z]`):  controller angle = zero + sign * protocol angle.
struct AxisMounting {
  Angle zero;                       ///< Controller angle at the default orientation of the protocol.
  int sign = +1;                    ///< -1: the controller counts against the right-hand rule.
  std::optional<Angle> travel_min;  ///< Narrower limits than the controller's own, in protocol angles.
  std::optional<Angle> travel_max;
  /// The controller counts modulo 360 and takes the shorter way: it is sent an angle of one turn, and what it
  /// reports is taken as the nearest to the last target. Both ends of the travel must be stated.
  bool wraps = false;
};

/// The last targets of axes that count modulo 360, in controller angles of all turns: kept by the owner, they
/// outlive a stage that is made again after its port was lost. An axis without one is taken to be within half
/// a turn of its zero.
class CountedTurns {
 public:
  CountedTurns() = default;
  virtual ~CountedTurns() = default;
  CountedTurns(const CountedTurns&) = delete;
  CountedTurns& operator=(const CountedTurns&) = delete;

  /// A stage has identified itself: what is kept of it counts from now on.
  virtual void recall(const StageInfo&) {}
  const std::optional<Angle>& target(StageAxis axis) const { return targets_[index(axis)]; }
  /// Called before the axis is commanded. @throws std::runtime_error it cannot be kept
  void set_target(StageAxis axis, Angle target) {
    targets_[index(axis)] = target;
    keep();
  }
  /// How a person says that the cable is not wound any more.
  virtual std::string remedy() const { return "end this program"; }

 protected:
  virtual void keep() {}

  std::array<std::optional<Angle>, 2> targets_;
};

/// The longest move of an axis that takes the shorter way.
inline constexpr Angle kLongestWrappedMove = Angle::degrees(170.0);

/// A stage seen in protocol angles (right-handed about X and Z, zero at the default orientation). Refuses any
/// target outside the travel of controller and bench before a byte is sent.
class MountedStage final : public RotationStage {
 public:
  /// @param turns  null: kept here
  MountedStage(std::unique_ptr<RotationStage> stage, std::array<AxisMounting, 2> mounting,
               std::shared_ptr<CountedTurns> turns = nullptr);

  StageInfo identify() override;  ///< Travels are in protocol angles, narrowed to the bench's limits.
  void home(StageAxis axis) override;
  void move_to(StageAxis axis, Angle target) override;
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    stage_->set_speed(axis, deg_per_s);
  }
  MotionState motion_state(StageAxis axis) override;
  Angle encoder_angle(StageAxis axis) override;
  bool halt() noexcept override;
  HaltReport halt_axes() noexcept override { return stage_->halt_axes(); }
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override { return stage_->take_events(); }

 private:
  Angle unwound(StageAxis axis, Angle reported) const;
  Angle of_one_turn(StageAxis axis, Angle target) const;

  std::unique_ptr<RotationStage> stage_;
  std::array<AxisMounting, 2> mounting_;
  std::shared_ptr<CountedTurns> turns_;
  std::array<Angle, 2> own_min_{}, own_max_{};  ///< Travel of the controller, in its own angles.
  std::optional<StageInfo> info_;               ///< Result of the last identify(), in protocol angles.
};

}  // namespace abcal
