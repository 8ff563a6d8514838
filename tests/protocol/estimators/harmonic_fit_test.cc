#include "protocol/estimators/circle/harmonic_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

namespace abcal {
namespace {

using ::testing::HasSubstr;

std::vector<Angle> uniform(int count, double step_deg, double first_deg = 0.0) {
  std::vector<Angle> alpha;
  for (int i = 0; i < count; ++i) alpha.push_back(Angle::degrees(first_deg + step_deg * i));
  return alpha;
}

std::vector<double> sampled(const std::vector<Angle>& alpha, double constant, double sine, double cosine) {
  std::vector<double> r;
  for (const Angle a : alpha) r.push_back(constant + sine * sincos(a).sin + cosine * sincos(a).cos);
  return r;
}

std::string refusal(const std::vector<Angle>& alpha, int harmonics) {
  const std::vector<double> r(alpha.size(), 1.0);
  try {
    fit_harmonics(alpha, r, {}, harmonics);
  } catch (const UndeterminedFit& error) {
    return error.what();
  }
  return "not refused";
}

TEST(HarmonicFitTest, RecoversTheCoefficientsAtAnyAngles) {
  for (const auto& alpha :
       {uniform(72, 5.0), uniform(3, 120.0), uniform(100, 3.6), uniform(19, 10.0, -33.3)}) {
    const HarmonicFit fit = fit_harmonics(alpha, sampled(alpha, 0.5, -1.25, 2.0), {}, 1);
    EXPECT_NEAR(fit.coefficients(0), 0.5, 1e-15 / fit.reciprocal_condition);
    EXPECT_NEAR(fit.coefficients(1), -1.25, 1e-15 / fit.reciprocal_condition);
    EXPECT_NEAR(fit.coefficients(2), 2.0, 1e-15 / fit.reciprocal_condition);
    EXPECT_EQ(fit.rank, 3);
    EXPECT_EQ(fit.degrees_of_freedom(), static_cast<int>(alpha.size()) - 3);
  }
}

TEST(HarmonicFitTest, FiveHarmonicsSeparateOrders) {
  const std::vector<Angle> alpha = uniform(72, 5.0);
  std::vector<double> r;
  for (const Angle a : alpha)
    r.push_back(0.1 + sincos(a).cos + 1e-3 * sincos(a * 2).sin - 2e-3 * sincos(a * 5).cos);
  const HarmonicFit fit = fit_harmonics(alpha, r, {}, 5);
  ASSERT_EQ(fit.coefficients.size(), 11);
  Eigen::VectorXd expected = Eigen::VectorXd::Zero(11);
  expected(0) = 0.1, expected(2) = 1.0, expected(3) = 1e-3, expected(10) = -2e-3;
  EXPECT_LT((fit.coefficients - expected).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(HarmonicFitTest, EstimatorAndCofactorBelongTogether) {
  const std::vector<Angle> alpha = uniform(20, 13.0);
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  std::vector<double> r;
  std::vector<double> u;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    r.push_back(normal(engine));
    u.push_back(1e-3 * (1.0 + static_cast<double>(i % 5)));
  }
  const HarmonicFit fit = fit_harmonics(alpha, r, u, 1);
  const Eigen::Map<const Eigen::VectorXd> readings(r.data(), 20);
  const Eigen::Map<const Eigen::VectorXd> sigma(u.data(), 20);
  EXPECT_LT((fit.estimator * readings - fit.coefficients).cwiseAbs().maxCoeff(), 1e-13);
  const Eigen::MatrixXd covariance =
      fit.estimator * sigma.cwiseAbs2().asDiagonal() * fit.estimator.transpose();
  EXPECT_LT((covariance - fit.cofactor).norm(), 1e-12 * fit.cofactor.norm());
  // The normal equations hold: weighted residuals are orthogonal to each column.
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  double chi2 = 0.0;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    const SinCos sc = sincos(alpha[i]);
    const double w = 1.0 / (u[i] * u[i]);
    const double residual = fit.residuals(static_cast<Eigen::Index>(i));
    gradient += w * residual * Eigen::Vector3d(1.0, sc.sin, sc.cos);
    chi2 += w * residual * residual;
  }
  EXPECT_LT(gradient.norm(), 1e-8);  // of terms of 1e6
  EXPECT_NEAR(fit.residual_sum_squares / chi2, 1.0, 1e-12);
}

TEST(HarmonicFitTest, AWildlyUncertainReadingHardlyCounts) {
  const std::vector<Angle> alpha = uniform(12, 30.0);
  std::vector<double> r = sampled(alpha, 0.0, 1.0, 0.0);
  std::vector<double> u(alpha.size(), 1e-6);
  r[5] += 1.0;
  u[5] = 1e3;
  const HarmonicFit fit = fit_harmonics(alpha, r, u, 1);
  EXPECT_NEAR(fit.coefficients(1), 1.0, 1e-14);
  EXPECT_GT(std::abs(fit_harmonics(alpha, r, {}, 1).coefficients(1) - 1.0), 0.05);  // and unweighted it does
}

TEST(HarmonicFitTest, ReadingsInLargeUnitsLoseNothing) {
  const std::vector<Angle> alpha = uniform(72, 5.0);
  const double scale = std::ldexp(1.0, 40);
  const HarmonicFit fit = fit_harmonics(alpha, sampled(alpha, 0.5 * scale, scale, 0.0), {}, 1);
  EXPECT_NEAR(fit.coefficients(1) / scale, 1.0, 1e-15);
}

TEST(HarmonicFitTest, RefusesAnglesThatHideTheHarmonic) {
  EXPECT_THAT(refusal(uniform(10, 180.0), 1), HasSubstr("2 distinct angles"));  // 0 and 180 over and over
  EXPECT_THAT(refusal(uniform(5, 360.0), 1), HasSubstr("1 distinct angle "));
  EXPECT_THAT(refusal(uniform(10, 36.0), 5), HasSubstr("at least 11"));
  EXPECT_THAT(refusal(uniform(72, 1e-5), 1), HasSubstr("spread the angles"));
  EXPECT_THAT(refusal({}, 1), HasSubstr("0 distinct angles"));
}

TEST(HarmonicFitTest, RefusesNumbersThatAreNone) {
  const std::vector<Angle> alpha = uniform(4, 90.0);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<double> r{1, 2, 3, 4};
  EXPECT_THROW(fit_harmonics(alpha, std::vector<double>{1, 2, 3}, {}, 1), std::invalid_argument);
  EXPECT_THROW(fit_harmonics(alpha, std::vector<double>{1, 2, nan, 4}, {}, 1), std::invalid_argument);
  EXPECT_THROW(fit_harmonics(alpha, r, std::vector<double>{1, 0, 1, 1}, 1), std::invalid_argument);
  EXPECT_THROW(fit_harmonics(alpha, r, std::vector<double>{1, nan, 1, 1}, 1), std::invalid_argument);
  EXPECT_THROW(fit_harmonics(alpha, r, {}, 0), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
