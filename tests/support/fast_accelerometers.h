#pragma once

#include <pthread.h>

#include <cmath>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/measure/bench/make_firmware.h"
#include "app/system/real_clock.h"
#include "drivers/registry.h"
#include "drivers/wire/open_stream.h"
#include "sim/emulator.h"
#include "tests/support/temporary_folder.h"

namespace abcal::test {

/// An accelerometer at the highest rate that its simulated counterpart has.
struct FastAccelerometer {
  double rate_hz = 0.0;
  std::optional<int> baud{};
  double integration_plc = 1.0;
  /// Makes a reading when it is asked for one, not on a grid of its own.
  bool on_demand = false;
};

/// @throws std::invalid_argument for a driver whose highest rate is not listed here
inline FastAccelerometer fastest(const std::string& driver) {
  if (driver == "microstrain_mip") return {.rate_hz = 1000.0};
  if (driver == "vectornav") return {.rate_hz = 800.0, .baud = 921600};
  if (driver == "xsens_mti") return {.rate_hz = 400.0};
  if (driver == "iio" || driver == "mavlink") return {.rate_hz = 1000.0};
  if (driver == "witmotion") return {.rate_hz = 200.0, .baud = 115200};
  if (driver == "text_line") return {.rate_hz = 1000.0};
  // A scan of three channels takes 15 ms with the shortest integration time, a measurement of one 5 ms; the
  // rest is for the way to the voltmeters and back, which a busy machine makes long.
  if (driver == "scpi_voltmeter" || driver == "scpi_single")
    return {.rate_hz = 40.0, .integration_plc = 0.02, .on_demand = true};
  throw std::invalid_argument("fastest: what is the highest rate of driver \"" + driver + "\"?");
}

/// An accelerometer driver in real time over pseudo-terminals, with the emulator of its instrument in a
/// thread of this process. The reading of u encodes the time at which it was made.
class EmulatedAccelerometer {
 public:
  explicit EmulatedAccelerometer(const AccelerometerDriver& driver) : fast_(fastest(driver.name)) {
    sim::BenchTruth truth;
    truth.offset = {kFirst, 0.0, 0.0};
    truth.drift_per_hour = {3600.0 * kPerSecond, 0.0, 0.0};
    world_ = std::make_shared<sim::SimBench>(truth, clock_.now());

    BenchConfig config;
    config.items.front().accelerometer.driver = driver.name;
    config.items.front().accelerometer.settings.rate_hz = fast_.rate_hz;
    config.items.front().accelerometer.baud = fast_.baud;
    std::vector<sim::Endpoint> endpoints;
    for (const InstrumentPort& port : accelerometer_ports(config, 1))
      endpoints.push_back({make_firmware(config, port, world_), sim::PtyLink{folder_ / port.name}});
    emulator_ = std::make_unique<sim::Emulator>(std::move(endpoints), clock_);
    thread_ = std::jthread([this](std::stop_token stop) { emulator_->run(std::move(stop)); });

    AccelerometerSettings settings;
    settings.rate_hz = fast_.rate_hz;
    settings.integration_plc = fast_.integration_plc;
    if (fast_.baud) settings.link_bytes_per_s = *fast_.baud / 10.0;
    const wire::SerialSettings serial{
        .path = {}, .baud = driver.serial.baud, .rts_cts = driver.serial.rts_cts};
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    for (const std::string& address : emulator_->addresses())
      streams.push_back(wire::open_stream(address, serial, clock_));
    driver_ = driver.make(std::move(streams), clock_, settings);
  }

  const FastAccelerometer& fast() const { return fast_; }
  Accelerometer& driver() { return *driver_; }
  Clock& clock() { return clock_; }
  std::uint64_t emulator_dropped_bytes() const { return emulator_->dropped_bytes(); }

  /// When a reading was made, to within the resolution of its output (and the time of a scan).
  Clock::Instant made(const Reading& reading) const {
    return world_->start() + from_seconds((reading.output.x() - kFirst) / kPerSecond);
  }

  /// Processor time used so far by this process, but not by the emulator.
  double cpu_seconds() {
    clockid_t emulator{};
    if (::pthread_getcpuclockid(thread_.native_handle(), &emulator) != 0)
      throw std::runtime_error("the emulator's thread has no clock");
    return seconds(CLOCK_PROCESS_CPUTIME_ID) - seconds(emulator);
  }

 private:
  // From -7 to 7 within 70 s: inside the range of every instrument, and more than a step of the coarsest one
  // (WitMotion: 16/32768) from a reading to the next.
  static constexpr double kFirst = -7.0;
  static constexpr double kPerSecond = 0.2;

  static double seconds(clockid_t clock) {
    timespec time{};
    if (::clock_gettime(clock, &time) != 0)
      throw std::runtime_error("a clock of processor time cannot be read");
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
  }

  FastAccelerometer fast_;
  RealClock clock_;
  TemporaryFolder folder_;
  std::shared_ptr<sim::SimBench> world_;
  std::unique_ptr<sim::Emulator> emulator_;
  std::jthread thread_;
  std::unique_ptr<Accelerometer> driver_;
};

}  // namespace abcal::test
