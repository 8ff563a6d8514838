#include "protocol/run/sampling_times.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numbers>
#include <random>
#include <span>
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

/// The arrivals of 6000 readings at 100 Hz on a busy computer: late by what changes from second to second,
/// and by more at times.
std::vector<Reading> busy_readings(double ppm) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> poll(0.0, 1e-3), wave(0.0, 2e-4);
  double now_late = 0.0;
  return late_readings(6000, 100.0, ppm, [&](std::size_t k) {
    if (k % 150 == 0) now_late = wave(random);
    return 2e-3 + now_late + poll(random);
  });
}

/// Mean and slope (over all) of the errors of the times, in microseconds; the mean without 2 ms.
struct TimeErrors {
  double mean_us = 0.0;
  double slope_us = 0.0;
};

TimeErrors errors_of(const SamplingTimes& times, std::span<const Reading> readings, double ppm) {
  const auto error_us = [&](const Reading& reading) {
    const double true_s = static_cast<double>(reading.sequence - 700) / (100.0 * (1.0 + 1e-6 * ppm)) + 2e-3;
    return 1e6 * (to_seconds(times.of(reading.sequence) - kBegin) - true_s);
  };
  const double first = error_us(readings.front()), last = error_us(readings.back());
  return {0.5 * (first + last), last - first};
}

/// Places sweeps of 700 readings, with 300 in front of each, as a run does.
std::vector<TimeErrors> place_sweeps(std::vector<Reading>& readings, double ppm,
                                     std::vector<double>* u_us = nullptr) {
  SamplingClock clock;
  std::vector<TimeErrors> errors;
  const std::span<const Reading> all(readings);
  for (std::size_t begin = 0; begin + 1000 <= all.size(); begin += 1000) {
    const auto sweep = all.subspan(begin + 300, 700);
    clock.hear(all.subspan(begin, 300));
    clock.hear(sweep);
    const auto placed = clock.times_of(sweep);
    if (!placed) return {};
    errors.push_back(errors_of(placed->times, sweep, ppm));
    if (u_us != nullptr) u_us->push_back(1e6 * placed->u_s);
  }
  return errors;
}

TEST(SamplingClockTest, TheDelaysOfASecondDoNotTurnASweep) {
  std::vector<Reading> readings = busy_readings(30.0);
  std::vector<double> u_us;
  const std::vector<TimeErrors> errors = place_sweeps(readings, 30.0, &u_us);
  ASSERT_EQ(errors.size(), 6U);
  double own_slope = 0.0, slope = 0.0;
  for (std::size_t k = 2; k < 6; ++k) {
    const std::span<const Reading> sweep = std::span<const Reading>(readings).subspan(1000 * k + 300, 700);
    own_slope += std::abs(errors_of(*fit_sampling_times(sweep), sweep, 30.0).slope_us);
    slope += std::abs(errors[k].slope_us);
    EXPECT_LT(std::abs(errors[k].slope_us), 4.0 * u_us[k]);
    EXPECT_LT(std::abs(errors[k].mean_us - errors.back().mean_us), 4.0 * u_us[k]);
    EXPECT_LT(u_us[k], 30.0);
  }
  EXPECT_LT(slope, 0.3 * own_slope);
}

TEST(SamplingClockTest, NoSingleArrivalMovesIt) {
  std::vector<Reading> readings = busy_readings(0.0);
  const auto sweep = std::span<const Reading>(readings).subspan(5300, 700);
  const auto lowest = [&] { return errors_of(fit_sampling_times(sweep).value(), sweep, 0.0); };
  const TimeErrors lowest_before = lowest();
  const std::vector<TimeErrors> before = place_sweeps(readings, 0.0);
  readings[5900].arrival -= 2ms;
  const TimeErrors lowest_after = lowest();
  const std::vector<TimeErrors> after = place_sweeps(readings, 0.0);
  ASSERT_EQ(after.size(), 6U);
  // The line below all arrivals goes with it; a median moves to its neighbour.
  const double moved_us = std::abs(lowest_after.mean_us - lowest_before.mean_us);
  EXPECT_GT(moved_us, 1000.0);
  EXPECT_LT(std::abs(after.back().mean_us - before.back().mean_us), 0.03 * moved_us);
  EXPECT_LT(std::abs(after.back().slope_us - before.back().slope_us), 0.03 * moved_us);
}

TEST(SamplingClockTest, WhatWasBeforeAGapOrAChangeHasNoPart) {
  const auto even = late_readings(6000, 100.0, 0.0, [](std::size_t) { return 0.0; });
  std::vector<Reading> readings = even;
  // Three readings that nobody has counted, and one that somebody has, between the sweeps.
  for (std::size_t k = 3100; k < 6000; ++k) readings[k].arrival += 30ms;
  for (std::size_t k = 5100; k < 6000; ++k) {
    readings[k].sequence += 1;
    readings[k].arrival += 10ms;
  }
  const std::vector<TimeErrors> errors = place_sweeps(readings, 0.0);
  ASSERT_EQ(errors.size(), 6U);
  EXPECT_NEAR(errors[2].mean_us + 2e3, 0.0, 1.0);
  EXPECT_NEAR(errors[3].mean_us + 2e3, 30e3, 1.0);
  EXPECT_NEAR(errors[5].mean_us + 2e3, 30e3, 1.0);
  for (const TimeErrors& each : errors) EXPECT_NEAR(each.slope_us, 0.0, 1.0);
}

// One reading of each second is late by less than all others. Their lines from one to another lean to either
// side in pairs, so that the median of all is level; half of them are within 5 us of it. The line is best
// known in the middle of the eleven seconds.
TEST(SamplingClockTest, ItsUncertaintyIsThatOfAMedianLine) {
  constexpr std::array<double, 11> kLateUs{0.0, 5.0, -5.0, 9.0, -9.0, 0.0, -9.0, 9.0, -5.0, 5.0, 0.0};
  const auto readings = late_readings(
      1100, 100.0, 0.0, [&](std::size_t k) { return k % 100 == 50 ? 1e-6 * kLateUs[k / 100] : 1e-3; });
  const double u_middle = std::sqrt(std::numbers::pi / 2.0) * 1.4826 * 5e-6 / std::sqrt(11.0);
  for (const std::size_t before : {0U, 300U, 700U}) {
    const auto sweep = std::span<const Reading>(readings).subspan(before);
    SamplingClock clock;
    clock.hear(std::span<const Reading>(readings).first(before));
    clock.hear(sweep);
    const auto placed = clock.times_of(sweep);
    ASSERT_TRUE(placed);
    EXPECT_EQ(placed->times.period, 10ms);
    EXPECT_EQ(placed->times.of(700), kBegin);
    const double off = 0.5 * static_cast<double>(before) / 1099.0;  // The middle, as part of the whole.
    EXPECT_NEAR(placed->u_s, u_middle * std::sqrt(1.0 + 12.0 * off * off), 1e-4 * u_middle) << before;
  }
}

TEST(SamplingClockTest, ReadingsThatFollowNoLineHaveNone) {
  SamplingClock clock;
  const auto slower =
      late_readings(1000, 100.0, 0.0, [](std::size_t k) { return 1e-7 * static_cast<double>(k * k); });
  clock.hear(slower);
  EXPECT_FALSE(clock.times_of(slower));
  const auto few = late_readings(15, 100.0, 0.0, [](std::size_t) { return 0.0; });
  clock.hear(few);
  EXPECT_FALSE(clock.times_of(few));
}

}  // namespace
}  // namespace abcal
