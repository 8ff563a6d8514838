#pragma once

#include <optional>

#include "drivers/instrument/clock.h"

namespace abcal {

/// What a sensor says of the air around the bench. What it does not measure is absent.
struct EnvironmentReading {
  std::optional<double> temperature_degc;
  std::optional<double> humidity_percent;  ///< Relative.
  std::optional<double> pressure_hpa;
};

/// A thermometer, hygrometer or barometer beside the bench. One owner at a time.
class EnvironmentSensor {
 public:
  virtual ~EnvironmentSensor() = default;

  /// What it says now, at most some seconds old; waits for it until `deadline`.
  /// @throws InstrumentError kNoReply, kBadFrame or kWrongIdentity if there is none by then, kImplausible if
  /// it cannot be true, kLinkLost.
  virtual EnvironmentReading read(Clock::Instant deadline) = 0;
};

}  // namespace abcal
