#pragma once

#include <memory>
#include <string>

#include "drivers/instrument/accelerometer.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

/// The simulated accelerometer behind the driver interface directly. Makes readings at `rate_hz` on a grid
/// fixed to the start of the world's time; the grid's index is the sequence number and the index of the
/// noise.
class SimAccelerometer final : public Accelerometer {
 public:
  /// @throws std::invalid_argument unless rate_hz is positive and at most 1e6.
  SimAccelerometer(std::shared_ptr<SimBench> bench, Clock& clock, double rate_hz,
                   std::string output_unit = "g", std::string serial_number = "SIM-2");

  AccelerometerInfo identify() override;
  void start() override;
  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override;
  StreamHealth health() const override { return health_; }
  void stop() noexcept override;

 private:
  Clock::Instant sample_time(std::uint64_t index) const;
  Clock::Duration lateness(std::uint64_t sequence) const;
  std::uint64_t first_after(Clock::Instant t) const;

  std::shared_ptr<SimBench> bench_;
  Clock& clock_;
  double rate_hz_;
  std::string output_unit_;
  std::string serial_number_;
  bool started_ = false;
  std::uint64_t next_index_ = 0;
  StreamHealth health_;
};

}  // namespace abcal::sim
