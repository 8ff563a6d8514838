#pragma once

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"
#include "tests/support/fake_clock.h"

namespace abcal::test {

/// From a command to its reply.
inline constexpr std::chrono::milliseconds kReplyTime{2};

/// The far end of a line of text commands: a function gives the answer to each, and a script the faults of
/// these answers. Times are those of the FakeClock, which a read takes to the arrival of the next bytes or to
/// its deadline.
class ScriptedLine final : public wire::ByteStream {
 public:
  /// The answer to a command, given without its end.
  using Answer = std::function<std::string(const std::string& command)>;
  /// Name of a command in the script, e.g. without its message id.
  using Name = std::function<std::string(const std::string& command)>;

  ScriptedLine(
      FakeClock& clock, char end_of_command, Answer answer,
      Name name = [](const std::string& c) { return c; })
      : clock_(clock), end_(end_of_command), answer_(std::move(answer)), name_of_(std::move(name)) {}

  // ---- The script

  bool byte_by_byte = false;
  bool silent = false;  ///< No reply to any command.
  bool unplugged = false;
  struct Mishap {
    std::optional<std::string> instead{};  ///< Sent in place of the answer; "" is silence.
    Clock::Duration late{0};
    std::string before{};  ///< Sent before the answer.
  };
  std::map<std::string, std::deque<Mishap>> mishaps;  ///< By the name of a command, in order.
  std::string held_until;                             ///< read_until() holds its caller, in real time, from
  std::string released_by;                            ///< the one command until the other is written.

  // ---- What happened

  std::vector<std::string> commands() const {
    const std::lock_guard lock(mutex_);
    return commands_;
  }
  std::size_t count(std::string_view name) const {
    const std::lock_guard lock(mutex_);
    return static_cast<std::size_t>(std::count(commands_.begin(), commands_.end(), name));
  }
  void await_hold() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return holding_; });
  }
  void say(std::string_view bytes, Clock::Duration in) {
    const std::lock_guard lock(mutex_);
    put(bytes, clock_.now() + in);
  }

  // ---- ByteStream

  void write(std::string_view bytes) override {
    const std::lock_guard lock(mutex_);
    if (unplugged) throw InstrumentError(name(), Fault::kLinkLost, "unplugged");
    for (const char byte : bytes) {
      if (byte != end_) {
        line_ += byte;
        continue;
      }
      take(line_);
      line_.clear();
    }
  }

  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return !holding_; });
    if (unplugged) throw InstrumentError(name(), Fault::kLinkLost, "unplugged");
    if (coming_.empty() || coming_.front().at > std::max(deadline, clock_.now())) {
      clock_.sleep_until(deadline);
      return {{}, clock_.now()};
    }
    clock_.sleep_until(coming_.front().at);
    wire::ReceivedBytes received{{}, clock_.now()};
    while (!coming_.empty() && coming_.front().at <= clock_.now()) {
      received.bytes += coming_.front().bytes;
      coming_.pop_front();
    }
    return received;
  }

  void discard_input() override {
    const std::lock_guard lock(mutex_);
    if (unplugged) throw InstrumentError(name(), Fault::kLinkLost, "unplugged");
    while (!coming_.empty() && coming_.front().at <= clock_.now()) coming_.pop_front();
  }

  std::string name() const override { return "scripted"; }

 private:
  struct Coming {
    Clock::Instant at;
    std::string bytes;
  };

  /// Queues bytes behind all earlier ones, as the other side answers in order.
  void put(std::string_view bytes, Clock::Instant at) {
    if (!coming_.empty()) at = std::max(at, coming_.back().at);
    if (!byte_by_byte) {
      if (!bytes.empty()) coming_.push_back({at, std::string(bytes)});
      return;
    }
    for (const char byte : bytes)
      coming_.push_back({at += std::chrono::microseconds(87), std::string(1, byte)});
  }

  void take(const std::string& command) {
    const std::string called = name_of_(command);
    commands_.push_back(called);
    if (called == released_by && holding_) {
      holding_ = false;
      changed_.notify_all();
    }
    if (called == held_until) {
      holding_ = true;
      changed_.notify_all();
    }
    if (silent) return;
    std::string answer = answer_(command);
    Mishap mishap;
    if (auto& queue = mishaps[called]; !queue.empty()) {
      mishap = queue.front();
      queue.pop_front();
    }
    put(mishap.before + mishap.instead.value_or(answer), clock_.now() + kReplyTime + mishap.late);
  }

  FakeClock& clock_;
  char end_;
  Answer answer_;
  Name name_of_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> commands_;
  std::string line_;
  std::deque<Coming> coming_;
  bool holding_ = false;
};

}  // namespace abcal::test
