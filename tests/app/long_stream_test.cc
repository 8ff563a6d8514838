// A minute of every accelerometer's fastest stream, in real time over pseudo-terminals: nothing is lost. The
// output drifts with time, so that every reading shows by itself when it was made: a loss is found even if
// instrument and driver agree that there was none.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/fast_accelerometers.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

constexpr Clock::Duration kStreamed = 60s;
// Longer than a busy machine withholds the processor; a stream that pauses for this time has ended.
constexpr Clock::Duration kPatience = 5s;

class LongStream : public testing::TestWithParam<std::string> {
 protected:
  static const AccelerometerDriver& driver() {
    for (const AccelerometerDriver& driver : accelerometer_drivers())
      if (driver.name == GetParam()) return driver;
    throw std::invalid_argument(GetParam());
  }
};

TEST_P(LongStream, LosesNothing) {
  test::EmulatedAccelerometer emulated(driver());
  Accelerometer& accelerometer = emulated.driver();
  const double rate_hz = emulated.fast().rate_hz;
  accelerometer.start();

  std::vector<Reading> readings;
  readings.reserve(static_cast<std::size_t>(rate_hz * to_seconds(kStreamed)) + 1000);
  do {
    const auto reading = accelerometer.next(emulated.clock().now() + kPatience);
    ASSERT_TRUE(reading) << "the stream ended after " << readings.size() << " readings";
    readings.push_back(*reading);
  } while (emulated.made(readings.back()) - emulated.made(readings.front()) < kStreamed);
  const StreamHealth health = accelerometer.health();
  accelerometer.stop();

  EXPECT_EQ(health.lost_readings, 0U);
  EXPECT_EQ(health.bad_frames, 0U);
  EXPECT_EQ(health.skipped_bytes, 0U);
  EXPECT_EQ(emulated.emulator_dropped_bytes(), 0U);

  // By the numbers that the driver gives, and by the time at which each was made.
  const double period_s = 1.0 / rate_hz;
  Clock::Duration latest{};
  for (std::size_t k = 0; k < readings.size(); ++k) {
    const Reading& reading = readings[k];
    ASSERT_EQ(reading.sequence, readings.front().sequence + k);
    const Clock::Duration age = reading.arrival - emulated.made(reading);
    EXPECT_GT(to_seconds(age), -period_s) << "reading " << k << " arrived before it was made";
    latest = std::max(latest, age);
    if (k == 0) continue;
    const double step_s = to_seconds(emulated.made(reading) - emulated.made(readings[k - 1]));
    if (emulated.fast().on_demand) {
      ASSERT_GT(step_s, 0.0) << "reading " << k << " is no new one";
    } else {
      ASSERT_NEAR(step_s, period_s, 0.75 * period_s) << "reading " << k;
    }
  }
  const double span_s = to_seconds(emulated.made(readings.back()) - emulated.made(readings.front()));
  const auto steps = static_cast<double>(readings.size() - 1);
  if (emulated.fast().on_demand) {
    // A scan that a busy machine asks for too late is not made up for: it was never made.
    EXPECT_LE(steps, rate_hz * span_s + 1.0);
  } else {
    EXPECT_NEAR(steps, rate_hz * span_s, 1.0);
  }
  fmt::print("{}: {} readings at {} Hz in {:.3f} s; the latest arrived {:.1f} ms after it was made\n",
             GetParam(), readings.size(), rate_hz, span_s, 1e3 * to_seconds(latest));
}

INSTANTIATE_TEST_SUITE_P(EachDriver, LongStream, testing::ValuesIn([] {
                           std::vector<std::string> names;
                           for (const AccelerometerDriver& driver : accelerometer_drivers())
                             names.push_back(driver.name);
                           return names;
                         }()),
                         [](const auto& name) { return name.param; });

}  // namespace
}  // namespace abcal
