#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// The readings of an accelerometer, one after the other; a silent accelerometer is an error.
///
/// One thread reads several items at once: while it waits for one, the readings of the others are taken from
/// their drivers every 20 ms and kept until they are read.
class ReadingSource {
 public:
  /// Both must outlive this.
  ReadingSource(const RunContext& context, Accelerometer& accelerometer)
      : context_(context), accelerometer_(accelerometer) {}

  /// From now on the readings of `others` are taken while this one waits. They must outlive this.
  void read_beside(std::vector<ReadingSource*> others) { others_ = std::move(others); }

  /// Waits for `count` readings.
  /// @throws InstrumentError kNoReply after reading_timeout_s without any, kLinkLost. RunInterrupted.
  std::vector<Reading> read(std::size_t count);

  /// The readings that have arrived and were not read; does not wait.
  /// @throws InstrumentError kLinkLost
  std::vector<Reading> take();

  /// Discards readings that arrived before now.
  void discard_pending() {
    waiting_.clear();
    accelerometer_.discard_pending();
  }
  /// Forgets readings and failure, because the accelerometer is started again.
  void restart() {
    waiting_.clear();
    failure_.reset();
  }
  /// Readings lost so far, counted by the driver.
  std::uint64_t lost() const { return accelerometer_.health().lost_readings; }

 private:
  Reading read_one();
  void look_at_others();
  void take_waiting();

  const RunContext& context_;
  Accelerometer& accelerometer_;
  std::vector<ReadingSource*> others_;
  Clock::Instant next_look_;
  std::deque<Reading> waiting_;             ///< Taken while another item was read.
  std::optional<InstrumentError> failure_;  ///< Thrown after the readings in waiting_.
};

}  // namespace abcal
