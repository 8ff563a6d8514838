#include "protocol/run/dwell.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "protocol/record/run_record.h"

namespace abcal {
namespace {

std::vector<Reading> readings(const std::vector<double>& u) {
  std::vector<Reading> list;
  for (std::size_t k = 0; k < u.size(); ++k) {
    Reading reading;
    reading.output = Eigen::Vector3d(u[k], 2.0 * u[k], 1.0);
    reading.sequence = k;
    list.push_back(reading);
  }
  return list;
}

std::vector<double> noise(std::size_t n, unsigned seed, double correlation = 0.0) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal;
  std::vector<double> values(n);
  double previous = normal(engine);
  for (double& value : values) {
    previous = correlation * previous + std::sqrt(1.0 - correlation * correlation) * normal(engine);
    value = previous;
  }
  return values;
}

TEST(DwellStatisticsTest, AveragesAndGivesTheSpreadOfOneReading) {
  const DwellStatistics s = dwell_statistics(readings({1.0, 2.0, 3.0, 4.0, 5.0}), {});
  EXPECT_DOUBLE_EQ(s.mean[0], 3.0);
  EXPECT_DOUBLE_EQ(s.mean[1], 6.0);
  EXPECT_DOUBLE_EQ(s.spread[0], std::sqrt(2.5));
  EXPECT_EQ(s.count, 5);
  EXPECT_EQ(s.flags, kFlagNone);
}

TEST(DwellStatisticsTest, StatesAStandardErrorThatHoldsForCorrelatedReadings) {
  // The means of many dwells scatter as their stated uncertainty says: within 12 % over 400 dwells (the
  // scatter of a standard deviation of 400 is 3.5 %; the estimated correlation time of a single dwell is
  // biased a few percent low).
  for (const double correlation : {0.0, 0.6, 0.9}) {
    double squares = 0.0, stated = 0.0;
    constexpr int kDwells = 400;
    for (unsigned k = 0; k < kDwells; ++k) {
      const DwellStatistics s = dwell_statistics(readings(noise(1000, 1 + k, correlation)), {});
      squares += s.mean[0] * s.mean[0];
      stated += s.u_mean[0] * s.u_mean[0];
    }
    EXPECT_NEAR(std::sqrt(stated / squares), 1.0, 0.12) << "correlation " << correlation;
  }
}

TEST(DwellStatisticsTest, NeverClaimsLessThanTheResolutionAllows) {
  AccelerometerInfo info;
  info.resolution = 0.001;
  const DwellStatistics s = dwell_statistics(readings(std::vector<double>(100, 0.5)), info);
  EXPECT_DOUBLE_EQ(s.u_mean[0], 0.001 / std::sqrt(12.0));
}

TEST(DwellStatisticsTest, LeavesOutWhatIsNotFiniteAndSaysSo) {
  const DwellStatistics s = dwell_statistics(readings({1.0, std::nan(""), 3.0}), {});
  EXPECT_EQ(s.count, 2);
  EXPECT_EQ(s.not_finite, 1);
  EXPECT_DOUBLE_EQ(s.mean[0], 2.0);
  EXPECT_TRUE(s.flags & kFlagNotFinite);
}

TEST(DwellStatisticsTest, CountsGapsAndFlagsClipping) {
  std::vector<Reading> list = readings({1.0, 1.1, 0.9, 1.0});
  list[2].sequence = 5;
  list[3].sequence = 6;
  AccelerometerInfo info;
  info.full_scale = 2.2;  // v is twice u
  const DwellStatistics s = dwell_statistics(list, info);
  EXPECT_EQ(s.lost, 3);
  EXPECT_TRUE(s.flags & kFlagLostReadings);
  EXPECT_TRUE(s.flags & kFlagClipped);
}

/// The effective number by its definition, lag by lag.
double effective_number_by_direct_sum(const std::vector<double>& values) {
  const auto n = static_cast<double>(values.size());
  double mean = 0.0, variance = 0.0;
  for (const double value : values) mean += value / n;
  for (const double value : values) variance += (value - mean) * (value - mean);
  double correlation_time = 1.0;
  for (std::size_t lag = 1; lag < values.size() / 4; ++lag) {
    double covariance = 0.0;
    for (std::size_t k = lag; k < values.size(); ++k)
      covariance += (values[k] - mean) * (values[k - lag] - mean);
    if (covariance / variance < 2.0 / std::sqrt(n)) break;
    correlation_time += 2.0 * covariance / variance;
  }
  return std::clamp(n / correlation_time, 1.0, n);
}

TEST(DwellStatisticsTest, TheFastAutocorrelationIsTheDirectSum) {
  for (const std::size_t n : {4U, 5U, 100U, 257U, 1000U, 4099U, 20'000U}) {
    for (const double correlation : {0.0, 0.9, 0.99, 0.999}) {
      const std::vector<double> values = noise(n, 7, correlation);
      const double expected = effective_number_by_direct_sum(values);
      EXPECT_NEAR(effective_number_of_readings(values) / expected, 1.0, 1e-10) << n << ", " << correlation;
    }
  }
  // A ramp correlates over all lags that are summed.
  std::vector<double> ramp(5000);
  for (std::size_t k = 0; k < ramp.size(); ++k) ramp[k] = static_cast<double>(k);
  EXPECT_NEAR(effective_number_of_readings(ramp) / effective_number_by_direct_sum(ramp), 1.0, 1e-10);
}

TEST(QuietTest, SeesASlopeARingDownAndNothingInNoise) {
  int false_alarms = 0;
  for (unsigned seed = 0; seed < 1000; ++seed) {
    if (!is_quiet(readings(noise(50, seed)), Eigen::Vector3d(1.0, 2.0, 0.0), 3.0, 0.0)) ++false_alarms;
  }
  EXPECT_LE(false_alarms,
            2);  // 4.5 sigma: 7e-6 of windows of infinitely many readings; 25 a half have wider tails
  std::vector<double> slope = noise(50, 1);
  for (std::size_t k = 0; k < slope.size(); ++k) slope[k] += 0.1 * static_cast<double>(k);
  EXPECT_FALSE(is_quiet(readings(slope), std::nullopt, 3.0, 0.0));
  std::vector<double> ringing = noise(50, 1);
  for (std::size_t k = 0; k < ringing.size(); ++k) ringing[k] += 8.0 * std::sin(2.0 * static_cast<double>(k));
  EXPECT_FALSE(is_quiet(readings(ringing), Eigen::Vector3d(1.0, 2.0, 0.0), 3.0, 0.0));
  EXPECT_TRUE(is_quiet(readings(ringing), std::nullopt, 3.0, 0.0))
      << "without a usual spread, ringing looks like noise";
}

TEST(QuietTest, AReadingThatIsNotFiniteIsNotQuiet) {
  std::vector<double> values = noise(20, 1);
  values[3] = std::nan("");
  EXPECT_FALSE(is_quiet(readings(values), std::nullopt, 3.0, 0.0));
}

}  // namespace
}  // namespace abcal
