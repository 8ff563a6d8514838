#include "protocol/run/sampling_times.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <random>
#include <vector>

namespace abcal {
namespace {

using namespace std::chrono_literals;

const Clock::Instant kBegin(1000s);

/// Readings of an instrument whose clock runs fast by `ppm`, each late by `delay_s(k)`.
std::vector<Reading> late_readings(std::size_t count, double rate_hz, double ppm,
                                   const std::function<double(std::size_t)>& delay_s) {
  std::vector<Reading> readings(count);
  for (std::size_t k = 0; k < count; ++k) {
    readings[k].sequence = 700 + k;
    readings[k].arrival =
        kBegin + from_seconds(static_cast<double>(k) / (rate_hz * (1.0 + 1e-6 * ppm)) + delay_s(k));
  }
  return readings;
}

/// Largest difference from the true times, in seconds.
double worst_error(const SamplingTimes& times, std::size_t count, double rate_hz, double ppm) {
  double worst = 0.0;
  for (std::size_t k = 0; k < count; ++k) {
    const double true_s = static_cast<double>(k) / (rate_hz * (1.0 + 1e-6 * ppm));
    worst = std::max(worst, std::abs(to_seconds(times.of(700 + k) - kBegin) - true_s));
  }
  return worst;
}

TEST(SamplingTimesTest, EvenReadingsKeepTheirTimes) {
  const auto readings = late_readings(1000, 100.0, 0.0, [](std::size_t) { return 0.0; });
  const auto times = fit_sampling_times(readings);
  ASSERT_TRUE(times);
  EXPECT_EQ(times->period, 10ms);
  for (const Reading& reading : readings) EXPECT_EQ(times->of(reading.sequence), reading.arrival);
}

TEST(SamplingTimesTest, DelaysOfTheComputerAreKeptOut) {
  for (const double rate_hz : {100.0, 1000.0, 4000.0}) {
    std::mt19937_64 random(1);
    std::exponential_distribution<double> often(1.0 / 2e-4);
    std::uniform_real_distribution<double> seldom(0.0, 1.0);
    double hold_until = 0.0;  // The program is stopped for 12 ms at times; what came meanwhile comes at once.
    const auto delay = [&](std::size_t k) {
      const double now = static_cast<double>(k) / rate_hz;
      if (seldom(random) < 0.5 / rate_hz) hold_until = now + 0.012;
      return std::max(often(random), hold_until - now);
    };
    const auto count = static_cast<std::size_t>(2.0 * rate_hz);
    const auto times = fit_sampling_times(late_readings(count, rate_hz, 80.0, delay));
    ASSERT_TRUE(times) << rate_hz;
    EXPECT_LT(worst_error(*times, count, rate_hz, 80.0), 1e-4) << rate_hz;
  }
}

TEST(SamplingTimesTest, ReadingsThatComeInBunchesLieOnTheLineOfTheLastOfEach) {
  // A USB adapter that hands over what it has every 16 ms.
  const auto bunch = [](std::size_t k) { return 1e-3 * static_cast<double>(15 - k % 16); };
  const auto times = fit_sampling_times(late_readings(1600, 1000.0, 0.0, bunch));
  ASSERT_TRUE(times);
  EXPECT_LT(worst_error(*times, 1600, 1000.0, 0.0), 1e-6);
}

TEST(SamplingTimesTest, LostReadingsLeaveGaps) {
  auto readings = late_readings(1000, 1000.0, 0.0, [](std::size_t) { return 0.0; });
  readings.erase(readings.begin() + 300, readings.begin() + 350);
  const auto times = fit_sampling_times(readings);
  ASSERT_TRUE(times);
  EXPECT_LT(worst_error(*times, 1000, 1000.0, 0.0), 1e-9);
}

TEST(SamplingTimesTest, NoLineIsForcedOnReadingsThatFollowNone) {
  // A board whose loop takes longer and longer: its readings are not even.
  const auto slower = [](std::size_t k) { return 1e-7 * static_cast<double>(k * k); };
  EXPECT_FALSE(fit_sampling_times(late_readings(1000, 100.0, 0.0, slower)));
  // Five readings that nobody has counted as lost: a jump by five periods.
  const auto jump = [](std::size_t k) { return k < 500 ? 0.0 : 5e-2; };
  EXPECT_FALSE(fit_sampling_times(late_readings(1000, 100.0, 0.0, jump)));
  EXPECT_FALSE(fit_sampling_times(late_readings(15, 100.0, 0.0, [](std::size_t) { return 0.0; })));
  auto twice = late_readings(100, 100.0, 0.0, [](std::size_t) { return 0.0; });
  twice[50].sequence = twice[49].sequence;
  EXPECT_FALSE(fit_sampling_times(twice));
}

}  // namespace
}  // namespace abcal
