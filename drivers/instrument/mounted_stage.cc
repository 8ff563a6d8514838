#include "drivers/instrument/mounted_stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

constexpr double kTurn = 360.0;

}  // namespace

MountedStage::MountedStage(std::unique_ptr<RotationStage> stage, std::array<AxisMounting, 2> mounting,
                           std::shared_ptr<CountedTurns> turns)
    : stage_(std::move(stage)),
      mounting_(mounting),
      turns_(turns ? std::move(turns) : std::make_shared<CountedTurns>()) {}

/// The angle of all turns that is nearest to the last target.
Angle MountedStage::unwound(StageAxis axis, Angle reported) const {
  const Angle about = turns_->target(axis).value_or(mounting_[index(axis)].zero);
  return about + Angle::degrees(std::remainder((reported - about).deg(), kTurn));
}

/// The angle that the controller is sent: from 0 to 360 degrees, or one turn away if only that is within its
/// travel.
Angle MountedStage::of_one_turn(StageAxis axis, Angle target) const {
  const double least = target.deg() - kTurn * std::floor(target.deg() / kTurn);
  for (const double angle : {least, least - kTurn})
    if (angle >= own_min_[index(axis)].deg() && angle <= own_max_[index(axis)].deg())
      return Angle::degrees(angle);
  return Angle::degrees(least);  // The controller refuses it.
}

StageInfo MountedStage::identify() {
  StageInfo info = stage_->identify();
  for (const StageAxis axis : kStageAxes) {
    const AxisMounting& mounting = mounting_[index(axis)];
    StageAxisInfo& travel = info.axes[index(axis)];
    own_min_[index(axis)] = travel.travel_min;
    own_max_[index(axis)] = travel.travel_max;
    if (mounting.wraps) {
      travel.travel_min = mounting.travel_min.value_or(Angle{});
      travel.travel_max = mounting.travel_max.value_or(Angle{});
      travel.longest_move = kLongestWrappedMove;
      continue;
    }
    const Angle one = (travel.travel_min - mounting.zero) * mounting.sign;
    const Angle other = (travel.travel_max - mounting.zero) * mounting.sign;
    travel.travel_min = std::min(one, other);
    travel.travel_max = std::max(one, other);
    if (mounting.travel_min) travel.travel_min = std::max(travel.travel_min, *mounting.travel_min);
    if (mounting.travel_max) travel.travel_max = std::min(travel.travel_max, *mounting.travel_max);
  }
  if (mounting_[0].wraps || mounting_[1].wraps) turns_->recall(info);
  info_ = info;
  return info;
}

void MountedStage::home(StageAxis axis) {
  const AxisMounting& mounting = mounting_[index(axis)];
  if (mounting.wraps) {
    if (!info_) identify();
    // A search of the reference may turn either way: its end would say nothing of the cable.
    const Angle wound = turns_->target(axis).value_or(mounting.zero) - mounting.zero;
    if (std::abs(wound.deg()) > kTurn / 2.0) {
      throw InstrumentError(
          "stage " + info_->model, Fault::kNotReady,
          fmt::format(
              "axis {} was last commanded {:.1f} deg from its zero, so that its cable may be wound, and "
              "its reference is to be searched; required: turn the axis back to within half a turn of "
              "its zero by the way that unwinds the cable, then {}",
              to_string(axis), wound.deg(), turns_->remedy()));
    }
    turns_->set_target(axis, mounting.zero);  // The reference is near the zero.
  }
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
  const Angle own = mounting.zero + target * mounting.sign;
  if (!mounting.wraps) return stage_->move_to(axis, own);
  const Angle from = unwound(axis, stage_->encoder_angle(axis));
  if (std::abs((own - from).deg()) >= kTurn / 2.0) {
    throw InstrumentError("stage " + info_->model, Fault::kRefused,
                          "axis " + std::string(to_string(axis)) + " from " + std::to_string(from.deg()) +
                              " to " + std::to_string(own.deg()) +
                              " deg: the controller counts modulo 360 and takes the shorter way; required: "
                              "moves of less than 180 deg");
  }
  // Before the command: a move that has begun although its reply was lost is counted, too.
  turns_->set_target(axis, own);
  stage_->move_to(axis, of_one_turn(axis, own));
}

MotionState MountedStage::motion_state(StageAxis axis) {
  return stage_->motion_state(axis);
}

Angle MountedStage::encoder_angle(StageAxis axis) {
  const AxisMounting& mounting = mounting_[index(axis)];
  const Angle reported = stage_->encoder_angle(axis);
  return ((mounting.wraps ? unwound(axis, reported) : reported) - mounting.zero) * mounting.sign;
}

bool MountedStage::halt() noexcept {
  return stage_->halt();
}

}  // namespace abcal
