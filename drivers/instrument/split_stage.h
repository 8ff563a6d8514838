#pragma once

#include <memory>

#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// A rotation stage whose axes sit on two controllers: X on one, Z on the other. Each part is asked for its
/// own axis only; its statements about the other axis are ignored. One owner at a time, except halt().
class SplitStage final : public RotationStage {
 public:
  /// @throws std::invalid_argument if a part is missing.
  SplitStage(std::unique_ptr<RotationStage> x, std::unique_ptr<RotationStage> z);

  /// Both controllers, "X's + Z's" in each text where the two differ.
  StageInfo identify() override;
  void home(StageAxis axis) override { part(axis).home(axis); }
  void move_to(StageAxis axis, Angle target) override { part(axis).move_to(axis, target); }
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    part(axis).set_speed(axis, deg_per_s);
  }
  MotionState motion_state(StageAxis axis) override { return part(axis).motion_state(axis); }
  Angle encoder_angle(StageAxis axis) override { return part(axis).encoder_angle(axis); }

  /// Stops both at the same time: one that does not acknowledge must not keep the other moving.
  /// @return false if either did not acknowledge.
  bool halt() noexcept override { return halt_axes().all_halted(); }

  /// Like halt(). If one controller is gone, the other still halts its own axis.
  HaltReport halt_axes() noexcept override;
  std::vector<HaltRecipe> halt_recipes() override;
  Clock::Duration reply_deadline() const override;
  std::vector<StageEvent> take_events() override;

 private:
  RotationStage& part(StageAxis axis) { return axis == StageAxis::kX ? *x_ : *z_; }

  std::unique_ptr<RotationStage> x_;
  std::unique_ptr<RotationStage> z_;
};

}  // namespace abcal
