#pragma once

#include <memory>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

/// A real stage whose read-back turns a simulated world, so that a simulated accelerometer "on" a real stage
/// reads what its pose requires. The world's axes are at the last encoder readings; its stage errors are the
/// truth's. The stage must speak protocol angles.
class FollowedStage final : public RotationStage {
 public:
  FollowedStage(std::unique_ptr<RotationStage> stage, std::shared_ptr<SimBench> world, Clock& clock);

  StageInfo identify() override { return stage_->identify(); }
  void home(StageAxis axis) override { stage_->home(axis); }
  void move_to(StageAxis axis, Angle target) override { stage_->move_to(axis, target); }
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    stage_->set_speed(axis, deg_per_s);
  }
  /// Also reads the encoder, so that the world follows while the stage moves.
  MotionState motion_state(StageAxis axis) override;
  Angle encoder_angle(StageAxis axis) override;
  bool halt() noexcept override { return stage_->halt(); }
  HaltReport halt_axes() noexcept override { return stage_->halt_axes(); }
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override { return stage_->take_events(); }

 private:
  std::unique_ptr<RotationStage> stage_;
  std::shared_ptr<SimBench> world_;
  Clock& clock_;
};

}  // namespace abcal::sim
