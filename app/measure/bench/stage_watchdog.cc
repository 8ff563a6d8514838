#include "app/measure/bench/stage_watchdog.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "app/system/output.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {

namespace {
/// Never shorter than the reply deadline of the stage, if it has one.
Clock::Duration long_enough(Clock::Duration patience, Clock::Duration reply_deadline) {
  constexpr Clock::Duration kBeyondReply = std::chrono::seconds(1);
  return reply_deadline > Clock::Duration::zero() ? std::max(patience, reply_deadline + kBeyondReply)
                                                  : patience;
}
}  // namespace

void MotionWatch::told_to_move(StageAxis axis, Clock::Instant now) {
  moving_[index(axis)] = true;
  heard_ = now;
}

void MotionWatch::look(Clock::Instant now) {
  if (looked_ && now - *looked_ > patience_ / 2) heard_ = now;
  looked_ = now;
}

bool MotionWatch::overdue(Clock::Instant now) const {
  return (moving_[0] || moving_[1]) && now - heard_ > patience_;
}

StageWatchdog::StageWatchdog(std::unique_ptr<RotationStage> stage, const Clock& clock,
                             Clock::Duration patience)
    : stage_(std::move(stage)),
      clock_(clock),
      patience_(long_enough(patience, stage_->reply_deadline())),
      motion_(patience_),
      thread_([this](const std::stop_token& stop) { watch(stop); }) {}

StageWatchdog::~StageWatchdog() = default;

void StageWatchdog::watch(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, stop, patience_ / 10, [&] { return stop.stop_requested(); })) {
    motion_.look(clock_.now());
    if (!motion_.overdue(clock_.now())) continue;
    motion_.forget();
    halted_because_ = Message(
        "the watchdog halted the stage: it may have been moving, and its controller had not answered for "
        "{seconds:g} s, or this program had not polled it",
        to_seconds(patience_));
    const auto note = [this](const Message& text) {
      events_.push_back({clock_.now(), "watchdog halt", text});
    };
    note(halted_because_);  // At once: the owner may end the run before the halt is acknowledged.
    lock.unlock();          // A halt may be asked for by others meanwhile.
    const HaltReport report = stage_->halt_axes();
    lock.lock();
    if (!report.all_halted()) {
      const Message not_halted =
          Message("the halt was not acknowledged ({axes}): stop it by its own switch", in_words(report));
      note(not_halted);
      halted_because_ = in_sequence({halted_because_, not_halted});
    }
    print_error("stage: " + halted_because_.english());
  }
}

void StageWatchdog::throw_if_halted() const {
  const std::lock_guard lock(mutex_);
  if (!halted_because_.empty()) throw InstrumentError("stage", Fault::kStalled, halted_because_);
}

/// Makes a call and notes that it was answered.
template <class Call>
auto StageWatchdog::heard(const Call& call) {
  const auto answered = [this] {
    const std::lock_guard lock(mutex_);
    motion_.heard(clock_.now());
  };
  try {
    if constexpr (std::is_void_v<decltype(call())>) {
      call();
      answered();
    } else {
      auto answer = call();
      answered();
      return answer;
    }
  } catch (const InstrumentError&) {
    throw_if_halted();  // The call failed because of the halt: that is not the first cause.
    throw;
  }
}

StageInfo StageWatchdog::identify() {
  StageInfo info = heard([&] { return stage_->identify(); });
  const std::lock_guard lock(mutex_);
  halted_because_ = {};
  return info;
}

void StageWatchdog::home(StageAxis axis) {
  throw_if_halted();
  {
    const std::lock_guard lock(mutex_);
    motion_.told_to_move(axis, clock_.now());  // Before the call: a motion is never missed.
  }
  heard([&] { stage_->home(axis); });
}

void StageWatchdog::move_to(StageAxis axis, Angle target) {
  throw_if_halted();
  {
    const std::lock_guard lock(mutex_);
    motion_.told_to_move(axis, clock_.now());
  }
  heard([&] { stage_->move_to(axis, target); });
}

void StageWatchdog::set_speed(StageAxis axis, std::optional<double> deg_per_s) {
  throw_if_halted();
  heard([&] { stage_->set_speed(axis, deg_per_s); });
}

MotionState StageWatchdog::motion_state(StageAxis axis) {
  throw_if_halted();
  const MotionState state = heard([&] { return stage_->motion_state(axis); });
  if (state == MotionState::kStopped) {
    const std::lock_guard lock(mutex_);
    motion_.stands_still(axis);
  }
  return state;
}

Angle StageWatchdog::encoder_angle(StageAxis axis) {
  throw_if_halted();
  return heard([&] { return stage_->encoder_angle(axis); });
}

HaltReport StageWatchdog::halt_axes() noexcept {
  const HaltReport report = stage_->halt_axes();
  if (!report.all_halted()) return report;
  const std::lock_guard lock(mutex_);
  motion_.forget();
  return report;
}

std::vector<StageEvent> StageWatchdog::take_events() {
  std::vector<StageEvent> events = stage_->take_events();
  const std::lock_guard lock(mutex_);
  for (StageEvent& event : std::exchange(events_, {})) events.push_back(std::move(event));
  return events;
}

}  // namespace abcal
