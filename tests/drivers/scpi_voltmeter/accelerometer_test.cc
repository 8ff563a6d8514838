#include "drivers/scpi_voltmeter/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/sim_clock.h"

namespace abcal {
namespace {
TEST(Probe, X) {
  for (auto [family, channels] : {std::pair{sim::ScpiFamily::kKeysight34970a, std::array{101, 102, 103}},
                                  {sim::ScpiFamily::kKeithley2700, {101, 102, 103}}}) {
    sim::SimClock clock;
    auto bench = std::make_shared<sim::SimBench>(sim::BenchTruth{});
    sim::ScpiVoltmeterSettings s{.family = family, .channels = channels};
    auto fw = std::make_shared<sim::ScpiVoltmeterFirmware>(bench, s);
    AccelerometerSettings settings;
    settings.rate_hz = 5;
    ScpiScanningVoltmeter v(std::make_unique<sim::FirmwareStream>(fw, clock), clock, settings);
    EXPECT_NO_THROW(try { v.start(); } catch (std::exception& e) { std::puts(e.what()); throw; });
    auto r = v.next(clock.now() + std::chrono::seconds(5));
    ASSERT_TRUE(r);
    EXPECT_EQ(r->output, Eigen::Vector3d(0, 0, 1));
  }
}
}  // namespace
}  // namespace abcal
