#pragma once

#include <array>
#include <memory>
#include <optional>

#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// How one axis of the controller relates to the axis of the protocol, and how far it may go on this bench
/// (`[stage.x]`, `[stage.z]`):  controller angle = zero + sign * protocol angle.
struct AxisMounting {
  Angle zero;                       ///< Controller angle at the default orientation of the protocol.
  int sign = +1;                    ///< -1: the controller counts against the right-hand rule.
  std::optional<Angle> travel_min;  ///< Narrower limits than the controller's own, in protocol angles.
  std::optional<Angle> travel_max;
};

/// A stage seen in protocol angles (right-handed about X and Z, zero at the default orientation). Refuses any
/// target outside the travel of controller and bench before a byte is sent.
class MountedStage final : public RotationStage {
 public:
  MountedStage(std::unique_ptr<RotationStage> stage, std::array<AxisMounting, 2> mounting);

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
  std::unique_ptr<RotationStage> stage_;
  std::array<AxisMounting, 2> mounting_;
  std::optional<StageInfo> info_;  ///< Result of the last identify(), in protocol angles.
};

}  // namespace abcal
