#include "app/laboratory/certificate/raised_covariance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

namespace abcal {
namespace {

using Outputs = Eigen::Matrix<double, 12, 1>;

class Drawn {
 public:
  explicit Drawn(unsigned seed) : random_(seed) {}

  /// A covariance of outputs whose uncertainties and correlations differ by orders of magnitude.
  Covariance12 covariance() {
    const Covariance12 root =
        Covariance12::NullaryExpr([&] { return normal_(random_) * std::pow(10.0, -2.0 + normal_(random_)); });
    return root * root.transpose();
  }
  Outputs gradient() {
    return Outputs::NullaryExpr([&] { return normal_(random_); });
  }
  double factor() { return std::exp(1.5 * normal_(random_)); }
  std::size_t below(std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1)(random_); }

 private:
  std::mt19937 random_;
  std::normal_distribution<double> normal_;
};

double variance(const Covariance12& covariance, const Outputs& gradient) {
  return gradient.dot(covariance * gradient);
}

// One combination: exact, and no other output is raised with it, however much they have in common.
TEST(RaisedCovarianceTest, OneOutputReachesItsVarianceAndTheOthersStay) {
  Covariance12 covariance = Covariance12::Identity();
  covariance(0, 1) = covariance(1, 0) = 0.5;
  const Outputs first = Outputs::Unit(0);
  const Covariance12 raised = raised_covariance(covariance, {{"s_ux", first, 9.0}});
  EXPECT_NEAR(raised(0, 0), 9.0, 1e-12);
  EXPECT_EQ(raised(0, 1), 0.5);
  EXPECT_EQ(raised(1, 1), 1.0);
  EXPECT_EQ(raised(2, 2), 1.0);
  EXPECT_EQ(raised_covariance(covariance, {{"s_ux", first, 1.0}}), covariance);
  EXPECT_EQ(raised_covariance(covariance, {{"s_ux", first, -1.0}}), covariance);
}

// Drawn covariances and combinations: none is below what is asked for, and the covariance stays one.
TEST(RaisedCovarianceTest, EveryCombinationReachesItsVarianceAndLittleIsInExcess) {
  for (unsigned seed = 1; seed <= 300; ++seed) {
    Drawn drawn(seed);
    const Covariance12 covariance = drawn.covariance();
    std::vector<LeastVariance> least;
    for (std::size_t n = 1 + drawn.below(20); n > 0; --n) {
      const Outputs gradient = drawn.below(2) == 0
                                   ? drawn.gradient()
                                   : Outputs(Outputs::Unit(static_cast<Eigen::Index>(drawn.below(12))));
      least.push_back({"", gradient, drawn.factor() * variance(covariance, gradient)});
    }
    const Covariance12 raised = raised_covariance(covariance, least);
    for (const LeastVariance& one : least)
      ASSERT_GE(variance(raised, one.gradient), one.variance * (1.0 - 1e-9)) << seed;
    const double scale = raised.trace();
    const Eigen::SelfAdjointEigenSolver<Covariance12> grown(raised - covariance);
    ASSERT_GT(grown.eigenvalues().minCoeff(), -1e-12 * scale) << seed;
    // The added part is made of combinations that are exactly at their variance: in excess are others alone.
    Eigen::MatrixXd at_limit(12, 0);
    for (const LeastVariance& one : least) {
      if (variance(raised, one.gradient) > one.variance * (1.0 + 1e-6)) continue;
      at_limit.conservativeResize(12, at_limit.cols() + 1);
      at_limit.rightCols<1>() = one.gradient.normalized();
    }
    const Covariance12 added = raised - covariance;
    const Eigen::MatrixXd left =
        at_limit.cols() == 0
            ? Eigen::MatrixXd(added)
            : Eigen::MatrixXd(added -
                              at_limit * at_limit.colPivHouseholderQr().solve(Eigen::MatrixXd(added)));
    ASSERT_LT(left.norm(), 1e-8 * scale) << seed;
  }
}

// A later raise makes an earlier one superfluous, in part: it is taken back.
TEST(RaisedCovarianceTest, AnEarlierRaiseIsReducedWhereALaterOneServes) {
  // The sum lacks most and is raised first; then its first part needs nearly all of what it got.
  Outputs sum = Outputs::Zero();
  sum(0) = sum(1) = 1.0;
  const Covariance12 covariance = 1e-4 * Covariance12::Identity();
  const std::vector<LeastVariance> least{{"sum", sum, 4.0}, {"part", Outputs::Unit(0), 1.9}};
  const Covariance12 raised = raised_covariance(covariance, least);
  EXPECT_NEAR(variance(raised, sum), 4.0, 1e-9);
  EXPECT_NEAR(raised(0, 0), 1.9, 1e-9);
}

TEST(RaisedCovarianceTest, AnOutputWithoutUncertaintyGetsOneAndACombinationOfNothingIsRefused) {
  Covariance12 covariance = Covariance12::Identity();
  covariance(3, 3) = 0.0;
  EXPECT_EQ(raised_covariance(covariance, {{"sensitivity_vx", Outputs::Unit(3), 2.0}})(3, 3), 2.0);
  try {
    (void)raised_covariance(covariance, {{"nothing", Outputs::Zero(), 1.0}});
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("nothing cannot be raised"));
  }
}

}  // namespace
}  // namespace abcal
