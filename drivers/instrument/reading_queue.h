#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

#include "drivers/instrument/accelerometer.h"

namespace abcal {

/// Readings of a streaming accelerometer between the wire and next(), numbered and in their order, and the
/// number of lost ones. One thread.
class ReadingQueue {
 public:
  /// `capacity` readings are kept for a caller that does not fetch them; later ones are lost and counted.
  explicit ReadingQueue(std::size_t capacity = 8192) : capacity_(capacity) {}  // 10 s at 800 Hz

  /// A stream begins.
  void restart() { *this = ReadingQueue(capacity_); }

  /// Takes the next reading and numbers it. `steps`: readings that the instrument has made since the one
  /// before, including this one (1: none was lost); ignored for the first reading.
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

  /// Readings from here to end_discard() are numbered and discarded, so that losses before and after them can
  /// still be counted.
  void begin_discard() {
    discarding_ = true;
    lost_before_discard_ = lost_;
  }
  /// `partial_frame`: the beginning of a frame has arrived, so its reading was made before now.
  /// `input_ran_over`: the input queue was full since the last discard; the resulting gap lies in the
  /// discarded readings.
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
