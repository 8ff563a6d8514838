#pragma once

#include <algorithm>
#include <deque>
#include <optional>
#include <string>
#include <utility>

#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// Pending output of an instrument, in order, each piece at its time.
class ReplyQueue {
 public:
  void push(std::string bytes, Clock::Instant due) {
    if (!replies_.empty()) due = std::max(due, replies_.back().due);
    replies_.push_back({due, std::move(bytes)});
  }
  std::optional<Clock::Instant> next_due() const {
    return replies_.empty() ? std::nullopt : std::optional(replies_.front().due);
  }
  std::string take(Clock::Instant now) {
    std::string out;
    while (!replies_.empty() && replies_.front().due <= now) {
      out += replies_.front().bytes;
      replies_.pop_front();
    }
    return out;
  }
  void clear() { replies_.clear(); }

 private:
  struct Reply {
    Clock::Instant due;
    std::string bytes;
  };
  std::deque<Reply> replies_;
};

}  // namespace abcal::sim
