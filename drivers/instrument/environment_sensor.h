#pragma once

#include <optional>

#include "drivers/instrument/clock.h"

namespace abcal {

/// State of the air around the bench, as a sensor reports it. Quantities that it does not measure are absent.
struct EnvironmentReading {
  std::optional<double> temperature_degc;
  std::optional<double> humidity_percent;  ///< Relative.
  std::optional<double> pressure_hpa;
};

/// A thermometer, hygrometer or barometer near the bench. One owner at a time.
class EnvironmentSensor {
 public:
  virtual ~EnvironmentSensor() = default;

  /// The present reading, at most some seconds old; waits for it until `deadline`.
  /// @throws InstrumentError kNoReply, kBadFrame or kWrongIdentity if there is none by then, kImplausible if
  /// it cannot be true, kLinkLost.
  virtual EnvironmentReading read(Clock::Instant deadline) = 0;
};

}  // namespace abcal
