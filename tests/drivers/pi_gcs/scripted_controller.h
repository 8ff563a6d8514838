#pragma once

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <deque>
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

/// The far end of a GCS line, as a table of commands with their answers and with the faults of these answers.
/// No physics: a test defines the state of an axis. Times are those of the FakeClock, which a read takes to
/// the arrival of the next bytes or to its deadline.
class ScriptedController final : public wire::ByteStream {
 public:
  static constexpr std::string_view kIdentity =
      "(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 123456, 1.2.3\n";

  explicit ScriptedController(FakeClock& clock) : clock_(clock) {
    replies = {{"*IDN?", std::string(kIdentity)},
               {"SAI?", "1 \n2 \n3\n"},
               {"\x05", "0\n"},
               {"\x04", "0x100010001000\n"}};
    for (const std::string axis : {"1", "2"}) {
      replies["PUN? " + axis] = axis + "=DEG\n";
      replies["CST? " + axis] = axis + "=M-060.PD\n";
      replies["TMN? " + axis] = axis + "=-360.0\n";
      replies["TMX? " + axis] = axis + "=370.5\n";
      replies["FRF? " + axis] = axis + "=1\n";
      replies["VEL? " + axis] = axis + "=20.000000\n";
      replies["SPA? " + axis + " 14"] = axis + " 14=10000\n";
      replies["SPA? " + axis + " 15"] = axis + " 0xF=1\n";
      replies["TRS? " + axis] = axis + "=1\n";
      replies["LIM? " + axis] = axis + "=1\n";
      replies["SVO? " + axis] = axis + "=1\n";
      replies["ONT? " + axis] = axis + "=1\n";
      replies["POS? " + axis] = axis + "=14.500000\n";
    }
  }

  // ---- The script

  std::map<std::string, std::string>
      replies;                          ///< Queries that are not here are unknown: silence and error 2.
  std::map<std::string, int> refusals;  ///< Error codes of set commands (and queries); others succeed.
  bool byte_by_byte = false;
  bool silent = false;  ///< No reply to any command.
  bool unplugged = false;
  std::string stop_acknowledged_by = "error";  ///< "error", "mask" or "nothing".

  struct Mishap {
    std::optional<std::string> instead;  ///< Sent in place of the answer; "" is silence.
    Clock::Duration late{0};
  };
  /// Faults of the next answers to a command, in order.
  std::map<std::string, std::deque<Mishap>> mishaps;
  /// read_until() holds its caller, in real time, from this command until a stop (#24) is written.
  std::string held_until_stop;

  // ---- What happened

  std::vector<std::string> commands() const {
    const std::lock_guard lock(mutex_);
    return commands_;
  }
  std::size_t count(std::string_view command) const {
    const std::lock_guard lock(mutex_);
    return static_cast<std::size_t>(std::count(commands_.begin(), commands_.end(), command));
  }
  void await_hold() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return holding_; });
  }

  // ---- ByteStream

  void write(std::string_view bytes) override {
    const std::lock_guard lock(mutex_);
    if (unplugged) throw InstrumentError(name(), Fault::kLinkLost, "unplugged");
    for (const char byte : bytes) {
      if (byte == 0x18) {
        commands_.emplace_back(1, byte);
        holding_ = false;
        error_ = stop_acknowledged_by == "error" ? 10 : 0;
        if (stop_acknowledged_by == "nothing") replies["\x05"] = "3\n";
        changed_.notify_all();
      } else if (line_.empty() && (byte == 0x04 || byte == 0x05 || byte == 0x07)) {
        take(std::string(1, byte));
      } else if (byte == '\n') {
        take(line_);
        line_.clear();
      } else {
        line_ += byte;
      }
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

  /// Sends bytes without a request.
  void say(std::string_view bytes, Clock::Duration in) {
    const std::lock_guard lock(mutex_);
    put(bytes, clock_.now() + in);
  }

 private:
  struct Coming {
    Clock::Instant at;
    std::string bytes;
  };

  /// Queues bytes behind all earlier ones, as the controller answers in order.
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
    commands_.push_back(command);
    if (command == held_until_stop) {
      holding_ = true;
      changed_.notify_all();
    }
    if (silent) return;
    std::string answer;
    if (command == "ERR?") {
      answer = std::to_string(error_) + "\n";
      error_ = 0;
    } else if (const auto refused = refusals.find(command); refused != refusals.end()) {
      error_ = refused->second;
    } else if (const auto found = replies.find(command); found != replies.end()) {
      answer = found->second;
    } else if (command.find('?') != std::string::npos || command.size() == 1) {
      error_ = 2;
    }
    Mishap mishap;
    if (auto& queue = mishaps[command]; !queue.empty()) {
      mishap = queue.front();
      queue.pop_front();
    }
    put(mishap.instead.value_or(answer), clock_.now() + std::chrono::milliseconds(2) + mishap.late);
  }

  FakeClock& clock_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> commands_;
  std::string line_;
  std::deque<Coming> coming_;
  int error_ = 0;
  bool holding_ = false;
};

}  // namespace abcal::test
