#include "protocol/model/arrival.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace abcal {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kWidth = 1e-4;

/// Responses of three outputs along x, y, z of the platter, on a perfect stage.
Eigen::Vector3d perfect(const StagePose& pose) {
  return gravity_alone(pose, StageInputs::Zero());
}

StageLeg about_x(double from_deg, double to_deg, double z_deg = 0.0) {
  return {true, from_deg * kDegree, to_deg * kDegree, z_deg * kDegree};
}
StageLeg about_z(double from_deg, double to_deg, double x_deg) {
  return {false, from_deg * kDegree, to_deg * kDegree, x_deg * kDegree};
}
ReadingArrival known(std::vector<StageLeg> legs, bool since = true) {
  return {1, 1, {since, std::move(legs)}};
}

ArrivalSigns signs_of(std::vector<ReadingArrival> readings, double u = 0.0) {
  ArrivalSigns signs(std::move(readings), kWidth);
  signs.find(perfect);
  signs.take_uncertainties(
      perfect, [u](const ResponseChange&, int) { return u; }, 1.0);
  return signs;
}

TEST(ArrivalTest, TheSignIsThatOfTheChangeByTheLastMotion) {
  const auto mean =
      signs_of({known({about_x(0.0, 20.0)}, false), known({about_x(20.0, 25.0)})}).mean(perfect);
  EXPECT_EQ(mean[0], Eigen::Vector3d(0.0, 1.0, -1.0));  // v = sin x rises, w = cos x falls; u is along X.
  EXPECT_EQ(mean[1], Eigen::Vector3d(0.0, 1.0, -1.0));
}

TEST(ArrivalTest, AnApproachStopDecidesNotTheReadingBefore) {
  // From 40 degrees down to 19 and up to 20: v is smaller than at the reading before, and was reached
  // upwards.
  const auto mean =
      signs_of({known({about_x(0.0, 40.0)}, false), known({about_x(40.0, 19.0), about_x(19.0, 20.0)})})
          .mean(perfect);
  EXPECT_EQ(mean[1](1), 1.0);
  EXPECT_EQ(mean[1](2), -1.0);
}

TEST(ArrivalTest, ThePoseBetweenTheAxesMotionsDecides) {
  // X turns, then Z: the sign of u is that of the turn about Z alone.
  const auto mean =
      signs_of({known({about_x(0.0, 60.0)}, false), known({about_x(60.0, 40.0), about_z(0.0, 30.0, 40.0)})})
          .mean(perfect);
  EXPECT_EQ(mean[1](0), 1.0);   // u = sin x sin z
  EXPECT_EQ(mean[1](1), -1.0);  // v = sin x cos z
}

TEST(ArrivalTest, PastAnExtremumBothRulesDiffer) {
  // v = sin x rises from 30 to 90 degrees and falls to 120: as a whole it rises, and arrives falling.
  const auto mean = signs_of({known({about_x(30.0, 120.0)}, false)}).mean(perfect);
  EXPECT_EQ(mean[0](1), 0.0);
  EXPECT_EQ(mean[0](2), -1.0);
}

TEST(ArrivalTest, ATurnWithinTheWidthLeavesAShareOfTheSign) {
  // w = cos x rises to 0 degrees and falls by 1.5e-5: 15 % of the width have turned round.
  const double beyond = std::sqrt(2.0 * 0.15 * kWidth) / kDegree;
  const auto mean =
      signs_of({known({about_x(-20.0, 0.0)}, false), known({about_x(0.0, beyond)})}).mean(perfect);
  EXPECT_EQ(mean[0](2), 1.0);
  EXPECT_NEAR(mean[1](2), 0.5 * (0.85 - 0.15 - 1.0), 1e-4);  // By the rule of arrival, and by the motion.
  // Once it has fallen by more than the width, both rules say so.
  const double far = 3.0 * std::sqrt(2.0 * kWidth) / kDegree;
  EXPECT_EQ(signs_of({known({about_x(-20.0, 0.0)}, false), known({about_x(0.0, far)})}).mean(perfect)[1](2),
            -1.0);
}

