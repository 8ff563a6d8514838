// Whether the U of a joint result may be certified: Monte Carlo with the truth drawn from what the run leaves
// possible.
#include "protocol/uncertainty/certified_uncertainty.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "protocol/estimators/joint/joint_result.h"
#include "protocol/record/imported_dwells.h"
#include "protocol/uncertainty/joint_trials.h"
#include "protocol/uncertainty/type_b.h"

namespace abcal {
namespace {

constexpr double kWhiteNoise = 1e-5;

/// 3 x 24 readings of a stage with errors of the stated sizes, with white noise and the hysteresis of the
/// item `hysteresis`, by the signs of the changes from reading to reading.
RunRecord measured_with_hysteresis(double hysteresis) {
  constexpr int kSteps = 24;
  RunRecord record;
  record.source = "simulated";
  record.steps = kSteps;
  record.step = Angle::degrees(360.0 / kSteps);
  record.tolerances = without_further_effects({});
  record.tolerances.hysteresis = 2e-5;
  TypeBStudy study;
  study.design = AbcDesign::uniform(kSteps, record.step);
  study.accelerometer = table_2_accelerometer();
  study.tolerances = record.tolerances;
  const TypeBDraw drawn = type_b_draw(study, 3);
  const auto readings = simulated_readings(study.design, drawn.accelerometer, drawn.errors);
  RandomStream stream(1, StreamPurpose::kTest, 78);
  Eigen::Vector3d before = readings[0].row(0).transpose();
  for (int i = 0; i < 3; ++i) {
    for (int n = 0; n < kSteps; ++n) {
      DwellRecord dwell;
      dwell.experiment = i + 1;
      dwell.n = n + 1;
      dwell.alpha = record.step * n;
      set_commanded_angles(dwell);
      dwell.time_s = 10.0 * static_cast<double>(record.dwells.size());
      const Eigen::Vector3d exact = readings[static_cast<std::size_t>(i)].row(n).transpose();
      dwell.mean = exact + hysteresis * signs_of_change(before, exact);
      before = exact;
      for (double& reading : dwell.mean) reading += kWhiteNoise * stream.normal();
      dwell.u_mean = Eigen::Vector3d::Constant(kWhiteNoise);
      record.dwells.push_back(dwell);
    }
  }
  return record;
}

// The rank of the bound: fewer than 1887 of 2000 errors are below the quantile 0.9545 with a probability of
// at most 1 %, fewer than 1888 with more (sums of binomial probabilities).
TEST(CertifiedUncertaintyTest, TheQuantileHasALowerBoundOf99Percent) {
  std::vector<double> magnitudes(2000);
  std::iota(magnitudes.rbegin(), magnitudes.rend(), 1.0);
  const ErrorQuantile found = error_quantile(magnitudes, 0.9544997361036416);
  EXPECT_EQ(found.found, 1909.0);
  EXPECT_EQ(found.lower, 1887.0);
  std::vector<double> hundred(100);
  std::iota(hundred.begin(), hundred.end(), 1.0);
  EXPECT_EQ(error_quantile(hundred, 0.5).lower, 38.0);
  std::vector<double> few(2, 1.0);
  EXPECT_THROW(error_quantile(few, 0.5), std::invalid_argument);
}

TEST(CertifiedUncertaintyTest, OnlyALargerUByMonteCarloIsTaken) {
  CertifiedUncertainty made;
  for (CertifiedExpanded& one : made.outputs) one = {2.0, {2.0, 1.9}};
  made.outputs[0] = {2.0, {2.5, 2.1}};  // the bound is 1.05 times the stated one, not more
  made.outputs[1] = {2.0, {1.0, 0.9}};  // smaller
  made.outputs[2] = {2.0, {2.09, 2.0999}};
  EXPECT_FALSE(made.any_larger());
  EXPECT_EQ(made.standard_uncertainty(1, 2.0), 0.0);
  made.outputs[15] = {2.0, {2.4, 2.1001}};
  EXPECT_TRUE(made.any_larger());
  EXPECT_EQ(made.larger(), "phi_uv");
  EXPECT_EQ(made.standard_uncertainty(15, 2.0), 1.2);
  EXPECT_EQ(made.standard_uncertainty(0, 2.0), 0.0);
}

TEST(CertifiedUncertaintyTest, NoCombinationOfOutputsBecomesLessUncertain) {
  Covariance12 stated = Covariance12::Identity();
  stated(0, 1) = stated(1, 0) = 0.9;
  stated *= 1e-10;
  CertifiedUncertainty made;
  made.mean_squares.topLeftCorner<12, 12>() = 0.5e-10 * Covariance12::Identity();
  made.mean_squares(3, 3) = 9e-10;
  const Covariance12 found = made.covariance(stated);
  const auto least = [](const Covariance12& m) {
    return Eigen::SelfAdjointEigenSolver<Covariance12>(m).eigenvalues().minCoeff();
  };
  EXPECT_GT(least(found - stated), -1e-20);
  EXPECT_GT(least(found - made.mean_squares.topLeftCorner<12, 12>()), -1e-20);
  EXPECT_NEAR(found(3, 3), 9e-10, 1e-16);
  EXPECT_NEAR(found(5, 5), 1e-10, 1e-16);
}

// With white noise alone the posterior is the normal distribution of the fit: 4000 draws give variances to 1
// / sqrt(2000) and correlations to 1 / sqrt(4000) at most; four times that.
TEST(CertifiedUncertaintyTest, TheTruthsHaveTheCovarianceOfTheFit) {
  const RunRecord record = measured_with_hysteresis(0.0);
  JointOptions options;
  options.noise_process = false;
  const ItemFit own = fit_item(record, options);
  ASSERT_TRUE(own.solution);
  const JointTrials trials(own, record, 5, TruthFrom::kPosterior);
  const EffectFit& fit = own.solution->fit;
  constexpr std::uint64_t kDraws = 4000;
  const Eigen::VectorXd u = fit.covariance.diagonal().cwiseSqrt();
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(u.size());
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(u.size(), u.size());
  for (std::uint64_t t = 0; t < kDraws; ++t) {
    const Eigen::VectorXd z = (trials.draw(t).value - fit.value).cwiseQuotient(u);
    mean += z / kDraws;
    squares += z * z.transpose() / kDraws;
  }
  const Eigen::MatrixXd expected =
      u.cwiseInverse().asDiagonal() * fit.covariance * u.cwiseInverse().asDiagonal();
  EXPECT_LT(mean.cwiseAbs().maxCoeff(), 4.0 / std::sqrt(4000.0));
  EXPECT_LT((squares - expected).cwiseAbs().maxCoeff(), 4.0 / std::sqrt(2000.0));
}

// Signs that are wrong at some angles of the fit: a trial has the signs of its own truth, and its error is
// larger than U. With the signs of the solution it is not.
TEST(CertifiedUncertaintyTest, WrongSignsOfTheFitAreFound) {
  const RunRecord record = measured_with_hysteresis(2e-5);
  ItemFit own = fit_item(record, {});
  ASSERT_TRUE(own.solution);
  const CertifiedUncertainty right = certified_uncertainty(record, joint_result(record, own), own, 1);
  EXPECT_FALSE(right.any_larger()) << right.larger();
  EXPECT_EQ(right.trials, 2000U);

  HysteresisSigns signs = own.solution->model->signs();
  for (std::size_t n = 3; n < signs.mean.size(); n += 12)
    for (std::size_t k = n; k < n + 3; ++k) signs.mean[k] *= -1.0;
  own.options.signs = signs;
  own.solution = solve_effects(own.data.readings, own.options);
  const CertifiedUncertainty wrong = certified_uncertainty(record, joint_result(record, own), own, 1);
  EXPECT_TRUE(wrong.any_larger());
}

TEST(CertifiedUncertaintyTest, TheSeedIsOfTheRunFile) {
  EXPECT_EQ(seed_of_sha256("00000000000000ffab"), 255U);
  EXPECT_EQ(seed_of_sha256("ffffffffffffffff00"), ~std::uint64_t{0});
}

}  // namespace
}  // namespace abcal
