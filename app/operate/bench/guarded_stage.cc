#include "app/operate/bench/guarded_stage.h"

#include <fmt/format.h>

#include <utility>

#include "app/ground/system/output.h"
#include "app/ground/system/real_clock.h"

namespace abcal {

void GuardedStage::have_guard() noexcept {
  try {
    // If the port is not open, the motion that follows fails with the reason.
    if (!handover_.ensure([this] { return stage_->halt_recipes(); })) return;
    note(
        fmt::format("A process of its own (abcal-guard, {}) holds the port of the {} and halts its axes if "
                    "this program dies.",
                    handover_.guard_process(), handover_.port()));
  } catch (const std::exception& error) {
    if (std::exchange(told_missing_, true)) return;
    const std::string text =
        fmt::format("Nobody halts the {} if this program dies ({}): keep the stage's own switch at hand.",
                    handover_.port(), error.what());
    print_warning(text);
    note(text);
  }
}

void GuardedStage::note(std::string text) {
  events_.push_back({RealClock().now(), std::string(kGuardEvent), std::move(text)});
}

void GuardedStage::home(StageAxis axis) {
  have_guard();
  stage_->home(axis);
}

void GuardedStage::move_to(StageAxis axis, Angle target) {
  have_guard();
  stage_->move_to(axis, target);
}

std::vector<StageEvent> GuardedStage::take_events() {
  std::vector<StageEvent> events = stage_->take_events();
  for (StageEvent& event : std::exchange(events_, {})) events.push_back(std::move(event));
  return events;
}

}  // namespace abcal
