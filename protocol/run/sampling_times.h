#pragma once

#include <cstdint>
#include <optional>
#include <span>

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

/// Fits the sampling times of one dwell to the arrivals of its readings. A reading arrives late by a share of
/// the computer's own doings (its scheduler, buffers of the port), never early; so the line runs below all
/// arrivals and as close to them as it can: the least sum of the delays (a linear programme, solved by the
/// lower convex hull). What remains is the least delay of the link, which nobody sees from here.
/// @param readings  of one stream, in order
/// @return nothing where the readings do not follow such a line: fewer than 16, or in more than a quarter of
/// the dwell none comes within half a period (or 0.5 ms) of it. Their arrivals then stand for themselves.
std::optional<SamplingTimes> fit_sampling_times(std::span<const Reading> readings);

/// Keeps the delays of this computer out of the times of a stream's readings.
void place_at_sampling_times(std::span<Reading> readings, const AccelerometerInfo& info);

}  // namespace abcal
