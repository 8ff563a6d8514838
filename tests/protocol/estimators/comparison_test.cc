#include "protocol/estimators/checks/comparison.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <stdexcept>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "tests/protocol/estimators/made_record.h"

namespace abcal {
namespace {

using ::testing::HasSubstr;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const double kPi = std::acos(-1.0);

const Eigen::Matrix3d kMatrix{{1.10, 0.02, -0.03}, {0.01, 0.90, 0.04}, {-0.02, 0.03, 1.00}};

IntrinsicValues two_properties(double first, double second) {
  IntrinsicValues values = IntrinsicValues::Constant(kNan);
  values(1) = first;
  values(4) = second;
  return values;
}

Covariance9 two_covariances(double variance_1, double variance_4, double covariance) {
  Covariance9 matrix = Covariance9::Constant(kNan);  // elements that are not given must not be read
  matrix(1, 1) = variance_1;
  matrix(4, 4) = variance_4;
  matrix(1, 4) = matrix(4, 1) = covariance;
  return matrix;
}

TEST(ComparisonTest, NormalisedErrorsAndChi2ByHand) {
  // Differences 1 and 2 with covariance [[2, 1], [1, 3]]: chi2 = (1, 2) [[3, -1], [-1, 2]]/5 (1, 2)' = 7/5;
  // its tail with two degrees of freedom is exp(-7/10).
  const IntrinsicComparison comparison =
      compare_intrinsic(two_properties(5.0, 7.0), two_covariances(0.5, 1.0, 0.25), two_properties(6.0, 9.0),
                        two_covariances(1.5, 2.0, 0.75));
  EXPECT_EQ(comparison.degrees_of_freedom, 2);
  EXPECT_DOUBLE_EQ(comparison.properties[1].difference, 1.0);
  EXPECT_DOUBLE_EQ(comparison.properties[1].standard_uncertainty, std::sqrt(2.0));
  EXPECT_DOUBLE_EQ(comparison.properties[1].zeta, 1.0 / std::sqrt(2.0));
  // U1 = 2 sqrt(0.5), U2 = 2 sqrt(1.5): E_n = 1/sqrt(U1^2 + U2^2) = 1/sqrt(8).
  EXPECT_DOUBLE_EQ(comparison.properties[1].e_n, 1.0 / std::sqrt(8.0));
  EXPECT_DOUBLE_EQ(comparison.properties[4].zeta, 2.0 / std::sqrt(3.0));
  EXPECT_TRUE(std::isnan(comparison.properties[0].e_n));
  ASSERT_TRUE(comparison.chi2.has_value());
  EXPECT_NEAR(*comparison.chi2, 1.4, 1e-14);
  EXPECT_NEAR(*comparison.chi2_probability, std::exp(-0.7), 1e-14);
  EXPECT_NEAR(comparison.largest_e_n, 1.0 / std::sqrt(3.0), 1e-15);
  EXPECT_TRUE(comparison.agrees());
}

TEST(ComparisonTest, WhatIsSharedIsSubtracted) {
  Covariance9 shared = Covariance9::Zero();
  shared(1, 1) = 0.4;
  shared(4, 4) = 0.5;
  const IntrinsicComparison comparison =
      compare_intrinsic(two_properties(5.0, 7.0), two_covariances(0.5, 1.0, 0.0), two_properties(6.0, 9.0),
                        two_covariances(0.5, 1.0, 0.0), shared);
  // U^2 = U1^2 + U2^2 - 2 cov = 4 (0.5 + 0.5 - 0.8), 4 (1 + 1 - 1)
  EXPECT_NEAR(comparison.properties[1].e_n, 1.0 / std::sqrt(0.8), 1e-14);
  EXPECT_NEAR(comparison.properties[4].e_n, 2.0 / std::sqrt(4.0), 1e-14);
  EXPECT_FALSE(comparison.agrees());
}

TEST(ComparisonTest, NothingComparedAgreesWithNothing) {
  const IntrinsicComparison comparison =
      compare_intrinsic(IntrinsicValues::Constant(kNan), Covariance9::Zero(), two_properties(1.0, 2.0),
                        two_covariances(1.0, 1.0, 0.0));
  EXPECT_EQ(comparison.degrees_of_freedom, 0);
  EXPECT_FALSE(comparison.agrees());
  EXPECT_FALSE(comparison.chi2.has_value());
}

TEST(ComparisonTest, RefusesADifferenceWithoutUncertainty) {
  EXPECT_THROW(compare_intrinsic(two_properties(1.0, 2.0), two_covariances(0.0, 1.0, 0.0),
                                 two_properties(1.0, 2.0), two_covariances(0.0, 1.0, 0.0)),
               std::invalid_argument);
  Covariance9 all = Covariance9::Zero();
  all(1, 1) = all(4, 4) = 1.0;
  EXPECT_THROW(compare_intrinsic(two_properties(1.0, 2.0), two_covariances(1.0, 1.0, 0.0),
                                 two_properties(1.0, 2.0), two_covariances(1.0, 1.0, 0.0), all),
               std::invalid_argument);
}

TEST(RotationBetweenTest, FindsAKnownRotation) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1.0, -2.0, 2.0) / 3.0;
  for (const double degrees : {0.5, 30.0, 90.0, 179.0}) {
    const Eigen::Matrix3d t = Eigen::AngleAxisd(degrees * kPi / 180.0, axis).toRotationMatrix();
    const RotationBetween found =
        rotation_between(kMatrix, 1e-10 * MatrixCovariance::Identity(), kMatrix * t.transpose(),
                         1e-10 * MatrixCovariance::Identity());
    EXPECT_TRUE(found.same_handedness);
    EXPECT_NEAR(found.angle_deg, degrees, 1e-9);
    ASSERT_TRUE(found.axis.has_value());
    EXPECT_LT((*found.axis - axis).norm(), 1e-9);
    EXPECT_LT((found.rotation - t).norm(), 1e-12);
    EXPECT_LT(found.residual.norm(), 1e-12);
  }
}