TEST(ArrivalTest, SmallChangesAddUpSinceTheExtremum) {
  // Motions of 0.4 widths each: the third is beyond the width together with those before, none is alone.
  const auto angle = [](double fall) { return std::acos(1.0 - fall) / kDegree; };
  std::vector<ReadingArrival> readings{known({about_x(-20.0, 0.0)}, false)};
  for (int k = 1; k <= 3; ++k)
    readings.push_back(known({about_x(angle(0.4 * (k - 1) * kWidth), angle(0.4 * k * kWidth))}));
  const auto mean = signs_of(readings).mean(perfect);
  EXPECT_NEAR(mean[1](2), 0.5 * (0.6 - 0.4 - 1.0), 1e-6);
  EXPECT_NEAR(mean[2](2), 0.5 * (0.2 - 0.8 - 1.0), 1e-6);
  EXPECT_EQ(mean[3](2), -1.0);
}

TEST(ArrivalTest, AWayThatIsNotKnownHasNoSign) {
  const auto signs = signs_of({known({}, false), known({about_x(0.0, 5.0)}), known({}, false)});
  EXPECT_EQ(signs.mean(perfect)[0], Eigen::Vector3d::Zero());
  EXPECT_EQ(signs.mean(perfect)[1](1), 1.0);
  EXPECT_EQ(signs.mean(perfect)[2], Eigen::Vector3d::Zero());
}

TEST(ArrivalTest, AReadingWithoutAMotionKeepsItsSign) {
  const auto mean = signs_of({known({about_x(0.0, 5.0)}, false), known({})}).mean(perfect);
  EXPECT_EQ(mean[1](1), 1.0);
}

TEST(ArrivalTest, AChangeOfTheSizeOfItsUncertaintyHasAMeanSign) {
  // The change is so far beyond the width that only its sign matters.
  const double u = std::sin(5.0 * kDegree);
  const auto mean = signs_of({known({about_x(0.0, 5.0)}, false)}, u).mean(perfect);
  EXPECT_NEAR(mean[0](1), std::erf(1.0 / std::numbers::sqrt2), 1e-3);
}

TEST(ArrivalTest, AChangeWithinTheWidthIsAveragedOverItsUncertainty) {
  // Against the mean over the normal distribution of the change, by the trapezoidal rule.
  const double change = -0.3, u = 0.5;  // widths
  double arrival = 0.0, sum = 0.0;
  for (double x = -8.0; x <= 8.0; x += 1e-3) {
    const double weight = std::exp(-0.5 * x * x), turned = std::clamp(change + u * x, -1.0, 1.0);
    arrival += weight * (turned + (1.0 - std::abs(turned)));  // 1 before
    sum += weight;
  }
  const double beyond = std::sqrt(2.0 * -change * kWidth) / kDegree;
  const auto signs =
      signs_of({known({about_x(-20.0, 0.0)}, false), known({about_x(0.0, beyond)})}, u * kWidth);
  EXPECT_EQ(signs.mean(perfect)[0](2), 1.0);
  EXPECT_NEAR(signs.mean(perfect)[1](2), 0.5 * (arrival / sum + std::erf(change / u / std::numbers::sqrt2)),
              1e-4);
}

TEST(ArrivalTest, OneItemFollowsOneOfTheRules) {
  const double beyond = std::sqrt(2.0 * 0.15 * kWidth) / kDegree;
  const auto signs =
      signs_of({known({about_x(-20.0, 0.0)}, false), known({about_x(0.0, beyond)}), known({}, false)}, 1e-5);
  EXPECT_EQ(signs.of_one_item(perfect, SignRule::kArrival)[0](2), 1.0);
  EXPECT_NEAR(signs.of_one_item(perfect, SignRule::kArrival)[1](2), 0.7, 1e-4);
  EXPECT_EQ(signs.of_one_item(perfect, SignRule::kLastMotion)[1](2), -1.0);
  EXPECT_EQ(signs.of_one_item(perfect, SignRule::kLastMotion)[2](2), 1.0);
}

TEST(ArrivalTest, OnAPerfectStageSmallChangesAreAsUnknownAsTheStage) {
  // u is along X: only the inclination of X, of which the stated size is 1.4e-4, changes it.
  const auto signs = signs_by_sizes({known({about_x(0.0, 5.0)}, false), known({about_x(5.0, 10.0)})},
                                    Eigen::Matrix3d::Identity(), EffectSizes{});
  EXPECT_LT(std::abs(signs[1](0)), 0.1);
  EXPECT_EQ(signs[1](1), 1.0);
}

}  // namespace
}  // namespace abcal
