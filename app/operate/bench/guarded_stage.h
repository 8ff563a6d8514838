#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/operate/bench/port_handover.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// Kind of the events that report whether a guard protects a stage.
inline constexpr std::string_view kGuardEvent = "guard";

/// A stage on one port that hands the port to a guard before its first motion. A missing guard is an event,
/// not an error: the stage works without it.
class GuardedStage final : public RotationStage {
 public:
  GuardedStage(std::unique_ptr<RotationStage> stage, PortHandover handover)
      : stage_(std::move(stage)), handover_(std::move(handover)) {}

  StageInfo identify() override { return stage_->identify(); }
  void home(StageAxis axis) override;
  void move_to(StageAxis axis, Angle target) override;
  MotionState motion_state(StageAxis axis) override { return stage_->motion_state(axis); }
  Angle encoder_angle(StageAxis axis) override { return stage_->encoder_angle(axis); }
  bool halt() noexcept override { return stage_->halt(); }
  HaltReport halt_axes() noexcept override { return stage_->halt_axes(); }
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override;

 private:
  void have_guard() noexcept;
  void note(std::string text);

  std::unique_ptr<RotationStage> stage_;
  PortHandover handover_;
  bool told_missing_ = false;
  std::vector<StageEvent> events_;
};

}  // namespace abcal