// A covariance with one variance makes each standard uncertainty the size of one derivative.
TEST(RotationBetweenTest, UncertaintiesFollowTheDerivatives) {
  const Eigen::Matrix3d t = Eigen::AngleAxisd(0.7, Eigen::Vector3d(0.6, 0.0, -0.8)).toRotationMatrix();
  Eigen::Matrix3d second = kMatrix * t.transpose();
  second(0, 1) += 0.002;  // the two are not quite alike
  second(2, 2) -= 0.003;
  const MatrixCovariance none = MatrixCovariance::Zero();
  for (Eigen::Index i = 0; i < 18; ++i) {
    MatrixCovariance one = none;
    one(i % 9, i % 9) = 1.0;
    const RotationBetween found = i < 9 ? rotation_between(kMatrix, 1e-12 * one, second, none)
                                        : rotation_between(kMatrix, none, second, 1e-12 * one);
    constexpr double kStep = 1e-5;
    const auto changed = [&](double change) {
      Eigen::Matrix3d a = kMatrix;
      Eigen::Matrix3d b = second;
      (i < 9 ? a : b)(i % 9 / 3, i % 9 % 3) += change;
      return rotation_between(a, none, b, none);
    };
    const RotationBetween above = changed(kStep);
    const RotationBetween below = changed(-kStep);
    EXPECT_NEAR(found.angle_standard_uncertainty_deg,
                1e-6 * std::abs(above.angle_deg - below.angle_deg) / (2.0 * kStep), 1e-13)
        << i;
    EXPECT_NEAR(found.axis_standard_uncertainty_deg,
                1e-6 * (*above.axis - *below.axis).norm() / (2.0 * kStep) * 180.0 / kPi, 1e-13)
        << i;
    const Eigen::Matrix3d slope = (above.residual - below.residual).cwiseAbs() / (2.0 * kStep);
    EXPECT_LT((found.residual_standard_uncertainty - 1e-6 * slope).norm(), 1e-14) << i;
  }
}

