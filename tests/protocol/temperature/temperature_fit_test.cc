#include "protocol/temperature/temperature_fit.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

namespace abcal {
namespace {

constexpr double kOwn = 2e-6, kShared = 3e-5;

struct Made {
  double loop = 0.0;  ///< Half of the hysteresis of O_u.
  double noise = kOwn;
};

/// Seven temperatures up and down about a reference; s_u of order 2, O_u of order 3, phi constant.
std::vector<TemperaturePoint> made_points(std::mt19937_64& random, const Made& made = {}) {
  std::normal_distribution<double> normal;
  Eigen::Matrix<double, 9, 1> shift;
  for (int k = 0; k < 9; ++k) shift[k] = kShared * normal(random);
  const std::vector<double> up{-40.0, -20.0, 0.0, 23.0, 45.0, 65.0, 85.0};
  std::vector<std::pair<SeriesLeg, double>> legs{{SeriesLeg::kReference, 23.0}};
  for (const double degc : up) legs.emplace_back(SeriesLeg::kUp, degc);
  for (std::size_t n = up.size() - 1; n-- > 0;) legs.emplace_back(SeriesLeg::kDown, up[n]);
  legs.emplace_back(SeriesLeg::kReturn, 23.0);
  std::vector<TemperaturePoint> points;
  for (const auto& [leg, degc] : legs) {
    TemperaturePoint point;
    point.number = static_cast<int>(points.size()) + 1;
    point.leg = leg;
    point.set_degc = degc;
    point.temperature_degc = degc + 3.0 + 0.1 * normal(random);
    const double d = point.temperature_degc - 23.0;
    point.value.setZero();
    point.value[0] = 1.0 - 1e-4 * d + 2e-7 * d * d;
    point.value[1] = point.value[2] = 1.0;
    point.value.segment<3>(3).setConstant(90.0);
    point.value[6] = 0.01 + 5e-5 * d - 1e-7 * d * d + 3e-9 * d * d * d;
    if (leg == SeriesLeg::kUp) point.value[6] += made.loop;
    if (leg == SeriesLeg::kDown) point.value[6] -= made.loop;
    point.own = Covariance9::Identity() * kOwn * kOwn;
    point.shared = Covariance9::Identity() * kShared * kShared;
    for (int k = 0; k < 9; ++k) point.value[k] += shift[k] + made.noise * normal(random);
    points.push_back(point);
  }
  return points;
}

TEST(TemperatureFitTest, FindsOrdersAndCoefficients) {
  std::mt19937_64 random(1);
  const TemperatureResult result = fit_temperature(made_points(random), 23.0, "g");
  ASSERT_EQ(result.polynomials.size(), 9U);
  const TemperaturePolynomial& s = result.polynomials[0];
  const TemperaturePolynomial& o = result.polynomials[6];
  EXPECT_EQ(s.order, 2);
  EXPECT_EQ(o.order, 3);
  EXPECT_EQ(s.unit, "g/g_loc");
  EXPECT_NEAR(s.coefficient[1], -1e-4, 4.0 * std::sqrt(s.covariance(1, 1)));
  EXPECT_NEAR(o.coefficient[3], 3e-9, 4.0 * std::sqrt(o.covariance(3, 3)));
  // The error shared by all points moves the polynomial as a whole, and does not affect its slope.
  EXPECT_NEAR(std::sqrt(s.covariance(0, 0)), kShared, 0.1 * kShared);
  EXPECT_LT(std::sqrt(s.covariance(1, 1)) * 60.0, kOwn);
  EXPECT_EQ(result.coefficients[0].unit, "ppm/K");
  EXPECT_NEAR(result.coefficients[0].at_reference, -100.0, 0.5);
  EXPECT_NEAR(result.coefficients[6].at_reference, 50.0, 0.5);
}

TEST(TemperatureFitTest, TheLoopIsFoundAndWidensTheBand) {
  std::mt19937_64 random(2);
  const TemperatureResult without = fit_temperature(made_points(random), 23.0, "g");
  const TemperatureResult with = fit_temperature(made_points(random, {.loop = 1e-4}), 23.0, "g");
  EXPECT_NEAR(with.hysteresis[6].largest, 2e-4, 2e-5);
  EXPECT_LT(std::abs(without.hysteresis[6].largest), 5.0 * without.hysteresis[6].standard_uncertainty);
  EXPECT_GT(with.polynomials[6].excess, 5e-5);
  EXPECT_LT(without.polynomials[6].excess, 2e-6);
  EXPECT_TRUE(with.hysteresis[6].has_closure);
  EXPECT_LT(std::abs(with.hysteresis[6].closure), 5.0 * with.hysteresis[6].closure_uncertainty);
}

TEST(TemperatureFitTest, CoefficientsLieWithinTheirUncertainty) {
  std::mt19937_64 random(3);
  int within = 0, all = 0, too_high = 0;
  for (int n = 0; n < 300; ++n) {
    const TemperatureResult result = fit_temperature(made_points(random), 23.0, "g");
    const auto count = [&](const TemperaturePolynomial& p, const std::vector<double>& truth) {
      if (p.order < static_cast<int>(truth.size()) - 1) {
        ++all;
        return;
      }
      for (std::size_t k = 0; k < truth.size(); ++k) {
        const auto i = static_cast<Eigen::Index>(k);
        ++all;
        if (std::abs(p.coefficient[k] - truth[k]) < 1.96 * std::sqrt(p.covariance(i, i))) ++within;
      }
    };
    too_high += result.polynomials[3].order > 0 ? 1 : 0;
    count(result.polynomials[0], {1.0, -1e-4, 2e-7});
    count(result.polynomials[6], {0.01, 5e-5, -1e-7, 3e-9});
  }
  // 2100 numbers at 95 %: one standard deviation is 0.5 %; those of a series belong together.
  EXPECT_GT(within, 0.925 * all);
  EXPECT_LT(within, 0.985 * all);
  // Each of the two steps that are tried is made by chance in 5 % of the series.
  EXPECT_GT(too_high, 5);
  EXPECT_LT(too_high, 45);
}

TEST(TemperatureFitTest, CoefficientsOfDataSheetsLieWithinTheirUncertainty) {
  std::mt19937_64 random(5);
  // d of the ends: the item is 3 K warmer than the set points, which scatter by 0.1 K.
  constexpr double kLow = -60.0, kHigh = 65.0;
  const auto s = [](double d) { return 1.0 - 1e-4 * d + 2e-7 * d * d; };
  int within = 0, all = 0;
  for (int n = 0; n < 300; ++n) {
    const TemperatureResult result = fit_temperature(made_points(random), 23.0, "g");
    const auto count = [&](double value, double truth, double u) {
      ++all;
      if (std::abs(value - truth) < 1.96 * u) ++within;
    };
    const double low = result.least_degc - 23.0, high = result.most_degc - 23.0;
    EXPECT_NEAR(low, kLow, 1.0);
    EXPECT_NEAR(high, kHigh, 1.0);
    const double ends = 1e6 * (s(high) - s(low)) / (high - low);
    // It falls over the whole range, so that its box has the size of its ends.
    count(result.coefficients[0].end_point, ends, result.coefficients[0].end_point_uncertainty);
    count(result.coefficients[0].box, -ends, result.coefficients[0].box_uncertainty);
    // No slope is a value too.
    EXPECT_GT(result.coefficients[3].standard_uncertainty, 0.0);
    count(result.coefficients[3].at_reference, 0.0, result.coefficients[3].standard_uncertainty);
    count(result.coefficients[3].end_point, 0.0, result.coefficients[3].end_point_uncertainty);
  }
  EXPECT_GT(within, 0.925 * all);
  EXPECT_LT(within, 0.985 * all);
}

TEST(TemperatureFitTest, WhatTheScatterAloneTellsHasItsDegreesOfFreedom) {
  std::mt19937_64 random(6);
  const TemperatureResult without = fit_temperature(made_points(random, {.noise = 0.5 * kOwn}), 23.0, "g");
  EXPECT_TRUE(std::isinf(without.coefficients[6].degrees_of_freedom));
  // Scatter ten times what the points state: 15 points less the coefficients.
  const TemperatureResult with = fit_temperature(made_points(random, {.noise = 10.0 * kOwn}), 23.0, "g");
  const double degrees = with.coefficients[0].degrees_of_freedom;
  EXPECT_GE(degrees, with.polynomials[0].degrees_of_freedom);
  EXPECT_LT(degrees, 1.2 * with.polynomials[0].degrees_of_freedom);
}

TEST(TemperatureFitTest, OneTemperatureIsNoSeries) {
  std::mt19937_64 random(4);
  std::vector<TemperaturePoint> points = made_points(random);
  points.resize(1);
  EXPECT_THROW(fit_temperature(points, 23.0, "g"), std::invalid_argument);
}

/// The stage as each run finds it: Zx by `slope` per kelvin, all with noise `scatter` times the stated
/// uncertainty.
TemperatureResult with_stage(std::mt19937_64& random, double slope, double scatter) {
  constexpr double kStated = 1e-5;
  std::normal_distribution<double> normal;
  std::vector<TemperaturePoint> points = made_points(random);
  for (TemperaturePoint& point : points) {
    point.stage.emplace();
    for (Quantity& each : *point.stage) {
      each.value = 1e-4 + scatter * kStated * normal(random);
      each.type_a = kStated;
    }
    point.stage->at(0).value += slope * (point.temperature_degc - 23.0);
  }
  return fit_temperature(std::move(points), 23.0, "g");
}

TEST(TemperatureFitTest, AStageThatChangesMakesTheSeriesDoubtful) {
  std::mt19937_64 random(5);
  const TemperatureResult result = with_stage(random, 5e-7, 1.0);
  ASSERT_EQ(result.stage.size(), 5U);
  EXPECT_FALSE(result.stage[0].constant());
  EXPECT_NEAR(result.stage[0].slope, 5e-7, 4.0 * result.stage[0].standard_uncertainty);
  EXPECT_TRUE(result.stage[2].constant());
  ASSERT_EQ(result.reasons().size(), 1U);
  EXPECT_NE(result.reasons()[0].find("the stage changes with temperature: Zx by "), std::string::npos)
      << result.reasons()[0];
  EXPECT_FALSE(result.usable());
}

TEST(TemperatureFitTest, AStageThatOnlyScattersDoesNot) {
  // Twice and thrice the noise that is stated, too: step errors are not those of the run before.
  std::mt19937_64 random(6);
  int alarms = 0, tests = 0;
  for (int series = 0; series < 400; ++series) {
    for (const StageTrend& trend : with_stage(random, 0.0, 1.0 + series % 3).stage) {
      alarms += trend.constant() ? 0 : 1;
      ++tests;
    }
  }
  EXPECT_EQ(tests, 2000);
  EXPECT_LE(alarms, 9) << "one in a thousand is expected; 9 of 2000 have a probability of 2e-4";
}

TEST(TemperatureFitTest, WithoutAStageNothingIsSaidOfIt) {
  std::mt19937_64 random(7);
  EXPECT_TRUE(fit_temperature(made_points(random), 23.0, "g").stage.empty());
}

/// Points whose outputs are all the same function of d = T - 23, with the same own uncertainty and without a
/// shared one.
template <class Function>
std::vector<TemperaturePoint> exact_points(const std::vector<double>& d, const Function& value, double own) {
  std::vector<TemperaturePoint> points;
  for (const double each : d) {
    TemperaturePoint& point = points.emplace_back();
    point.number = static_cast<int>(points.size());
    point.set_degc = point.temperature_degc = 23.0 + each;
    for (double& one : point.value) one = value(each);
    point.own = Covariance9::Identity() * own * own;
    point.shared = Covariance9::Zero();
  }
  return points;
}
const std::vector<double> kSevenD{-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0};

// chi2 of the constant is S_1 / u2 for a straight line of slope 1, with S_1 = sum d2 = 2800; 3.841 is the 95
// % quantile of chi2 with one degree of freedom.
TEST(TemperatureFitTest, ASlopeIsTakenWhereItIsSignificant) {
  const auto order_at = [](double chi2) {
    const double slope = 1e-6 * std::sqrt(chi2 / 2800.0);
    const auto points = exact_points(
        kSevenD, [&](double d) { return 1.0 + slope * d; }, 1e-6);
    const TemperaturePolynomial found = fit_temperature(points, 23.0, "g").polynomials[0];
    EXPECT_NEAR(found.likelihood_ratio.at(0), chi2, 1e-4);
    return found.order;
  };
  EXPECT_EQ(order_at(3.83), 0);
  EXPECT_EQ(order_at(3.85), 1);
}

// A bend without a slope: d2 less its mean, 400, is orthogonal to both lower orders, with a sum of squares of
// 840 000. 5.991 is the quantile for two degrees of freedom.
TEST(TemperatureFitTest, ABendWithoutASlopeIsTakenWhereItIsSignificant) {
  const auto found_at = [](double chi2) {
    const double bend = 1e-6 * std::sqrt(chi2 / 840'000.0);
    const auto points = exact_points(
        kSevenD, [&](double d) { return 1.0 + bend * (d * d - 400.0); }, 1e-6);
    return fit_temperature(points, 23.0, "g").polynomials[0];
  };
  EXPECT_EQ(found_at(5.98).order, 0);
  EXPECT_EQ(found_at(5.98).likelihood_ratio.size(), 1U);
  const TemperaturePolynomial bent = found_at(6.00);
  EXPECT_EQ(bent.order, 2);
  ASSERT_EQ(bent.likelihood_ratio.size(), 3U)
      << "the step that was too small, the one after it, and the next";
  EXPECT_NEAR(bent.likelihood_ratio[0], 0.0, 1e-4);
  EXPECT_NEAR(bent.likelihood_ratio[1], 6.00, 1e-4);
}

TEST(TemperatureFitTest, TemperaturesTwoKelvinApartAreOne) {
  const auto at = [](double apart) {
    const std::vector<double> d{0.0, apart, 2.0 * apart, 0.0, apart, 2.0 * apart};
    return exact_points(
        d, [](double x) { return 1.0 + 1e-3 * x; }, 1e-6);
  };
  // The third differs from the first by more than two kelvins in either case.
  EXPECT_THROW(fit_temperature(exact_points(
                                   {0.0, 2.0}, [](double) { return 1.0; }, 1e-6),
                               23.0, "g"),
               std::invalid_argument);
  EXPECT_NO_THROW(fit_temperature(exact_points(
                                      {0.0, 2.001}, [](double) { return 1.0; }, 1e-6),
                                  23.0, "g"));
  EXPECT_EQ(fit_temperature(at(2.0), 23.0, "g").polynomials[0].order, 1);
  // Three temperatures allow a parabola, two do not: a bend that is far above the noise is taken or not.
  const auto order_of_bend = [](double apart) {
    const std::vector<double> d{0.0, apart, 2.0 * apart, 0.0, apart, 2.0 * apart};
    return fit_temperature(exact_points(
                               d, [](double x) { return 1.0 + 1e-3 * x * x; }, 1e-9),
                           23.0, "g")
        .polynomials[0]
        .order;
  };
  EXPECT_LE(order_of_bend(2.0), 1);
  EXPECT_EQ(order_of_bend(2.001), 2);
}

// Within a run the item changes by 6 K at 1e-5 / K: the value belongs to any of these temperatures, with the
// variance of a rectangular distribution, (6e-5)2 / 12.
TEST(TemperatureFitTest, AChangeWithinARunIsInTheUncertaintyOfItsPoint) {
  auto points = exact_points(
      kSevenD, [](double d) { return 1.0 + 1e-5 * d; }, 1e-5);
  for (TemperaturePoint& point : points) point.change_k = 6.0;
  const TemperaturePolynomial found = fit_temperature(points, 23.0, "g").polynomials[0];
  ASSERT_EQ(found.order, 1);
  const double variance = 1e-10 + 3.6e-9 / 12.0;
  EXPECT_NEAR(found.covariance(1, 1) * 2800.0 / variance, 1.0, 1e-9);
  EXPECT_NEAR(found.covariance(0, 0) * 7.0 / variance, 1.0, 1e-9);
}

// Scatter beyond the own uncertainties brings chi2 to its degrees of freedom (Paule and Mandel): with equal
// uncertainties u2 + excess2 is the sum of squares over the degrees of freedom.
TEST(TemperatureFitTest, TheExcessBringsChi2ToItsDegreesOfFreedom) {
  constexpr std::array<double, 7> kOff{1.0, -2.0, 3.0, 0.0, -3.0, 2.0, -1.0};
  const auto points = exact_points(
      kSevenD,
      [&](double d) { return 1.0 + 1e-4 * kOff[static_cast<std::size_t>(std::lround(d / 10.0) + 3)]; }, 1e-5);
  const TemperaturePolynomial found = fit_temperature(points, 23.0, "g").polynomials[0];
  ASSERT_EQ(found.order, 0);
  EXPECT_EQ(found.degrees_of_freedom, 6);
  EXPECT_NEAR(found.chi2, 28e-8 / 1e-10, 1e-3);
  const double all = 28e-8 / 6.0;
  EXPECT_NEAR(found.excess / std::sqrt(all - 1e-10), 1.0, 1e-9);
  EXPECT_NEAR(found.covariance(0, 0) * 7.0 / all, 1.0, 1e-9);
  EXPECT_NEAR(found.excess_covariance(0, 0) * 7.0 / (all - 1e-10), 1.0, 1e-9);
  EXPECT_NEAR(found.degrees_of_freedom_of(Eigen::VectorXd::Ones(1)), 6.0 * std::pow(all / (all - 1e-10), 2),
              1e-6);
  EXPECT_NEAR(found.residual_rms, std::sqrt(28e-8 / 7.0), 1e-12);
  EXPECT_NEAR(found.residual_max, 3e-4, 1e-12);
}

}  // namespace
}  // namespace abcal
