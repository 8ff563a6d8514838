#include "protocol/estimators/circle/level_estimator.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "protocol/model/alignment.h"

namespace abcal {
namespace {

struct Bench {
  Alignment alignment;
  Angle x_zero;  ///< Actual minus commanded angle of X, everywhere.
  Eigen::Matrix3d sensitivity =
      (Eigen::Matrix3d() << 1.05, -0.08, 0.03, 0.11, 0.93, -0.05, -0.02, 0.07, 1.01).finished();
  Eigen::Vector3d offset{0.05, -0.12, 0.2};
};

/// Readings by turning the accelerometer with the stage: first about Z, then about X, which carries Z.
DwellRecord at_position(const Bench& bench, double x_deg, double z_deg) {
  DwellRecord dwell;
  dwell.commanded_x = Angle::degrees(x_deg);
  dwell.commanded_z = Angle::degrees(z_deg);
  for (int j = 0; j < 3; ++j) {
    const Eigen::Vector3d row = bench.sensitivity.row(j);
    const Eigen::Vector3d turned = rodrigues(rodrigues(row, bench.alignment.z_axis(), dwell.commanded_z),
                                             bench.alignment.x_axis(), dwell.commanded_x + bench.x_zero);
    dwell.mean(j) = turned.z() + bench.offset(j);
  }
  return dwell;
}

std::vector<DwellRecord> spin(const Bench& bench, double noise, unsigned seed, int steps = 36) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, noise);
  std::vector<DwellRecord> dwells;
  for (int i = 0; i < steps; ++i) {
    DwellRecord dwell = at_position(bench, 0.0, 360.0 * i / steps);
    for (int j = 0; j < 3; ++j) dwell.mean(j) += noise > 0.0 ? normal(engine) : 0.0;
    if (noise > 0.0) dwell.u_mean = Eigen::Vector3d::Constant(noise);
    dwells.push_back(dwell);
  }
  return dwells;
}

TEST(TiltOfZTest, RecoversTheTilt) {
  Bench bench;
  bench.alignment = {4e-5, -3e-5, 1e-4};
  const TiltOfZ tilt = tilt_from_spin(spin(bench, 0.0, 0), bench.sensitivity);
  // First order in the tilt; the second is 2.5e-9.
  EXPECT_NEAR(tilt.zx.value, 4e-5, 5e-9);
  EXPECT_NEAR(tilt.zy.value, -3e-5, 5e-9);
  EXPECT_NEAR(tilt.delta_z.value, 5e-5, 5e-9);  // the paper's own
}

TEST(TiltOfZTest, UncertaintyCoversTheTruth) {
  Bench bench;
  bench.alignment = {4e-5, -3e-5, 0.0};
  double squares = 0.0;
  constexpr int kRuns = 300;
  for (unsigned seed = 1; seed <= kRuns; ++seed) {
    std::vector<DwellRecord> dwells = spin(bench, 1e-5, seed);
    // Drift over the spin must not look like tilt.
    for (std::size_t i = 0; i < dwells.size(); ++i) {
      dwells[i].time_s = static_cast<double>(i);
      dwells[i].mean += Eigen::Vector3d::Constant(1e-6 * static_cast<double>(i));
    }
    const TiltOfZ tilt = tilt_from_spin(dwells, bench.sensitivity);
    squares += std::pow((tilt.zx.value - 4e-5) / tilt.zx.standard_uncertainty, 2) +
               std::pow((tilt.zy.value + 3e-5) / tilt.zy.standard_uncertainty, 2) +
               std::pow((tilt.delta_z.value - 5e-5) / tilt.delta_z.standard_uncertainty, 2);
    EXPECT_TRUE(tilt.chi2.has_value());
  }
  EXPECT_NEAR(squares / (3.0 * kRuns), 1.0, 0.2);  // 900 squares, delta_z not independent
}

TEST(TiltOfZTest, UncertaintyComesFromTheResidualsWhereReadingsHaveNone) {
  Bench bench;
  bench.alignment = {4e-5, -3e-5, 0.0};
  std::vector<DwellRecord> dwells = spin(bench, 1e-5, 7);
  const TiltOfZ with = tilt_from_spin(dwells, bench.sensitivity);
  for (DwellRecord& dwell : dwells) dwell.u_mean.reset();
  const TiltOfZ without = tilt_from_spin(dwells, bench.sensitivity);
  EXPECT_FALSE(without.chi2.has_value());
  EXPECT_NEAR(without.zx.standard_uncertainty / with.zx.standard_uncertainty, 1.0,
              0.25);  // 103 degrees of freedom
}

