#include "app/laboratory/compare/random_effects.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace abcal {
namespace {

// A few ulp of the results: closed forms against bisection and a Cholesky factor.
constexpr double kRounding = 1e-12;

Eigen::MatrixXd diagonal(const std::vector<double>& u) {
  Eigen::MatrixXd v =
      Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(u.size()), static_cast<Eigen::Index>(u.size()));
  for (Eigen::Index i = 0; i < v.rows(); ++i)
    v(i, i) = u[static_cast<std::size_t>(i)] * u[static_cast<std::size_t>(i)];
  return v;
}

TEST(RandomEffects, AgreeingResultsGiveTheirWeightedMean) {
  // Weights 1/u^2: 4 and 1, of 1.0 and 1.1.
  const RandomEffectsMean mean = random_effects_mean({1.0, 1.1}, diagonal({0.1, 0.2}));
  EXPECT_NEAR(mean.mean, (100.0 * 1.0 + 25.0 * 1.1) / 125.0, kRounding);
  EXPECT_NEAR(mean.standard_uncertainty, 1.0 / std::sqrt(125.0), kRounding);
  EXPECT_EQ(mean.between, 0.0);
  // u^2(x - mean) = u^2(x) - u^2(mean).
  EXPECT_NEAR(mean.normalised_error[0], (1.0 - mean.mean) / (2.0 * std::sqrt(0.01 - 1.0 / 125.0)), kRounding);
}

TEST(RandomEffects, EqualUncertaintiesLeaveTheRestOfTheScatterToTheResults) {
  // Equal u: between^2 = s^2 - u^2 in closed form, and the mean's u is s / sqrt(n).
  const std::vector<double> x{1.0, 1.3, 0.8, 1.5};
  const double m = 1.15, s2 = (0.15 * 0.15 + 0.15 * 0.15 + 0.35 * 0.35 + 0.35 * 0.35) / 3.0;
  const RandomEffectsMean mean = random_effects_mean(x, diagonal({0.1, 0.1, 0.1, 0.1}));
  EXPECT_NEAR(mean.mean, m, kRounding);
  EXPECT_NEAR(mean.between, std::sqrt(s2 - 0.01), kRounding);
  EXPECT_NEAR(mean.standard_uncertainty, std::sqrt(s2 / 4.0), kRounding);
  EXPECT_GT(std::abs(mean.normalised_error[3]), 1.0);  // By the claimed uncertainty 1.5 is outside.
}

TEST(RandomEffects, WhatAllHaveInCommonIsNotAveragedDown) {
  // V = u^2 I + c^2 1 1': the mean is the plain one and its variance c^2 + u^2 / n.
  const double u = 0.1, c = 0.3;
  Eigen::MatrixXd v = diagonal({u, u, u});
  v.array() += c * c;
  const RandomEffectsMean mean = random_effects_mean({1.0, 1.05, 0.95}, v);
  EXPECT_NEAR(mean.mean, 1.0, kRounding);
  EXPECT_NEAR(mean.standard_uncertainty, std::sqrt(c * c + u * u / 3.0), kRounding);
  // Independent results of the same u would be called more certain.
  const double total = std::hypot(u, c);
  EXPECT_GT(
      mean.standard_uncertainty,
      1.5 * random_effects_mean({1.0, 1.05, 0.95}, diagonal({total, total, total})).standard_uncertainty);
}

TEST(RandomEffects, SolvesTheEquationOfMandelAndPauleForUnequalUncertainties) {
  const std::vector<double> x{10.0, 10.4, 9.7, 10.9}, u{0.1, 0.2, 0.15, 0.3};
  const RandomEffectsMean mean = random_effects_mean(x, diagonal(u));
  double sum_weights = 0.0, sum = 0.0, chi2 = 0.0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double w = 1.0 / (u[i] * u[i] + mean.between * mean.between);
    sum_weights += w;
    sum += w * x[i];
  }
  for (std::size_t i = 0; i < x.size(); ++i)
    chi2 += std::pow(x[i] - sum / sum_weights, 2) / (u[i] * u[i] + mean.between * mean.between);
  EXPECT_NEAR(mean.mean, sum / sum_weights, 10.0 * kRounding);
  EXPECT_NEAR(chi2, 3.0, 1e-9);
}

TEST(RandomEffects, RefusesWhatIsNoCovariance) {
  EXPECT_THROW((void)random_effects_mean({1.0, 2.0}, Eigen::MatrixXd::Zero(2, 2)), std::invalid_argument);
  EXPECT_THROW((void)random_effects_mean({1.0, 2.0}, diagonal({1.0})), std::invalid_argument);
  EXPECT_THROW((void)random_effects_mean({1.0}, diagonal({1.0})), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