TEST(RotationBetweenTest, AnAngleWithinItsUncertaintyHasNoAxis) {
  const Eigen::Matrix3d t = Eigen::AngleAxisd(1e-5, Eigen::Vector3d::UnitX()).toRotationMatrix();
  const MatrixCovariance covariance = 1e-8 * MatrixCovariance::Identity();
  const RotationBetween found = rotation_between(kMatrix, covariance, kMatrix * t.transpose(), covariance);
  EXPECT_FALSE(found.axis.has_value());
  EXPECT_GT(found.angle_standard_uncertainty_deg, found.angle_deg);
}

TEST(RotationBetweenTest, SeesAReversedAxisThatLengthsAndAnglesNeedNotShow) {
  Eigen::Matrix3d reversed = Eigen::Matrix3d::Identity();
  reversed(2, 2) = -1.0;
  const IntrinsicProperties right = intrinsic_properties(Eigen::Matrix3d::Identity());
  const IntrinsicProperties wrong = intrinsic_properties(reversed);
  EXPECT_EQ(right.sensitivity, wrong.sensitivity);
  EXPECT_EQ(right.angle_deg, wrong.angle_deg);
  const RotationBetween found = rotation_between(Eigen::Matrix3d::Identity(), MatrixCovariance::Identity(),
                                                 reversed, MatrixCovariance::Identity());
  EXPECT_FALSE(found.same_handedness);
  EXPECT_TRUE(std::isnan(found.angle_deg));
}

TEST(RotationBetweenTest, RefusesAMatrixWithoutThreeAxes) {
  Eigen::Matrix3d flat = Eigen::Matrix3d::Identity();
  flat.row(2) = flat.row(1);
  const MatrixCovariance none = MatrixCovariance::Zero();
  EXPECT_THROW(rotation_between(flat, none, kMatrix, none), std::invalid_argument);
  EXPECT_THROW(rotation_between(kMatrix, none, Eigen::Matrix3d::Constant(kNan), none), std::invalid_argument);
}

TEST(SharedTypeBTest, EffectsMakeTheTypeBCovariance) {
  RunRecord record =
      test::made_record({kMatrix, Eigen::Vector3d(0.1, 0.2, 0.3)}, {}, 12, Angle::degrees(30.0));
  const CalibrationResult result = analyse_abc(record);
  Covariance12 sum = Covariance12::Zero();
  for (const OutputEffect& effect : type_b_effects(record)) sum += effect.change * effect.change.transpose();
  EXPECT_LT((sum - *result.covariance_type_b).norm(), 1e-12 * sum.norm());
  // With itself a run shares all that the stage does.
  record.tolerances.drift = 0.0;
  const Covariance12 shared = shared_type_b(record, record);
  EXPECT_LT((shared - *analyse_abc(record).covariance_type_b).norm(), 1e-12 * shared.norm());
}

TEST(SharedTypeBTest, StepErrorsOfOtherAnglesAreNotShared) {
  RunRecord coarse = test::made_record({kMatrix, Eigen::Vector3d::Zero()}, {}, 12, Angle::degrees(30.0));
  RunRecord fine = test::made_record({kMatrix, Eigen::Vector3d::Zero()}, {}, 24, Angle::degrees(15.0));
  for (RunRecord* record : {&coarse, &fine}) {
    record->tolerances = without_further_effects({});
    record->tolerances.alignment = record->tolerances.initial_turn = record->tolerances.zero = Angle();
  }
  EXPECT_EQ(shared_type_b(coarse, fine).norm(), 0.0);
  EXPECT_GT(shared_type_b(coarse, coarse).norm(), 0.0);
}

TEST(SharedTypeBTest, TellsWhyARecordCannotBeUsed) {
  RunRecord record = test::made_record({kMatrix, Eigen::Vector3d::Zero()}, {}, 12, Angle::degrees(30.0));
  RunRecord empty;
  try {
    shared_type_b(record, empty);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), HasSubstr("experiment 1 has no angles"));
  }
}