TEST(TiltOfZTest, RefusesWhatHidesTheTilt) {
  const Bench bench;
  std::vector<DwellRecord> dwells = spin(bench, 0.0, 0);
  EXPECT_THROW(tilt_from_spin({}, bench.sensitivity), std::runtime_error);
  EXPECT_THROW(tilt_from_spin(std::vector<DwellRecord>(10, dwells[3]), bench.sensitivity),
               std::runtime_error);
  EXPECT_THROW(tilt_from_spin(dwells, Eigen::Matrix3d::Zero()), std::runtime_error);
  dwells[2].commanded_x = Angle::degrees(90.0);
  EXPECT_THROW(tilt_from_spin(dwells, bench.sensitivity), std::invalid_argument);
  dwells[2].commanded_x = Angle::degrees(0.0);
  dwells[4].mean(0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(tilt_from_spin(dwells, bench.sensitivity), std::invalid_argument);
}

std::vector<DwellRecord> reversal(const Bench& bench) {
  return {at_position(bench, 0.0, 0.0), at_position(bench, 0.0, 180.0), at_position(bench, 180.0, 0.0),
          at_position(bench, 180.0, 180.0)};
}

TEST(XZeroTest, RecoversTheZeroOfXWhateverTheOffsetAndTheDrift) {
  Bench bench;
  bench.x_zero = Angle::degrees(0.02);
  bench.alignment = {1e-4, 0.0, 2e-4};
  std::vector<DwellRecord> dwells = reversal(bench);
  for (std::size_t i = 0; i < 4; ++i)
    dwells[i].mean += Eigen::Vector3d::Constant(1e-3 * static_cast<double>(i));
  const XZero zero = x_zero_from_reversal(dwells, bench.sensitivity, Tolerances{});
  EXPECT_NEAR(zero.error.value, 0.02, 1e-5);  // second order: 3.5e-4 rad times 3e-4
  EXPECT_NEAR(zero.zx_plus_xz.value, 3e-4, 2e-7);
  EXPECT_NEAR(*zero.error.type_b, 0.004, 1e-12);  // half of 0.008 degrees
}

TEST(XZeroTest, LeanOfZActsAsAnErrorOfTheOppositeSign) {
  Bench bench;
  bench.alignment = {0.0, 3e-4, 0.0};
  const XZero zero = x_zero_from_reversal(reversal(bench), bench.sensitivity, Tolerances{});
  EXPECT_NEAR(Angle::degrees(zero.error.value).rad(), -3e-4, 2e-7);
}

TEST(XZeroTest, UncertaintyFollowsTheReadings) {
  const Bench bench;
  std::vector<DwellRecord> dwells = reversal(bench);
  for (DwellRecord& dwell : dwells) dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
  const XZero once = x_zero_from_reversal(dwells, bench.sensitivity, Tolerances{});
  // A quarter of the sum of four readings: 5e-6, over the length of the y column.
  EXPECT_NEAR(Angle::degrees(*once.error.type_a).rad(), 5e-6 / bench.sensitivity.col(1).norm(), 2e-7);
  std::vector<DwellRecord> twice = dwells;
  twice.insert(twice.end(), dwells.begin(), dwells.end());
  EXPECT_NEAR(*x_zero_from_reversal(twice, bench.sensitivity, Tolerances{}).error.type_a * std::sqrt(2.0),
              *once.error.type_a, 1e-12);
}

TEST(XZeroTest, NamesTheMissingPosition) {
  const Bench bench;
  std::vector<DwellRecord> dwells = reversal(bench);
  dwells.pop_back();
  EXPECT_THROW(x_zero_from_reversal(dwells, bench.sensitivity, Tolerances{}), std::invalid_argument);
  dwells.push_back(at_position(bench, 90.0, 0.0));
  EXPECT_THROW(x_zero_from_reversal(dwells, bench.sensitivity, Tolerances{}), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
