#include "protocol/plan/limits.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <numbers>

namespace abcal {
namespace {

TEST(LimitsTest, TheDeviateIsExceededOnceInAMillion) {
  EXPECT_NEAR(std::erfc(kFalseAlarmDeviate / std::numbers::sqrt2) / kFalseAlarm, 1.0, 1e-5);
}

TEST(LimitsTest, FollowFromTheTolerances) {
  Tolerances tolerances;
  tolerances.step = Angle::degrees(0.002);
  tolerances.initial_turn = Angle::degrees(0.001);
  tolerances.zero = Angle::degrees(0.004);
  tolerances.drift = 3e-5;
  EXPECT_DOUBLE_EQ(angle_limit({}, tolerances).deg(), 0.002 * kFalseAlarmDeviate);
  EXPECT_DOUBLE_EQ(slip_limit({}, tolerances).deg(), 0.004 * kFalseAlarmDeviate * std::sqrt(2.0));
  EXPECT_DOUBLE_EQ(drift_limit({}, tolerances), 3e-5 * kFalseAlarmDeviate);
  // The drift that is allowed, at 0.1 mg at 1 g for each kelvin.
  EXPECT_DOUBLE_EQ(temperature_change_limit_degc({}, tolerances), 0.3 * kFalseAlarmDeviate);
}

TEST(LimitsTest, ABenchFileMaySayOtherwise) {
  LimitsConfig limits;
  limits.slip = Angle::degrees(1.0);
  limits.angle = Angle::degrees(2.0);
  limits.drift = 3.0;
  limits.temperature_change_degc = 4.0;
  EXPECT_EQ(slip_limit(limits, {}).deg(), 1.0);
  EXPECT_EQ(angle_limit(limits, {}).deg(), 2.0);
  EXPECT_EQ(drift_limit(limits, {}), 3.0);
  EXPECT_EQ(temperature_change_limit_degc(limits, {}), 4.0);
}

TEST(LimitsTest, TheNominalResponseComesFromTheUnitOrTheItem) {
  EXPECT_DOUBLE_EQ(*nominal_response({}, "g", 9.80665), 1.0);
  EXPECT_DOUBLE_EQ(*nominal_response({}, "m/s2", 9.81), 9.81);
  EXPECT_DOUBLE_EQ(*nominal_response({}, "m/s^2", 9.81), 9.81);
  EXPECT_DOUBLE_EQ(*nominal_response({}, "mg", 9.80665), 1000.0);
  EXPECT_FALSE(nominal_response({}, "V", 9.81));
  ExpectedItem item;
  item.nominal_sensitivity = 0.66;  // V for one g
  EXPECT_DOUBLE_EQ(*nominal_response(item, "V", kStandardGravity), 0.66);
}

TEST(LimitsTest, TheMountingIsASignedPermutation) {
  EXPECT_TRUE(mounting_matrix("x y z")->isIdentity());
  const Eigen::Matrix3d turned = *mounting_matrix("-y +x z");
  EXPECT_EQ(turned.row(0), Eigen::RowVector3d(0, -1, 0));
  EXPECT_EQ(turned.row(1), Eigen::RowVector3d(1, 0, 0));
  EXPECT_EQ(turned.determinant(), 1.0);
  for (const char* wrong : {"", "x", "x y", "x y y", "x y z x", "x y q", "xyz", "x y -", "-- y z"})
    EXPECT_FALSE(mounting_matrix(wrong)) << wrong;
}

}  // namespace
}  // namespace abcal