// Pairs of runs on the same imperfect stage, the accelerometer remounted in between: with the shared part
// subtracted, the differences scatter according to their uncertainties; without, they look too good.
TEST(SharedTypeBTest, ZetaHasUnitVarianceOnOneStage) {
  std::mt19937_64 engine(20260301);
  std::normal_distribution<double> normal;
  const Angle step = Angle::degrees(30.0);
  constexpr int kSteps = 12;
  constexpr int kPairs = 60;
  constexpr double kNoise = 3e-5;
  double with = 0.0;
  double without = 0.0;
  double chi2 = 0.0;
  for (int pair = 0; pair < kPairs; ++pair) {
    const Tolerances tolerances = [] {
      Tolerances t = without_further_effects({});
      t.drift = 0.0;
      return t;
    }();
    AcsErrors stage;
    const double alignment = sincos(tolerances.alignment).sin;
    stage.alignment = {alignment * normal(engine), alignment * normal(engine), alignment * normal(engine)};
    stage.d2 = tolerances.initial_turn * normal(engine);
    stage.d3 = tolerances.initial_turn * normal(engine);
    stage.mean_step_x = tolerances.zero * normal(engine);
    stage.mean_step_z = tolerances.zero * normal(engine);
    for (auto& errors : stage.step_errors) {
      errors.clear();
      for (int n = 0; n < kSteps; ++n) errors.push_back(tolerances.step * normal(engine));
    }
    const Eigen::Matrix3d remounted =
        kMatrix * Eigen::AngleAxisd(0.4, Eigen::Vector3d(0.36, 0.48, 0.8)).toRotationMatrix();
    RunRecord first = test::made_record({kMatrix, Eigen::Vector3d(0.01, 0.02, 0.03)}, stage, kSteps, step);
    RunRecord second = test::made_record({remounted, Eigen::Vector3d(0.01, 0.02, 0.03)}, stage, kSteps, step);
    first.tolerances = second.tolerances = tolerances;
    test::add_noise(first, kNoise, engine);
    test::add_noise(second, kNoise, engine);
    const CalibrationResult a = analyse_abc(first);
    const CalibrationResult b = analyse_abc(second);
    const auto values = [](const CalibrationResult& result) {
      IntrinsicValues v;
      for (std::size_t j = 0; j < 3; ++j) {
        const auto row = static_cast<Eigen::Index>(j);
        v(row) = result.intrinsic_sensitivity[j].value;
        v(3 + row) = result.intrinsic_angle[j].value;
        v(6 + row) = result.offset[j].value;
      }
      return v;
    };
    const Covariance9 shared = intrinsic_jacobian(a.sensitivity_values()) * shared_type_b(first, second) *
                               intrinsic_jacobian(b.sensitivity_values()).transpose();
    const IntrinsicComparison subtracted =
        compare_intrinsic(values(a), *a.covariance_intrinsic, values(b), *b.covariance_intrinsic, shared);
    const IntrinsicComparison independent =
        compare_intrinsic(values(a), *a.covariance_intrinsic, values(b), *b.covariance_intrinsic);
    for (std::size_t i = 0; i < 9; ++i) {
      with += subtracted.properties[i].zeta * subtracted.properties[i].zeta / (9.0 * kPairs);
      without += independent.properties[i].zeta * independent.properties[i].zeta / (9.0 * kPairs);
    }
    chi2 += subtracted.chi2.value() / kPairs;
  }
  // 540 values, those of one pair partly correlated: the mean square has a standard deviation of at most
  // sqrt(2/540) times a few; chi2 of nine degrees of freedom averages 9 with sqrt(18/60) = 0.55.
  EXPECT_NEAR(with, 1.0, 0.25);
  EXPECT_NEAR(chi2, 9.0, 4.0 * 0.55);
  EXPECT_LT(without, 0.7 * with);
}

}  // namespace
}  // namespace abcal
