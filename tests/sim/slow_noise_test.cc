#include "sim/slow_noise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace abcal::sim {
namespace {

constexpr int kSeeds = 4000;  // relative standard deviation of a variance over them: 0.022

TEST(MarkovNoiseTest, ARandomWalkGrowsWithTheRootOfTime) {
  double quarter = 0.0;
  double whole = 0.0;
  double second = 0.0;
  double increment = 0.0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    MarkovNoise walk(static_cast<std::uint64_t>(seed), NoiseStream::kRandomWalk, 100.0, std::nullopt);
    EXPECT_EQ(walk.at(0.0).norm(), 0.0);
    quarter += walk.at(25.0).squaredNorm() / 3.0;
    whole += walk.at(100.0).squaredNorm() / 3.0;
    second += walk.at(173.0).squaredNorm() / 3.0;
    increment += (walk.at(63.0) - walk.at(62.0)).squaredNorm() / 3.0;
  }
  // Three outputs: a standard deviation of 0.013; five of them.
  EXPECT_NEAR(quarter / kSeeds, 0.25, 0.25 * 0.065);
  EXPECT_NEAR(whole / kSeeds, 1.0, 0.065);
  EXPECT_NEAR(second / kSeeds, 1.73, 1.73 * 0.065);
  EXPECT_NEAR(increment / kSeeds, 0.01, 0.01 * 0.065);
}

TEST(MarkovNoiseTest, ACorrelatedProcessIsStationaryAndForgetsExponentially) {
  double variance = 0.0;
  double lag_5 = 0.0;
  double across = 0.0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    MarkovNoise noise(static_cast<std::uint64_t>(seed), NoiseStream::kCorrelated, 100.0, 0.1);  // 10 s
    variance += noise.at(37.0).squaredNorm() / 3.0;
    lag_5 += noise.at(37.0).dot(noise.at(42.0)) / 3.0;
    across += noise.at(98.0).dot(noise.at(103.0)) / 3.0;  // over the end of a block
  }
  EXPECT_NEAR(variance / kSeeds, 1.0, 0.065);
  EXPECT_NEAR(lag_5 / kSeeds, std::exp(-0.5), 0.06);
  EXPECT_NEAR(across / kSeeds, std::exp(-0.5), 0.06);
}

TEST(MarkovNoiseTest, DoesNotDependOnTheOrderInWhichItIsAsked) {
  MarkovNoise forth(7, NoiseStream::kCorrelated, 60.0, 0.3);
  MarkovNoise back(7, NoiseStream::kCorrelated, 60.0, 0.3);
  std::vector<Eigen::Vector3d> values;
  for (int i = 0; i <= 500; ++i) values.push_back(forth.at(0.7 * i));
  for (int i = 500; i >= 0; --i) EXPECT_EQ(back.at(0.7 * i), values[static_cast<std::size_t>(i)]);
}

TEST(MarkovNoiseTest, RefusesATimeThatIsNone) {
  MarkovNoise walk(1, NoiseStream::kRandomWalk, 60.0, std::nullopt);
  EXPECT_THROW(walk.at(-1.0), std::invalid_argument);
  EXPECT_THROW(walk.at(std::numeric_limits<double>::quiet_NaN()), std::invalid_argument);
  EXPECT_THROW(walk.at(1e12), std::invalid_argument);
}

TEST(FlickerNoiseTest, HasUnitSizeAndEqualPowerInEveryOctave) {
  double variance = 0.0;
  double slow = 0.0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    const FlickerNoise noise(static_cast<std::uint64_t>(seed), 100.0);
    variance += noise.at(40.0).squaredNorm() / 3.0;
    // A difference over the time tau keeps waves faster than a sixth of 1/tau.
    slow += (noise.at(40.0) - noise.at(40.0 + 100.0 / 64.0)).squaredNorm() / 6.0;
  }
  EXPECT_NEAR(variance / kSeeds, 1.0, 0.065);
  // The mean of 1 - cos(2 pi f tau) over the ten octaves of f tau from 2^-8 to 4 is
  // (gamma + ln(8 pi) - Ci(8 pi)) / (10 ln 2).
  EXPECT_NEAR(slow / kSeeds, 0.5486, 0.05);
}

}  // namespace
}  // namespace abcal::sim
