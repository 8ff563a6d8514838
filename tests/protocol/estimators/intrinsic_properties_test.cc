#include "protocol/estimators/shared/intrinsic_properties.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/reference/paper_tables.h"

namespace abcal {
namespace {

TEST(IntrinsicPropertiesTest, GivesTable2) {
  const IntrinsicProperties p = intrinsic_properties(reference::table2_sensitivity());
  // The print's 15 decimals, and 0.5e-15 in each element of s behind them.
  EXPECT_LT((p.sensitivity - reference::table2_intrinsic_sensitivity()).cwiseAbs().maxCoeff(), 1.5e-15);
  EXPECT_LT((p.angle_deg - reference::table2_intrinsic_angle_deg()).cwiseAbs().maxCoeff(), 1.3e-13);
}

TEST(IntrinsicPropertiesTest, SmallAnglesKeepTheirDigits) {
  // acos of a dot product would give 0 here.
  EXPECT_NEAR(angle_between({1, 0, 0}, {1, 1e-9, 0}).rad(), 1e-9, 1e-24);
  EXPECT_NEAR(angle_between({1, 0, 0}, {-1, 1e-9, 0}).deg(), 180.0 - 1e-9 * 57.29577951308232, 3e-14);
  EXPECT_EQ(angle_between({1, 0, 0}, {0, 2, 0}).deg(), 90.0);
}

TEST(IntrinsicPropertiesTest, JacobianAgreesWithCentralDifferences) {
  const Eigen::Matrix3d s = reference::table2_sensitivity();
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(s);
  constexpr double kStep =
      1e-5;  // error of the difference: step^2 x third derivatives of order 100 degrees = 1e-8
  for (Eigen::Index i = 0; i < 9; ++i) {
    Eigen::Matrix3d above = s;
    Eigen::Matrix3d below = s;
    above(i / 3, i % 3) += kStep;
    below(i / 3, i % 3) -= kStep;
    const IntrinsicProperties a = intrinsic_properties(above);
    const IntrinsicProperties b = intrinsic_properties(below);
    EXPECT_LT((jacobian.col(i).head<3>() - (a.sensitivity - b.sensitivity) / (2 * kStep)).norm(), 1e-8) << i;
    EXPECT_LT((jacobian.col(i).segment<3>(3) - (a.angle_deg - b.angle_deg) / (2 * kStep)).norm(), 1e-7) << i;
    EXPECT_EQ(jacobian.col(i).tail<3>().norm(), 0.0);
  }
  EXPECT_EQ((jacobian.rightCols<3>().bottomRows<3>()), Eigen::Matrix3d::Identity());
  EXPECT_EQ((jacobian.rightCols<3>().topRows<6>().norm()), 0.0);
}

TEST(IntrinsicPropertiesTest, AngleOfParallelAxesHasNoDerivative) {
  Eigen::Matrix3d s = Eigen::Matrix3d::Identity();
  s.row(1) = s.row(0);
  EXPECT_TRUE(std::isnan(intrinsic_jacobian(s)(3, 1)));
}

}  // namespace
}  // namespace abcal
