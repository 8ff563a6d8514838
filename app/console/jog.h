#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stop_token>
#include <thread>

#include "app/console/request.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/run_config.h"

namespace abcal::console {

/// A button that a person holds while an axis turns. The page sends a sign of life each 100 ms as long as it
/// is held. If the button is released, or no sign of life has arrived for 300 ms for any reason, a stop is
/// requested through `let_go()`. Its callbacks run in a thread of their own, so that a controller that does
/// not answer delays no halt.
class HeldButton {
 public:
  static constexpr std::chrono::milliseconds kLongestSilence{300};

  HeldButton();
  HeldButton(const HeldButton&) = delete;
  HeldButton& operator=(const HeldButton&) = delete;
  ~HeldButton() = default;

  /// For any thread.
  void hear(const KeepTurning& sign);
  std::stop_token let_go() const { return source_.get_token(); }

 private:
  void watch(const std::stop_token& end);

  std::stop_source source_;
  std::mutex mutex_;
  std::condition_variable_any heard_;
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
  bool is_released_ = false;
  std::jthread watcher_;  ///< Last: its thread ends before the members that it uses.
};

/// The requests that end a jog before its target.
struct JogEnd {
  std::stop_token stop;      ///< Stop was requested.
  std::stop_token let_go{};  ///< HeldButton::let_go(), for a jog while a button is held.
};

/// Turns one axis, after homing it if it is not homed; for a jog while a button is held it must be homed.
/// Returns when the controller reports that it has stopped.
/// @return where it stopped, by its encoder.
/// @throws InstrumentError, RunInterrupted; the stage is halted then.
Angle turn_axis(const Jog& jog, RotationStage& stage, Clock& clock, const ProtocolConfig& protocol,
                const JogEnd& end);

}  // namespace abcal::console
