#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"

namespace abcal {

/// The instants at which an instrument with a clock of its own made its readings, by the clock of this
/// computer: even, reading `sequence` at first + (sequence - first_sequence) period.
struct SamplingTimes {
  std::uint64_t first_sequence = 0;
  Clock::Instant first;
  Clock::Duration period;

  Clock::Instant of(std::uint64_t sequence) const {
    return first + static_cast<std::int64_t>(sequence - first_sequence) * period;
  }
};

/// Fits the sampling times of one dwell to the arrivals of its readings. The computer (scheduler, buffers of
/// the port) can delay the arrival of a reading, but never advance it; so the line is below all arrivals and
/// minimises the sum of the delays (a linear programme, solved by the lower convex hull). The least delay of
/// the link remains, which cannot be observed here.
/// @param readings  of one stream, in order
/// @return nullopt if the readings do not follow such a line: fewer than 16, or in more than a quarter of the
/// dwell none is within half a period (or 0.5 ms) of it. Their arrivals are used then.
std::optional<SamplingTimes> fit_sampling_times(std::span<const Reading> readings);

/// Keeps the delays of this computer out of the times of a stream's readings.
void place_at_sampling_times(std::span<Reading> readings, const AccelerometerInfo& info);

/// The clock of an instrument that streams, over several sweeps. The line of fit_sampling_times() touches two
/// arrivals of one sweep, and what delayed these on a busy computer, some 0.05 ms, is an error of the angles.
/// But a clock runs evenly for minutes: its line through the least delays of each second has a tenth of that.
class SamplingClock {
 public:
  struct Placed {
    SamplingTimes times;
    /// Standard uncertainty of the times, without the least delay of the link, which is the same for all.
    double u_s = 0.0;
  };

  /// Keeps the arrivals of readings, which follow those received before.
  void hear(std::span<const Reading> readings);

  /// The sampling times of the readings of one sweep. The line is that of Theil and Sen (P. K. Sen, J. Am.
  /// Stat. Assoc. 63, 1379, 1968) through the least delay of each second of the last two minutes, so that no
  /// single arrival moves it. Readings before a gap in the numbers are not used; if those of the sweep are
  /// off the line by more than 0.2 ms, only they are used: the clock has changed.
  /// @param readings  the last received ones
  /// @return nullopt as fit_sampling_times()
  std::optional<Placed> times_of(std::span<const Reading> readings);

 private:
  struct Arrival {
    std::uint64_t sequence = 0;
    Clock::Instant at;
  };

  void keep_last_without_gap(std::span<const Reading> readings);
  void hear_only(std::span<const Reading> readings);

  std::vector<Arrival> heard_;
};

}  // namespace abcal
