#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench/halt_guard.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// Kind of the events that say whether a guard stands behind a stage.
inline constexpr std::string_view kGuardEvent = "guard";

/// A stage on one port that hands the port to a guard before its first motion. That there is no guard is an
/// event and no error: the stage is then as safe as without.
class GuardedStage final : public RotationStage {
 public:
  /// @param descriptor  of the port now; -1: it is not open
  GuardedStage(std::unique_ptr<RotationStage> stage, std::shared_ptr<HaltGuard> guard, std::string port,
               std::function<int()> descriptor)
      : stage_(std::move(stage)),
        guard_(std::move(guard)),
        port_(std::move(port)),
        descriptor_(std::move(descriptor)) {}

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
  std::shared_ptr<HaltGuard> guard_;
  std::string port_;
  std::function<int()> descriptor_;
  int held_by_ = 0;  ///< Generation of the guard that holds the port; 0: none.
  bool told_missing_ = false;
  std::vector<StageEvent> events_;
};

}  // namespace abcal
