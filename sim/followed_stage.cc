#include "sim/followed_stage.h"

#include <utility>

namespace abcal::sim {

FollowedStage::FollowedStage(std::unique_ptr<RotationStage> stage, std::shared_ptr<SimBench> world,
                             Clock& clock)
    : stage_(std::move(stage)), world_(std::move(world)), clock_(clock) {}

MotionState FollowedStage::motion_state(StageAxis axis) {
  const MotionState state = stage_->motion_state(axis);
  encoder_angle(axis);
  return state;
}

Angle FollowedStage::encoder_angle(StageAxis axis) {
  const Angle angle = stage_->encoder_angle(axis);
  world_->place(axis, angle, clock_.now());
  return angle;
}

}  // namespace abcal::sim
