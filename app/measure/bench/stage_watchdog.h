#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// Whether a stage that was commanded to move has answered lately. Not thread-safe.
class MotionWatch {
 public:
  explicit MotionWatch(Clock::Duration patience) : patience_(patience) {}

  void told_to_move(StageAxis axis, Clock::Instant now);
  /// The controller has answered something.
  void heard(Clock::Instant now) { heard_ = now; }
  void stands_still(StageAxis axis) { moving_[index(axis)] = false; }
  void forget() { moving_ = {}; }

  /// To be called regularly, before overdue(). A pause of more than half the patience between two calls shows
  /// that this program was suspended, as in a frozen container, and could receive nothing: silence counts
  /// from the end of the pause on. (The guard halts a stage whose program is suspended.)
  void look(Clock::Instant now);

  /// Whether it may be moving and has not answered for longer than the patience.
  bool overdue(Clock::Instant now) const;

 private:
  Clock::Duration patience_;
  std::array<bool, 2> moving_{};
  Clock::Instant heard_;
  std::optional<Clock::Instant> looked_;
};

/// A stage under a watchdog: if it may be moving and the controller has not answered for `patience` (it is
/// silent, or this program hangs: a blocked terminal, a disk that does not answer), a separate thread halts
/// it. The patience is never shorter than the longest reply time of the controller. After the halt every
/// call, also the one in progress, throws kStalled with this first cause until the stage is identified again.
/// Each halt is an event (take_events()).
class StageWatchdog final : public RotationStage {
 public:
  static constexpr Clock::Duration kPatience = std::chrono::seconds(5);

  /// `clock` must run in real time.
  StageWatchdog(std::unique_ptr<RotationStage> stage, const Clock& clock,
                Clock::Duration patience = kPatience);
  ~StageWatchdog() override;

  StageInfo identify() override;
  void home(StageAxis axis) override;
  void move_to(StageAxis axis, Angle target) override;
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override;
  MotionState motion_state(StageAxis axis) override;
  Angle encoder_angle(StageAxis axis) override;
  bool halt() noexcept override { return halt_axes().all_halted(); }
  HaltReport halt_axes() noexcept override;
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override;

  Clock::Duration patience() const { return patience_; }

 private:
  void watch(const std::stop_token& stop);
  void throw_if_halted() const;
  template <class Call>
  auto heard(const Call& call);

  std::unique_ptr<RotationStage> stage_;
  const Clock& clock_;
  Clock::Duration patience_;
  mutable std::mutex mutex_;
  std::condition_variable_any wake_;
  MotionWatch motion_;
  Message halted_because_;  ///< Empty: it has not halted the stage.
  std::vector<StageEvent> events_;
  std::jthread thread_;  ///< Last: it ends before the members that it uses.
};

}  // namespace abcal
