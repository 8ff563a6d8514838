#pragma once

#include <chrono>
#include <string>
#include <string_view>

#include "sim/firmware/firmware.h"
#include "sim/sim_clock.h"

namespace abcal::sim {

/// An ordinary host program: sends bytes, waits, and reads the answer.
class FirmwareHost {
 public:
  explicit FirmwareHost(Firmware& firmware) : firmware_(firmware) {}

  void send(std::string_view bytes) { firmware_.receive(bytes, clock_.now()); }

  /// Bytes that come within `duration`, instant by instant.
  std::string listen(Clock::Duration duration) {
    const Clock::Instant deadline = clock_.now() + duration;
    std::string received;
    for (auto due = firmware_.next_due(); due && *due <= deadline; due = firmware_.next_due()) {
      clock_.sleep_until(*due);
      received += firmware_.transmit(*due);
    }
    clock_.sleep_until(deadline);
    return received;
  }

  std::string exchange(std::string_view bytes) {
    send(bytes);
    return listen(std::chrono::milliseconds(1));
  }

  SimClock& clock() { return clock_; }

 private:
  Firmware& firmware_;
  SimClock clock_;
};

}  // namespace abcal::sim
