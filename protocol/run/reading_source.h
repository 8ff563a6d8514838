#pragma once

#include <cstddef>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// The readings of the accelerometer, one after the other; a silent accelerometer is an error.
class ReadingSource {
 public:
  /// Both must outlive this.
  ReadingSource(const RunContext& context, Accelerometer& accelerometer)
      : context_(context), accelerometer_(accelerometer) {}

  /// Waits for `count` readings.
  /// @throws InstrumentError kNoReply after reading_timeout_s without any, kLinkLost. RunInterrupted.
  std::vector<Reading> read(std::size_t count);

  /// Discards what arrived before now.
  void discard_pending() { accelerometer_.discard_pending(); }
  /// Readings lost so far, as the driver knows.
  std::uint64_t lost() const { return accelerometer_.health().lost_readings; }

 private:
  Reading read_one();

  const RunContext& context_;
  Accelerometer& accelerometer_;
};

}  // namespace abcal
