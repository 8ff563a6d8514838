#pragma once

#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"
#include "tests/support/fake_clock.h"

namespace abcal::test {

/// The far end of a port on which each write is one command: a function gets each command and may send any
/// bytes at any time from then on. Times are those of the FakeClock, which a read advances to the arrival of
/// the next bytes or to its deadline.
class ScriptedPort final : public wire::ByteStream {
 public:
  using OnCommand = std::function<void(ScriptedPort&, const std::string& command)>;

  ScriptedPort(FakeClock& clock, OnCommand on_command) : clock_(clock), on_command_(std::move(on_command)) {}

  std::vector<std::string> commands;  ///< Commands written by the driver.
  std::size_t dropped = 0;
  bool unplugged = false;

  void say(std::string bytes, Clock::Duration in = {}) {
    coming_.emplace(clock_.now() + in, std::move(bytes));
  }

  void write(std::string_view bytes) override {
    throw_if_unplugged();
    commands.emplace_back(bytes);
    on_command_(*this, commands.back());
  }

  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    throw_if_unplugged();
    std::string bytes = take_due();
    if (bytes.empty()) {
      const bool in_time = !coming_.empty() && coming_.begin()->first <= deadline;
      clock_.sleep_until(in_time ? coming_.begin()->first : deadline);
      bytes = take_due();
    }
    return {std::move(bytes), clock_.now()};
  }

  void discard_input() override {
    throw_if_unplugged();
    take_due();
  }
  std::size_t dropped_bytes() const override { return dropped; }
  std::string name() const override { return "scripted"; }

 private:
  void throw_if_unplugged() const {
    if (unplugged) throw InstrumentError("scripted", Fault::kLinkLost, "unplugged");
  }

  std::string take_due() {
    std::string bytes;
    while (!coming_.empty() && coming_.begin()->first <= clock_.now()) {
      bytes += coming_.begin()->second;
      coming_.erase(coming_.begin());
    }
    return bytes;
  }

  FakeClock& clock_;
  OnCommand on_command_;
  std::multimap<Clock::Instant, std::string> coming_;  // Equal instants keep their order.
};

}  // namespace abcal::test
