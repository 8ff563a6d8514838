#include "sim/sim_stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal::sim {
namespace {

// A search for the reference takes time even if the axis is already on it.
constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);

}  // namespace

SimStage::SimStage(std::shared_ptr<SimBench> bench, Clock& clock, std::string serial_number)
    : bench_(std::move(bench)), clock_(clock), serial_number_(std::move(serial_number)) {}

void SimStage::update(StageAxis axis, Clock::Instant now) {
  Axis& state = axes_[index(axis)];
  if (state.homing_until) state.homing_until = std::max(*state.homing_until, bench_->motion_end(axis, now));
  if (state.homing_until && now >= *state.homing_until) {
    state.homing_until.reset();
    state.referenced = true;
  }
  if (bench_->fault_at(FaultKind::kLostReference, now, axis)) state.referenced = false;
}

StageInfo SimStage::identify() {
  const std::lock_guard lock(mutex_);
  const Clock::Instant now = clock_.now();
  StageInfo info{.maker = "abcal",
                 .model = "simulated stage",
                 .serial_number = serial_number_,
                 .firmware = "1",
                 .axes = {}};
  for (const StageAxis axis : kStageAxes) {
    update(axis, now);
    const AxisTruth& truth = bench_->stage().axis(axis);
    info.axes[index(axis)] = {.stage_name = fmt::format("simulated {}", to_string(axis)),
                              .travel_min = truth.travel_min,
                              .travel_max = truth.travel_max,
                              .resolution = truth.encoder_resolution,
                              .speed_deg_per_s = bench_->motion_limits(axis).speed_deg_per_s,
                              .referenced = axes_[index(axis)].referenced};
  }
  return info;
}

void SimStage::home(StageAxis axis) {
  const std::lock_guard lock(mutex_);
  const Clock::Instant now = clock_.now();
  bench_->move(axis, Angle{}, now);
  axes_[index(axis)] = {.referenced = false, .homing_until = now + kShortestHoming};
}

void SimStage::move_to(StageAxis axis, Angle target) {
  const std::lock_guard lock(mutex_);
  const Clock::Instant now = clock_.now();
  update(axis, now);
  const std::string who = fmt::format("simulated stage axis {}", to_string(axis));
  if (!axes_[index(axis)].referenced)
    throw InstrumentError(who, Fault::kNotReady, "not referenced: home it before a move");
  const AxisTruth& truth = bench_->stage().axis(axis);
  // Written so that NaN is out of travel too.
  if (!(target >= truth.travel_min && target <= truth.travel_max))
    throw InstrumentError(who, Fault::kOutOfTravel,
                          fmt::format("target {} degrees, required: {} to {} degrees", target.deg(),
                                      truth.travel_min.deg(), truth.travel_max.deg()));
  if (bench_->fault_at(FaultKind::kRefusedMove, now, axis))
    throw InstrumentError(who, Fault::kRefused, "the move was refused (scripted fault)");
  bench_->move(axis, target, now);
}

void SimStage::set_speed(StageAxis axis, std::optional<double> deg_per_s) {
  MotionLimits limits = bench_->motion_limits(axis);
  limits.speed_deg_per_s = deg_per_s.value_or(bench_->stage().axis(axis).speed_deg_per_s);
  if (!(limits.speed_deg_per_s > 0.0))
    throw InstrumentError(fmt::format("simulated stage axis {}", to_string(axis)), Fault::kRefused,
                          fmt::format("speed {} deg/s; required: above 0", limits.speed_deg_per_s));
  bench_->set_motion_limits(axis, limits);
}

MotionState SimStage::motion_state(StageAxis axis) {
  const std::lock_guard lock(mutex_);
  const Clock::Instant now = clock_.now();
  update(axis, now);
  const bool moving = axes_[index(axis)].homing_until.has_value() || bench_->moving(axis, now);
  return moving ? MotionState::kMoving : MotionState::kStopped;
}

Angle SimStage::encoder_angle(StageAxis axis) {
  return bench_->encoder_angle(axis, clock_.now());
}

bool SimStage::halt() noexcept {
  try {
    const std::lock_guard lock(mutex_);
    for (const StageAxis axis : kStageAxes) {
      update(axis, clock_.now());
      axes_[index(axis)].homing_until.reset();  // a search cut short finds nothing
      bench_->halt(axis, clock_.now());
    }
    return true;
  } catch (...) {  // false reports it to the caller; halt() must not throw
    return false;
  }
}

}  // namespace abcal::sim
