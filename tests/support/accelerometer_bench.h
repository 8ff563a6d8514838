#pragma once

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_settings.h"
#include "tests/support/fake_clock.h"
#include "tests/support/scripted_port.h"

namespace abcal::test {

/// A driver of an accelerometer and the scripted far end of its port.
template <class Driver, class Port = ScriptedPort, class PortClock = FakeClock>
struct AccelerometerBench {
  /// @param script  how the port is made, after its clock
  template <class... Script>
  explicit AccelerometerBench(const AccelerometerSettings& settings, Script&&... script) {
    auto owned = std::make_unique<Port>(clock, std::forward<Script>(script)...);
    port = owned.get();
    accelerometer = std::make_unique<Driver>(std::move(owned), clock, settings);
  }

  /// Readings that the driver has now; waits no longer than `wait`.
  std::vector<Reading> read_all(Clock::Duration wait = {}) {
    std::vector<Reading> readings;
    const Clock::Instant deadline = clock.now() + wait;
    while (const auto reading = accelerometer->next(deadline)) readings.push_back(*reading);
    return readings;
  }

  PortClock clock;
  Port* port = nullptr;
  std::unique_ptr<Driver> accelerometer;
};

inline std::vector<std::uint64_t> sequences(const std::vector<Reading>& readings) {
  std::vector<std::uint64_t> result;
  for (const Reading& reading : readings) result.push_back(reading.sequence);
  return result;
}

}  // namespace abcal::test
