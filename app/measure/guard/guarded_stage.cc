#include "app/measure/guard/guarded_stage.h"

#include <fmt/format.h>

#include <array>
#include <utility>

#include "app/measure/bench/instrument_leases.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

/// The guard closes the port first and then reports why.
constexpr std::chrono::milliseconds kNewsTime{500};
/// The name of the only port of a stage; each of two has the name of its axis.
constexpr std::array<Term, 1> kPorts{"stage"};

}  // namespace

/// Makes a call. One that fails because the guard has halted the stage throws that reason.
template <class Call>
auto GuardedStage::guarded(const Call& call) {
  try {
    return call();
  } catch (const InstrumentError& error) {
    if (error.fault() == Fault::kLinkLost)
      if (const std::string why = guard_->halted_because(kNewsTime); !why.empty())
        throw InstrumentError("stage", Fault::kStalled, why);
    throw;
  }
}

/// Before the first motion of a driver: the guard learns how to halt it.
void GuardedStage::prepare() {
  if (is_held_) return;
  std::vector<HaltRecipe> recipes = stage_->halt_recipes();
  for (const HaltRecipe& recipe : recipes)
    for (std::size_t k = 0; k < 2; ++k) axes_[k] = axes_[k] || recipe.axes[k];
  guard_->hold(port_, std::move(recipes));
  is_held_ = true;
  if (const std::string before = guard_->last_incident(); !before.empty())
    events_.push_back(
        {RealClock().now(), std::string(kGuardEvent), Message("The time before: {incident}", before)});
  events_.push_back({RealClock().now(), std::string(kGuardEvent),
                     Message("A process of its own (abcal-guard, {process}) holds the port of the {port} and "
                             "halts its axes if this program dies or hangs.",
                             guard_->process(), word_of(kPorts, port_))});
}

StageInfo GuardedStage::identify() {
  StageInfo info = guarded([&] { return stage_->identify(); });
  guard_->lease(port_, resources_of_instrument(driver_, info.maker, info.model, info.serial_number));
  return info;
}

void GuardedStage::home(StageAxis axis) {
  guarded([&] {
    prepare();
    guard_->begin_motion(axis);
    stage_->home(axis);
  });
}

void GuardedStage::move_to(StageAxis axis, Angle target) {
  guarded([&] {
    prepare();
    guard_->begin_motion(axis);
    stage_->move_to(axis, target);
  });
}

void GuardedStage::set_speed(StageAxis axis, std::optional<double> deg_per_s) {
  guarded([&] { stage_->set_speed(axis, deg_per_s); });
}

MotionState GuardedStage::motion_state(StageAxis axis) {
  const MotionState state = guarded([&] { return stage_->motion_state(axis); });
  if (state == MotionState::kStopped) guard_->end_motion(axis);
  return state;
}

Angle GuardedStage::encoder_angle(StageAxis axis) {
  return guarded([&] { return stage_->encoder_angle(axis); });
}

/// By the driver, over the guard; an axis that does not acknowledge is halted by the guard, which repeats
/// this until the controller confirms it.
HaltReport GuardedStage::halt_axes() noexcept {
  HaltReport report = stage_->halt_axes();
  bool is_acknowledged = true;
  for (const StageAxis axis : kStageAxes) {
    const bool is_halted = report.axes[index(axis)] == AxisHalt::kHalted;
    if (is_halted && axes_[index(axis)]) guard_->end_motion(axis);
    is_acknowledged = is_acknowledged && (is_halted || !axes_[index(axis)]);
  }
  if (!is_held_ || is_acknowledged) return report;
  const HaltReport by_guard = guard_->halt("the stage did not acknowledge the halt by its driver");
  for (std::size_t k = 0; k < 2; ++k)
    if (axes_[k]) report.axes[k] = by_guard.axes[k];
  return report;
}

std::vector<StageEvent> GuardedStage::take_events() {
  std::vector<StageEvent> events = stage_->take_events();
  for (StageEvent& event : std::exchange(events_, {})) events.push_back(std::move(event));
  return events;
}

}  // namespace abcal
