#include "sim/firmware/text_line_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// Output of a board in `duration`.
std::string printed(const TextLineSettings& settings, const BenchTruth& truth, Clock::Duration duration) {
  TextLineFirmware firmware(std::make_shared<SimBench>(truth), settings);
  FirmwareHost host(firmware);
  return host.listen(duration);
}

std::size_t lines_of(const std::string& text) {
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

BenchTruth with_offset() {
  BenchTruth truth;
  truth.offset = Eigen::Vector3d(0.25, -0.5, 0.125);
  return truth;
}

TEST(TextLineFirmwareTest, PrintsTheOutputsAtItsRate) {
  TextLineSettings settings;
  settings.rate_hz = 2.0;
  settings.decimals = 3;
  EXPECT_EQ(printed(settings, with_offset(), seconds(1)), "0.250,-0.500,1.125\r\n0.250,-0.500,1.125\r\n");
  settings.rate_hz = 200.0;
  EXPECT_EQ(lines_of(printed(settings, with_offset(), seconds(10))), 2000U);
}

TEST(TextLineFirmwareTest, PrintsAsItIsSet) {
  TextLineSettings settings;
  settings.rate_hz = 4.0;
  settings.header = "# ms;u;v;w";
  settings.time_column = true;
  settings.crlf = false;
  settings.separator = ";";
  settings.decimals = 0;
  settings.scale = {4096.0, 4096.0, -4096.0};
  settings.bias = {0.0, 8.0, 0.0};
  EXPECT_EQ(printed(settings, with_offset(), milliseconds(500)),
            "# ms;u;v;w\n250;1024;-2040;-4608\n500;1024;-2040;-4608\n");
}

TEST(TextLineFirmwareTest, PrintsTheHeaderOnceAtPowerOn) {
  TextLineSettings settings;
  settings.header = "hello";
  TextLineFirmware firmware(std::make_shared<SimBench>(BenchTruth{}), settings);
  FirmwareHost host(firmware);
  EXPECT_EQ(host.listen(milliseconds(9)), "hello\r\n");
  EXPECT_EQ(lines_of(host.listen(seconds(1))), 100U);
}

TEST(TextLineFirmwareTest, PrintsTheEnvironment) {
  TextLineSettings settings;
  settings.content = TextLineSettings::Content::kEnvironment;
  settings.rate_hz = 1.0 / 1800.0;
  settings.decimals = 1;
  settings.humidity_percent = 38.5;
  settings.pressure_hpa = 987.25;
  settings.separator = " ";
  BenchTruth truth;
  truth.temperature_degc = 21.0;
  truth.temperature_per_hour = 2.0;
  EXPECT_EQ(printed(settings, truth, std::chrono::hours(1)), "22.0 38.5 987.2\r\n23.0 38.5 987.2\r\n");
}

TEST(TextLineFirmwareTest, FollowsTheStage) {
  TextLineSettings settings;
  settings.rate_hz = 1.0;
  settings.decimals = 2;
  auto bench = std::make_shared<SimBench>(BenchTruth{});
  TextLineFirmware firmware(bench, settings);
  FirmwareHost host(firmware);
  EXPECT_EQ(host.listen(seconds(1)), "0.00,0.00,1.00\r\n");
  bench->move(StageAxis::kX, Angle::degrees(180.0), host.clock().now());
  host.listen(seconds(60));
  const std::string after = host.listen(seconds(1));
  EXPECT_THAT(after, testing::EndsWith(",-1.00\r\n"));
}

TEST(TextLineFirmwareTest, HearsNothing) {
  TextLineFirmware firmware(std::make_shared<SimBench>(BenchTruth{}));
  FirmwareHost host(firmware);
  EXPECT_EQ(host.exchange("*IDN?\r\n"), "");
  EXPECT_EQ(lines_of(host.listen(milliseconds(99))), 10U);
}

TEST(TextLineFirmwareTest, ShowsTheFaultsOfTheWorld) {
  TextLineSettings settings;
  settings.rate_hz = 1.0;
  settings.decimals = 1;
  auto bench = std::make_shared<SimBench>(BenchTruth{});
  TextLineFirmware firmware(bench, settings);
  FirmwareHost host(firmware);
  const Clock::Instant start = bench->start();
  bench->inject(
      {.kind = FaultKind::kNotFinite, .at = start + milliseconds(500), .until = start + milliseconds(1500)});
  bench->inject(
      {.kind = FaultKind::kNoOutput, .at = start + milliseconds(1500), .until = start + milliseconds(2500)});
  EXPECT_EQ(host.listen(seconds(1)), "nan,nan,nan\r\n");
  EXPECT_EQ(host.listen(seconds(1)), "");
  EXPECT_EQ(host.listen(seconds(1)), "0.0,0.0,1.0\r\n");
}

TEST(TextLineFirmwareTest, RefusesSettingsThatCannotBe) {
  const auto make = [](double rate_hz, int decimals) {
    TextLineSettings settings;
    settings.rate_hz = rate_hz;
    settings.decimals = decimals;
    TextLineFirmware(std::make_shared<SimBench>(BenchTruth{}), settings);
  };
  EXPECT_THROW(make(0.0, 6), std::invalid_argument);
  EXPECT_THROW(make(std::nan(""), 6), std::invalid_argument);
  EXPECT_THROW(make(100.0, -1), std::invalid_argument);
  EXPECT_THROW(make(100.0, 18), std::invalid_argument);
  EXPECT_NO_THROW(make(100.0, 0));
}

TEST(TextLineFirmwareTest, PrintsItsHeaderAgainWhenPowerIsBack) {
  TextLineSettings settings;
  settings.rate_hz = 10.0;
  settings.header = "# u,v,w";
  TextLineFirmware firmware(std::make_shared<SimBench>(with_offset()), settings);
  FirmwareHost host(firmware);
  EXPECT_EQ(lines_of(host.listen(seconds(1))), 11U);
  firmware.power(false, host.clock().now());
  host.clock().sleep_until(host.clock().now() + seconds(5));
  firmware.power(true, host.clock().now());
  const std::string again = host.listen(seconds(1));
  EXPECT_EQ(again.substr(0, 7), "# u,v,w");
  EXPECT_EQ(lines_of(again), 11U) << "nothing of the time without power";
}

}  // namespace
}  // namespace abcal::sim
