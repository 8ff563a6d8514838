#include "protocol/statistics/distributions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>

namespace abcal {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Each is compared with a closed form; 1e-13 allows for some tens of roundings.

TEST(NormalTest, QuantileTailAndDensityBelongTogether) {
  EXPECT_NEAR(normal_quantile(0.975), 1.959963984540054, 4e-15);
  EXPECT_NEAR(normal_tail(normal_quantile(0.999)), 0.001, 1e-15);
  EXPECT_NEAR(normal_tail(0.0), 0.5, 1e-16);
  EXPECT_NEAR(normal_density(1.0), std::exp(-0.5) / std::sqrt(2.0 * std::numbers::pi), 1e-16);
  for (const double p : {0.0, 1.0, -0.5, std::nan("")})
    EXPECT_THROW(normal_quantile(p), std::invalid_argument) << p;
}

TEST(StudentTest, OneDegreeIsCauchysAndTwoHaveAClosedForm) {
  for (const double p : {0.4, 0.05, 1e-6}) {
    const double cauchy = 1.0 / std::tan(std::numbers::pi * p);
    EXPECT_NEAR(student_t_above(p, 1.0) / cauchy, 1.0, 1e-13) << p;
    EXPECT_NEAR(student_t_tail(cauchy, 1.0) / p, 1.0, 1e-13) << p;
    const double of_two = (1.0 - 2.0 * p) / std::sqrt(2.0 * p * (1.0 - p));
    EXPECT_NEAR(student_t_above(p, 2.0) / of_two, 1.0, 1e-13) << p;
  }
}

TEST(StudentTest, ManyDegreesAreNormalAndNoneIsNothing) {
  EXPECT_NEAR(student_t_above(0.025, 2e7), normal_quantile(0.975), 1e-14);
  EXPECT_NEAR(student_t_above(0.025, kInfinity), normal_quantile(0.975), 1e-14);
  EXPECT_NEAR(student_t_above(0.025, 0.9e7), normal_quantile(0.975), 1e-6);
  // z (z2 + 1) / (4 nu) more than normal up to 1e7 degrees, and exactly that beyond.
  EXPECT_NEAR(student_t_above(0.025, 1e7) - normal_quantile(0.975), 2.37e-7, 1e-8);
  EXPECT_EQ(student_t_above(0.025, std::nextafter(1e7, kInfinity)), student_t_above(0.025, kInfinity));
  EXPECT_NEAR(student_t_tail(2.0, kInfinity), normal_tail(2.0), 0.0);
  for (const double degrees : {0.5, 0.0, -1.0, std::nan("")})
    EXPECT_TRUE(std::isnan(student_t_above(0.025, degrees)));
}

TEST(StudentTest, BetweenDoesNotCancelInATail) {
  const auto between = [](double a, double b) { return student_t_between(a, b, kInfinity); };
  EXPECT_EQ(between(-kInfinity, kInfinity), 1.0);
  EXPECT_DOUBLE_EQ(between(9.0, 10.0), between(-10.0, -9.0));
  EXPECT_NEAR(between(9.0, 10.0) / 1.1285122074e-19, 1.0, 1e-9);
  EXPECT_DOUBLE_EQ(between(10.0, kInfinity), normal_tail(10.0));
  EXPECT_EQ(between(1.0, 1.0), 0.0);
  // Cauchy's: atan has a closed form, over 0 too.
  EXPECT_NEAR(student_t_between(-1.0, 2.0, 1.0), (std::atan(2.0) + std::atan(1.0)) / std::numbers::pi, 1e-15);
}

TEST(Chi2Test, TwoDegreesAreExponential) {
  for (const double p : {0.5, 1e-3, 1e-20}) {
    EXPECT_NEAR(chi2_above(p, 2.0) / (-2.0 * std::log(p)), 1.0, 1e-13) << p;
    EXPECT_NEAR(chi2_tail(-2.0 * std::log(p), 2) / p, 1.0, 1e-13) << p;
  }
  EXPECT_NEAR(chi2_quantile(0.95, 2.0), -2.0 * std::log(0.05), 1e-13);
  EXPECT_NEAR(chi2_tail(1.96 * 1.96, 1), 2.0 * normal_tail(1.96), 1e-15);
}

TEST(Chi2Test, TheLowerTailKeepsItsDigits) {
  for (const double p : {0.5, 1e-3, 1e-20})
    EXPECT_NEAR(chi2_lower_tail(-2.0 * std::log1p(-p), 2) / p, 1.0, 1e-13) << p;
  EXPECT_NEAR(chi2_lower_tail(1.96 * 1.96, 1), 1.0 - 2.0 * normal_tail(1.96), 1e-15);
  EXPECT_EQ(chi2_lower_tail(0.0, 3), 0.0);
  EXPECT_EQ(chi2_lower_tail(kInfinity, 3), 1.0);
  EXPECT_TRUE(std::isnan(chi2_lower_tail(1.0, 0)));
  EXPECT_TRUE(std::isnan(chi2_lower_tail(-1.0, 3)));
  EXPECT_TRUE(std::isnan(chi2_lower_tail(std::nan(""), 3)));
}

TEST(Chi2Test, WithoutDegreesOrNumberItIsNotKnown) {
  EXPECT_TRUE(std::isnan(chi2_tail(1.0, 0)));
  EXPECT_TRUE(std::isnan(chi2_tail(-1.0, 3)));
  EXPECT_TRUE(std::isnan(chi2_tail(std::nan(""), 3)));
  EXPECT_EQ(chi2_tail(kInfinity, 3), 0.0);
}

TEST(FTest, TwoDegreesHaveAClosedFormAndKnownNoiseIsChi2) {
  for (const double of_noise : {1.0, 7.5, 100.0}) {
    const double chi2 = 6.0;  // F = 3 with 2 degrees: (1 + 2 F / n)^(-n / 2)
    EXPECT_NEAR(f_tail(chi2, 2, of_noise), std::pow(1.0 + chi2 / of_noise, -0.5 * of_noise), 1e-14)
        << of_noise;
  }
  EXPECT_EQ(f_tail(6.0, 2, kInfinity), chi2_tail(6.0, 2));
}

}  // namespace
}  // namespace abcal
