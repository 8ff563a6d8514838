#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

#include "drivers/instrument/accelerometer.h"

namespace abcal {

/// What the driver of a streaming accelerometer keeps between the wire and next(): the readings in their
/// order, numbered, and how many were lost. One thread.
class ReadingQueue {
 public:
  /// `capacity` readings are kept for a caller that does not fetch them; later ones are lost and counted.
  explicit ReadingQueue(std::size_t capacity = 8192) : capacity_(capacity) {}  // 10 s at 800 Hz

  /// A stream begins.
  void restart() { *this = ReadingQueue(capacity_); }

  /// Takes the next reading and numbers it. `steps`: how many the instrument has made since the one before,
  /// this one included (1: none was lost); of no account for the first.
  void push(Reading reading, std::uint64_t steps) {
    if (last_sequence_ && !forgive_next_gap_) lost_ += steps - 1;
    forgive_next_gap_ = false;
    reading.sequence = last_sequence_ ? *last_sequence_ + steps : 0;
    last_sequence_ = reading.sequence;
    if (std::exchange(discard_next_, false) || discarding_) return;
    if (waiting_.size() >= capacity_) {
      ++lost_;
      return;
    }
    ++readings_;
    waiting_.push_back(std::move(reading));
  }

  std::optional<Reading> pop() {
    if (waiting_.empty()) return std::nullopt;
    Reading reading = std::move(waiting_.front());
    waiting_.pop_front();
    return reading;
  }

  bool empty() const { return waiting_.empty(); }
  bool has_any_come() const { return last_sequence_.has_value(); }

  /// From here to end_discard() readings are numbered and thrown away: their numbers still say what was lost
  /// before and after them.
  void begin_discard() {
    discarding_ = true;
    lost_before_discard_ = lost_;
  }
  /// `partial_frame`: the beginning of a frame has come, so the reading it completes was made before now.
  /// `input_ran_over`: the input queue was full since the last discard; that gap is of what is thrown away.
  void end_discard(bool partial_frame, bool input_ran_over) {
    discarding_ = false;
    waiting_.clear();
    discard_next_ = partial_frame;
    if (input_ran_over) {
      lost_ = lost_before_discard_;
      forgive_next_gap_ = true;
    }
  }

  /// The stream ends: nothing waits any longer, the figures remain.
  void close() { waiting_.clear(); }

  std::uint64_t readings() const { return readings_; }
  std::uint64_t lost() const { return lost_; }

 private:
  std::size_t capacity_;
  std::deque<Reading> waiting_;
  std::uint64_t readings_ = 0;
  std::uint64_t lost_ = 0;
  std::uint64_t lost_before_discard_ = 0;
  std::optional<std::uint64_t> last_sequence_;
  bool discarding_ = false;
  bool discard_next_ = false;
  bool forgive_next_gap_ = false;
};

}  // namespace abcal
