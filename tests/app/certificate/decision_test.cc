#include "app/laboratory/certificate/decision.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "app/laboratory/certificate/derived.h"

namespace abcal {
namespace {

SpecificationLimit limit(std::optional<double> lower, std::optional<double> upper) {
  SpecificationLimit made;
  made.quantity = "intrinsic_sensitivity_u";
  made.unit = "V/(m/s2)";
  made.lower = lower;
  made.upper = upper;
  return made;
}

/// Decides from all digits of a value with standard uncertainty u and k = 2.
Decision decide(const DecisionRule& rule, const SpecificationLimit& limit, double value, double u,
                double degrees_of_freedom = std::numeric_limits<double>::infinity()) {
  Quantity quantity;
  quantity.value = value;
  quantity.standard_uncertainty = u;
  quantity.unit = limit.unit;
  quantity.degrees_of_freedom = degrees_of_freedom;
  return decide_printed(
      rule, limit, quantity,
      {fmt::format("{}", value), fmt::format("{}", coverage_factor(quantity) * u), std::nullopt});
}

Conformity with(DecisionKind kind, double factor, double value, double u) {
  DecisionRule rule;
  rule.kind = kind;
  rule.guard_factor = factor;
  return decide(rule, limit(-1.0, 1.0), value, u).conformity;
}

// docs/theory/certificate_rules.md; u = 0.05, so U = 0.1.
TEST(DecisionTest, SimpleAcceptanceKnowsNoGuardBand) {
  EXPECT_EQ(with(DecisionKind::kSimple, 1.0, 1.0, 0.05), Conformity::kPass);
  EXPECT_EQ(with(DecisionKind::kSimple, 1.0, std::nextafter(1.0, 2.0), 0.05), Conformity::kFail);
  EXPECT_EQ(with(DecisionKind::kSimple, 1.0, -1.0, 0.05), Conformity::kPass);
}

TEST(DecisionTest, AGuardBandMovesTheAcceptanceLimitsInside) {
  EXPECT_EQ(with(DecisionKind::kGuardBand, 1.0, 0.89, 0.05), Conformity::kPass);
  EXPECT_EQ(with(DecisionKind::kGuardBand, 1.0, 0.91, 0.05), Conformity::kFail);
  EXPECT_EQ(with(DecisionKind::kGuardBand, 0.83, 0.91, 0.05), Conformity::kPass);
  EXPECT_EQ(with(DecisionKind::kGuardBand, -1.0, 1.09, 0.05), Conformity::kPass);
  EXPECT_EQ(with(DecisionKind::kGuardBand, -1.0, 1.11, 0.05), Conformity::kFail);
}

TEST(DecisionTest, FourStatementsOfTheNonBinaryRule) {
  EXPECT_EQ(with(DecisionKind::kNonBinary, 1.0, 0.89, 0.05), Conformity::kPass);
  EXPECT_EQ(with(DecisionKind::kNonBinary, 1.0, 0.95, 0.05), Conformity::kConditionalPass);
  EXPECT_EQ(with(DecisionKind::kNonBinary, 1.0, 1.0, 0.05), Conformity::kConditionalPass);
  EXPECT_EQ(with(DecisionKind::kNonBinary, 1.0, 1.05, 0.05), Conformity::kConditionalFail);
  EXPECT_EQ(with(DecisionKind::kNonBinary, 1.0, 1.11, 0.05), Conformity::kFail);
  EXPECT_EQ(with(DecisionKind::kNonBinary, 1.0, -1.05, 0.05), Conformity::kConditionalFail);
}

TEST(DecisionTest, LimitsOnOneSide) {
  DecisionRule rule;
  const Decision decision = decide(rule, limit({}, 1.0), -1e9, 0.05);
  EXPECT_EQ(decision.conformity, Conformity::kPass);
  EXPECT_FALSE(decision.lower_acceptance);
  EXPECT_DOUBLE_EQ(*decision.upper_acceptance, 0.9);
  EXPECT_EQ(decide(rule, limit(1.0, {}), 0.0, 0.05).conformity, Conformity::kFail);
}

constexpr double kMany = std::numeric_limits<double>::infinity();  // degrees of freedom

// Reference: the normal distribution function, from tables (Q(10) to 16 digits).
TEST(DecisionTest, ConformanceProbabilityOfAWellKnownUncertaintyIsThatOfTheNormalDistribution) {
  EXPECT_NEAR(conformance_probability(0.0, 1.0, kMany, -1.0, 1.0), 0.6826894921370859, 1e-15);
  EXPECT_NEAR(conformance_probability(0.0, 1.0, kMany, {}, 1.6448536269514722), 0.95, 1e-15);
  EXPECT_NEAR(conformance_probability(1.0, 1.0, kMany, {}, 1.0), 0.5, 1e-16);
  // Far in the tails: no cancellation. Q(10) = 7.61985302416e-24.
  EXPECT_NEAR(conformance_probability(0.0, 1.0, kMany, 10.0, {}) / 7.619853024160527e-24, 1.0, 1e-12);
  EXPECT_NEAR(
      conformance_probability(0.0, 1.0, kMany, 10.0, 11.0) / (7.619853024160527e-24 - 1.9106595744986622e-28),
      1.0, 1e-12);
  EXPECT_EQ(conformance_probability(0.5, 0.0, kMany, 0.0, 1.0), 1.0);
  EXPECT_EQ(conformance_probability(1.5, 0.0, kMany, 0.0, 1.0), 0.0);
}

/// Probability that an item outside +-limit is accepted, for items that scatter with `spread` about the
/// middle.
double false_acceptance(double tolerance, double acceptance, double u, double spread) {
  constexpr int kPoints = 4000;
  double sum = 0.0;
  const double reach = 8.0 * spread, width = 2.0 * reach / kPoints;
  for (int i = 0; i < kPoints; ++i) {
    const double truth = -reach + (i + 0.5) * width;
    if (std::abs(truth) <= tolerance) continue;
    const double density =
        std::exp(-0.5 * truth * truth / (spread * spread)) / (spread * std::sqrt(2.0 * std::numbers::pi));
    sum += width * density * conformance_probability(truth, u, kMany, -acceptance, acceptance);
  }
  return sum;
}

TEST(DecisionTest, TheGuardBandFromTheUncertaintyRatioKeepsFalseAcceptanceBelowTwoPercent) {
  DecisionRule rule;
  rule.kind = DecisionKind::kTestUncertaintyRatio;
  double without = 0.0;
  for (const double ratio : {1.5, 2.0, 3.0, 4.0}) {
    const double u = 0.5 / ratio;  // tolerance +-1, U = 2 u
    const Decision decision = decide(rule, limit(-1.0, 1.0), 0.0, u);
    ASSERT_GT(decision.guard_band, 0.0);
    double worst = 0.0;
    for (double spread = 0.2; spread < 3.0; spread *= 1.1) {
      worst = std::max(worst, false_acceptance(1.0, *decision.upper_acceptance, u, spread));
      without = std::max(without, false_acceptance(1.0, 1.0, u, spread));
    }
    EXPECT_LT(worst, 0.0205) << ratio;  // the published fit rounds to 2 %
    EXPECT_GT(worst, 0.015) << ratio;   // and is no wider than it needs
  }
  EXPECT_GT(without, 0.04);  // without a guard band it is more
  EXPECT_EQ(guard_band(rule, limit(-1.0, 1.0), 0.01), 0.0);
  EXPECT_THROW(guard_band(rule, limit({}, 1.0), 0.1), std::invalid_argument);
}

TEST(DecisionTest, NothingIsDecidedWithoutANumber) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(decide({}, limit(-1.0, 1.0), nan, 0.1), std::invalid_argument);
  EXPECT_THROW(decide({}, limit(-1.0, 1.0), 0.0, nan), std::invalid_argument);
  EXPECT_THROW(decide({}, limit(-1.0, 1.0), 0.0, -0.1), std::invalid_argument);
  EXPECT_THROW(decide({}, limit({}, {}), 0.0, 0.1), std::invalid_argument);
}

// References: tables of Student's t; for 2 and 4 degrees of freedom the tail is an algebraic function of t.
TEST(DecisionTest, ProbabilitiesAreThoseOfStudentsDistribution) {
  const double t = 1.5;
  EXPECT_NEAR(conformance_probability(0.0, 1.0, 2.0, -t, t), t / std::sqrt(2.0 + t * t), 1e-14);
  EXPECT_NEAR(conformance_probability(0.0, 1.0, 2.0, {}, t), 0.5 + 0.5 * t / std::sqrt(2.0 + t * t), 1e-14);
  EXPECT_NEAR(conformance_probability(0.0, 1.0, 10.0, {}, 2.228138852), 0.975, 1e-9);
  // U covers 95.45 %, whatever the degrees of freedom.
  for (const double degrees : {3.0, 21.0, kMany}) {
    const Decision decision = decide({}, limit(-1.0, 1.0), 0.0, 0.05, degrees);
    EXPECT_NEAR(conformance_probability(0.0, 0.05, degrees, -decision.expanded_uncertainty,
                                        decision.expanded_uncertainty),
                0.9544997361036416, 1e-12)
        << degrees;
  }
}

// One limit far away: one tail of U, 2.28 %. Limits U apart from the only value that is accepted: both tails.
TEST(DecisionTest, TheRiskIsTheLargestOfTheAcceptedValuesAndCountsBothTails) {
  for (const double degrees : {3.0, 21.0, kMany}) {
    const double outside = 1.0 - 0.9544997361036416;
    EXPECT_NEAR(*decide({}, limit({}, 1.0), 0.5, 0.05, degrees).risk, 0.5 * outside, 1e-12) << degrees;
    const double expanded = decide({}, limit({}, 1.0), 0.5, 0.05, degrees).expanded_uncertainty;
    const Decision narrow = decide({}, limit(-expanded, expanded), 0.0, 0.05, degrees);
    EXPECT_NEAR(*narrow.risk, outside, 1e-9) << degrees;
    EXPECT_NEAR(narrow.conformance_probability, 1.0 - outside, 1e-9) << degrees;
    EXPECT_EQ(narrow.conformity, Conformity::kPass);
    DecisionRule simple;
    simple.kind = DecisionKind::kSimple;
    const Decision at_limit = decide(simple, limit(-0.05, 0.05), 0.0, 0.05, degrees);
    EXPECT_GT(*at_limit.risk, 0.5) << degrees;  // half, and what lies beyond the other limit
    EXPECT_LT(*at_limit.risk, 0.58) << degrees;
  }
}

TEST(DecisionTest, NoDecisionIsPossibleWhereTheGuardBandLeavesNothing) {
  const Decision two_sided = decide({}, limit(-0.09, 0.09), 0.0, 0.05);
  EXPECT_EQ(two_sided.conformity, Conformity::kUndecided);
  EXPECT_FALSE(two_sided.risk || two_sided.lower_acceptance || two_sided.upper_acceptance);
  EXPECT_EQ(decide({}, limit(-0.09, 0.09), 5.0, 0.05).conformity, Conformity::kUndecided);
  // A quantity that cannot be negative has a limit on both sides: seen as "acceptance <= -1.5e3 %", FAIL.
  SpecificationLimit across = limit({}, 1.0);
  across.quantity = "transverse_sensitivity_u";
  across.unit = "%";
  EXPECT_EQ(decide({}, across, 0.5, 0.6).conformity, Conformity::kUndecided);
  EXPECT_EQ(decide({}, across, 0.5, 0.2).conformity, Conformity::kPass);
  EXPECT_EQ(decide({}, across, 0.7, 0.2).conformity, Conformity::kFail);
}

TEST(DecisionTest, EachQuantityHasItsRange) {
  EXPECT_EQ(range_of_quantity("transverse_sensitivity_u", "%").least, 0.0);
  EXPECT_EQ(range_of_quantity("intrinsic_angle_uv", "degree").most, 180.0);
  EXPECT_NEAR(range_of_quantity("misalignment_w", "mrad").most, 500.0 * std::numbers::pi, 1e-9);
  EXPECT_NEAR(range_of_quantity("non_orthogonality_uv", "mrad").least, -500.0 * std::numbers::pi, 1e-9);
  EXPECT_TRUE(std::isinf(range_of_quantity("sensitivity_ux", "V/(m/s2)").least));
  EXPECT_EQ(to_string(range_of_quantity("transverse_sensitivity_u", "%"), "%"), "0 % or more");
  EXPECT_EQ(to_string(range_of_quantity("misalignment_w", "mrad"), "mrad"), "0 to 1571 mrad");
}

}  // namespace
}  // namespace abcal
