#include "drivers/instrument/mounted_stage.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal {

MountedStage::MountedStage(std::unique_ptr<RotationStage> stage, std::array<AxisMounting, 2> mounting)
    : stage_(std::move(stage)), mounting_(mounting) {}

StageInfo MountedStage::identify() {
  StageInfo info = stage_->identify();
  for (const StageAxis axis : kStageAxes) {
    const AxisMounting& mounting = mounting_[index(axis)];
    StageAxisInfo& travel = info.axes[index(axis)];
    const Angle one = (travel.travel_min - mounting.zero) * mounting.sign;
    const Angle other = (travel.travel_max - mounting.zero) * mounting.sign;
    travel.travel_min = std::min(one, other);
    travel.travel_max = std::max(one, other);
    if (mounting.travel_min) travel.travel_min = std::max(travel.travel_min, *mounting.travel_min);
    if (mounting.travel_max) travel.travel_max = std::min(travel.travel_max, *mounting.travel_max);
  }
  info_ = info;
  return info;
}

void MountedStage::home(StageAxis axis) {
  stage_->home(axis);
}

void MountedStage::move_to(StageAxis axis, Angle target) {
  if (!info_) identify();
  const StageAxisInfo& travel = info_->axes[index(axis)];
  // Written so that a target that is not a number is refused too.
  if (!(target >= travel.travel_min && target <= travel.travel_max)) {
    throw InstrumentError("stage " + info_->model, Fault::kOutOfTravel,
                          "axis " + std::string(to_string(axis)) + " to " + std::to_string(target.deg()) +
                              " deg; its travel is " + std::to_string(travel.travel_min.deg()) + " to " +
                              std::to_string(travel.travel_max.deg()) + " deg");
  }
  const AxisMounting& mounting = mounting_[index(axis)];
  stage_->move_to(axis, mounting.zero + target * mounting.sign);
}

MotionState MountedStage::motion_state(StageAxis axis) {
  return stage_->motion_state(axis);
}

Angle MountedStage::encoder_angle(StageAxis axis) {
  const AxisMounting& mounting = mounting_[index(axis)];
  return (stage_->encoder_angle(axis) - mounting.zero) * mounting.sign;
}

bool MountedStage::halt() noexcept {
  return stage_->halt();
}

}  // namespace abcal
