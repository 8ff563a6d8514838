#include "protocol/estimators/norm/norm_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/norm/pose_import.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "tests/protocol/estimators/made_record.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

using ::testing::HasSubstr;

AccelerometerModel some_accelerometer() {
  AccelerometerModel aut;
  aut.sensitivity_matrix << 1.05, -0.08, 0.03, 0.11, 0.93, -0.05, -0.02, 0.07, 1.01;
  aut.offset = {0.05, -0.12, 0.2};
  return aut;
}

/// Poses all over the sphere.
std::vector<Pose> poses_of(const AccelerometerModel& aut, int count, double noise, unsigned seed,
                           bool with_u) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal;
  std::vector<Pose> poses;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d g = Eigen::Vector3d(normal(engine), normal(engine), normal(engine)).normalized();
    Pose pose;
    pose.reading = aut.sensitivity_matrix * g + aut.offset +
                   noise * Eigen::Vector3d(normal(engine), normal(engine), normal(engine));
    if (with_u) pose.u = Eigen::Vector3d::Constant(noise);
    poses.push_back(pose);
  }
  return poses;
}

TEST(NormFitTest, RecoversIntrinsicPropertiesFromNoiseFreePoses) {
  AccelerometerModel aut = some_accelerometer();
  for (const double unit : {1.0, 4096.0}) {
    AccelerometerModel scaled = aut;
    scaled.sensitivity_matrix *= unit;
    scaled.offset *= unit;
    const CalibrationResult result = analyse_norm(poses_of(scaled, 30, 0.0, 1, false));
    const IntrinsicProperties truth = intrinsic_properties(aut.sensitivity_matrix);
    EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
    for (std::size_t j = 0; j < 3; ++j) {
      const auto at = static_cast<Eigen::Index>(j);
      // Round-off of 1e-16, magnified by a condition of some ten.
      EXPECT_NEAR(result.intrinsic_sensitivity[j].value / unit, truth.sensitivity(at), 1e-13);
      EXPECT_NEAR(result.intrinsic_angle[j].value, truth.angle_deg(at), 1e-11);
      EXPECT_NEAR(result.offset[j].value / unit, aut.offset(at), 1e-13);
    }
    EXPECT_FALSE(result.sensitivity_matrix.has_value());
    EXPECT_FALSE(result.covariance.has_value());
  }
}

TEST(NormFitTest, UncertaintiesCoverTheTruthWithAndWithoutUncertaintiesOfTheReadings) {
  const AccelerometerModel aut = some_accelerometer();
  const IntrinsicProperties truth = intrinsic_properties(aut.sensitivity_matrix);
  constexpr int kRuns = 200;
  for (const bool with_u : {true, false}) {
    double squares = 0.0;
    for (unsigned seed = 1; seed <= kRuns; ++seed) {
      const CalibrationResult result = analyse_norm(poses_of(aut, 60, 1e-4, seed, with_u));
      for (std::size_t j = 0; j < 3; ++j) {
        const auto at = static_cast<Eigen::Index>(j);
        const auto add = [&](const Quantity& q, double expected) {
          squares += std::pow((q.value - expected) / q.standard_uncertainty, 2) / (9.0 * kRuns);
        };
        add(result.intrinsic_sensitivity[j], truth.sensitivity(at));
        add(result.intrinsic_angle[j], truth.angle_deg(at));
        add(result.offset[j], aut.offset(at));
      }
    }
    // 1800 squares, not quite independent; with 51 degrees of freedom Student's t adds 4 % to their mean.
    EXPECT_NEAR(squares, with_u ? 1.0 : 51.0 / 49.0, 0.15);
  }
}

TEST(NormFitTest, AgreesWithTheJointEstimatorOnTheSameRun) {
  const AccelerometerModel aut = some_accelerometer();
  std::mt19937_64 engine(3);
  AcsErrors acs;
  acs.alignment = {1e-4, -2e-4, 1.5e-4};
  acs.mean_step_x = Angle::degrees(0.01);
  RunRecord record = test::made_record(aut, acs);
  test::add_noise(record, 1e-5, engine);
  const CalibrationResult norm = analyse_norm(record);
  const CalibrationResult joint = analyse_joint(record);
  ASSERT_EQ(norm.verdict, Verdict::kUsable) << norm.why;
  EXPECT_EQ(norm.norm->poses, 216);
  EXPECT_GT(*norm.diagnostics.chi2_probability, 1e-3);
  for (std::size_t j = 0; j < 3; ++j) {
    for (const auto& [a, b] : {std::pair(norm.intrinsic_sensitivity[j], joint.intrinsic_sensitivity[j]),
                               std::pair(norm.intrinsic_angle[j], joint.intrinsic_angle[j]),
                               std::pair(norm.offset[j], joint.offset[j])}) {
      EXPECT_LT(std::abs(a.value - b.value),
                4.0 * std::hypot(a.standard_uncertainty, b.standard_uncertainty));
    }
  }
}

TEST(NormFitTest, ReadingsThatScatterMoreThanTheySayAreDoubtful) {
  std::vector<Pose> poses = poses_of(some_accelerometer(), 60, 1e-3, 5, true);
  const CalibrationResult honest = analyse_norm(poses);
  EXPECT_EQ(honest.verdict, Verdict::kUsable) << honest.why;
  for (Pose& pose : poses) *pose.u *= 0.1;
  const CalibrationResult boastful = analyse_norm(poses);
  EXPECT_EQ(boastful.verdict, Verdict::kDoubtful);
  EXPECT_THAT(boastful.why, HasSubstr("chi2"));
  // The uncertainties follow the scatter, not the claim: 51 degrees of freedom know it to 10 %.
  EXPECT_NEAR(boastful.intrinsic_sensitivity[0].standard_uncertainty /
                  honest.intrinsic_sensitivity[0].standard_uncertainty,
              1.0, 0.35);
}

TEST(NormFitTest, LeavesDisturbedPosesOut) {
  const AccelerometerModel aut = some_accelerometer();
  std::vector<Pose> poses = poses_of(aut, 60, 1e-4, 7, false);
  poses[10].reading(1) += 0.05;
  poses[40].reading *= 1.1;
  const CalibrationResult result = analyse_norm(poses);
  EXPECT_EQ(result.norm->poses_left_out, 2);
  EXPECT_EQ(result.norm->poses, 58);
  const IntrinsicProperties truth = intrinsic_properties(aut.sensitivity_matrix);
  for (std::size_t j = 0; j < 3; ++j) {
    EXPECT_LT(
        std::abs(result.intrinsic_sensitivity[j].value - truth.sensitivity(static_cast<Eigen::Index>(j))),
        4.5 * result.intrinsic_sensitivity[j].standard_uncertainty);
  }
}

TEST(NormFitTest, ListsThePosesThatItLeavesOutWithTheirResidualsAndTheRule) {
  std::vector<Pose> poses = poses_of(some_accelerometer(), 60, 1e-4, 7, false);
  poses[40].reading *= 1.1;
  poses[41].name = "the box on its side";
  poses[41].reading *= 0.95;
  const CalibrationResult result = analyse_norm(poses);
  ASSERT_EQ(result.norm->left_out.size(), 2U);
  EXPECT_EQ(result.norm->left_out[0].first, 41);
  EXPECT_NEAR(result.norm->left_out[0].second, 0.1, 0.05);  // The offset is a part of the reading.
  EXPECT_EQ(result.norm->left_out[1].first, 42);
  EXPECT_LT(result.norm->left_out[1].second, -0.02);
  EXPECT_THAT(result.diagnostics.notes,
              testing::Contains(testing::AllOf(HasSubstr("2 of 60 poses left out"), HasSubstr("pose 41 (+"),
                                               HasSubstr("the box on its side (-"),
                                               HasSubstr("5 robust standard deviations"))));
}

TEST(NormFitTest, APoseWithinItsOwnUncertaintyIsNeverLeftOut) {
  std::vector<Pose> poses = poses_of(some_accelerometer(), 60, 1e-5, 7, true);
  for (Pose& pose : poses) *pose.u *= 10.0;  // Stated too large: the others agree far better.
  poses[40].reading *= 1.0 + 3e-4;           // Three of its stated uncertainties.
  EXPECT_EQ(analyse_norm(poses).norm->poses_left_out, 0);
}

/// Six poses, gravity along both directions of each of the axes of a case.
std::vector<Pose> cardinal_poses(const AccelerometerModel& aut, double u) {
  std::vector<Pose> poses;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {1.0, -1.0}) {
      Pose pose;
      pose.reading = sign * aut.sensitivity_matrix.col(axis) + aut.offset;
      if (u > 0.0) pose.u = Eigen::Vector3d::Constant(u);
      poses.push_back(pose);
    }
  }
  return poses;
}

TEST(NormFitTest, SixPosesNeedTheStatedAnglesBetweenTheAxesAndSaySo) {
  AccelerometerModel aut;
  aut.sensitivity_matrix << 1.02, 0.001, -0.002, 0.001, 0.98, 0.0015, 0.002, -0.001, 1.01;
  aut.offset = {0.05, -0.03, 0.01};
  const CalibrationResult refused = analyse_norm(cardinal_poses(aut, 1e-5));
  EXPECT_EQ(refused.verdict, Verdict::kNotUsable);
  EXPECT_THAT(refused.why, HasSubstr("[item_uncertainty] orthogonality_deg"));
  EffectSizes sizes = linear_item();
  sizes.orthogonality = Angle::degrees(0.3);
  for (const double u : {1e-5, 0.0}) {
    const CalibrationResult result = analyse_norm(cardinal_poses(aut, u), sizes);
    EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
    EXPECT_EQ(result.diagnostics.degrees_of_freedom, 0);
    EXPECT_THAT(result.diagnostics.notes,
                testing::Contains(testing::AllOf(HasSubstr("6 poses are fewer than the nine unknowns"),
                                                 HasSubstr("0.3 degree"))));
    const IntrinsicProperties truth = intrinsic_properties(aut.sensitivity_matrix);
    for (std::size_t j = 0; j < 3; ++j) {
      const auto at = static_cast<Eigen::Index>(j);
      // Tilts of 2e-3 of the axes change a cosine by 2e-6 each.
      EXPECT_NEAR(result.intrinsic_sensitivity[j].value, truth.sensitivity(at), 2e-5);
      EXPECT_NEAR(result.offset[j].value, aut.offset(at), 2e-5);
      EXPECT_NEAR(result.intrinsic_angle[j].value, truth.angle_deg(at), 4.0 * 0.3);
      if (u == 0.0) {
        EXPECT_TRUE(std::isnan(result.intrinsic_angle[j].standard_uncertainty));
      } else {
        EXPECT_NEAR(result.intrinsic_angle[j].standard_uncertainty, 0.3, 0.01);
      }
    }
  }
}

TEST(NormFitTest, IntervalsHoldWhereTheOffsetsDriftAFifthOfTheirTolerance) {
  AccelerometerModel aut = some_accelerometer();
  const IntrinsicProperties truth = intrinsic_properties(aut.sensitivity_matrix);
  constexpr int kRuns = 60;
  int inside = 0, usable = 0;
  for (unsigned seed = 1; seed <= kRuns; ++seed) {
    std::mt19937_64 engine(seed);
    std::normal_distribution<double> normal;
    for (int j = 0; j < 3; ++j)
      aut.drift(j) = 0.2 * 1e-4 * truth.sensitivity(j) * (seed % 2 == 0 ? 1.0 : -1.0);
    RunRecord record = test::made_record(aut, {}, 36, Angle::degrees(10.0));
    test::add_noise(record, 1e-5, engine);
    const CalibrationResult result = analyse_norm(record);
    usable += result.verdict == Verdict::kUsable;
    for (std::size_t j = 0; j < 3; ++j) {
      const auto at = static_cast<Eigen::Index>(j);
      const auto holds = [](const Quantity& q, double expected) {
        return std::abs(q.value - expected) <= 1.96 * q.standard_uncertainty ? 1 : 0;
      };
      inside += holds(result.intrinsic_sensitivity[j], truth.sensitivity(at)) +
                holds(result.intrinsic_angle[j], truth.angle_deg(at)) +
                holds(result.offset[j], aut.offset(at));
    }
  }
  EXPECT_GE(usable, kRuns - 1);
  std::printf("norm, drift of 2e-5: 95 %% intervals hold in %.3f\n", inside / (9.0 * kRuns));
  EXPECT_GE(inside, 0.92 * 9.0 * kRuns);  // The least that is asked of every estimator.
}

TEST(NormFitTest, NonLinearityWithinItsStatementIsEstimatedAndTheLineResponseIsRight) {
  AccelerometerModel aut = some_accelerometer();
  aut.k3 = {3e-3, -2e-3, 4e-3};
  aut.k2 = {1e-3, 2e-3, -1e-3};
  std::mt19937_64 engine(5);
  RunRecord record = test::made_record(aut, {});
  test::add_noise(record, 1e-5, engine);
  const CalibrationResult result = analyse_norm(record);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
  const IntrinsicProperties truth = intrinsic_properties(aut.sensitivity_matrix);
  for (std::size_t j = 0; j < 3; ++j) {
    const auto at = static_cast<Eigen::Index>(j);
    const double s = truth.sensitivity(at);
    // The slope of a straight line over all directions of gravity: 3/5 of k3 |s|^2; the mean of k2 l^2 is a
    // third.
    EXPECT_NEAR(result.intrinsic_sensitivity[j].value, s * (1.0 + 0.6 * aut.k3(at) * s * s),
                4.0 * result.intrinsic_sensitivity[j].standard_uncertainty);
    EXPECT_NEAR(result.offset[j].value, aut.offset(at) + aut.k2(at) * s * s / 3.0,
                4.0 * result.offset[j].standard_uncertainty);
    EXPECT_LT(result.intrinsic_sensitivity[j].standard_uncertainty, 3e-5);  // 216 readings of 1e-5.
  }
  record.tolerances = linear_item(record.tolerances);
  EXPECT_EQ(analyse_norm(record).verdict, Verdict::kDoubtful) << "stated as linear";
}

TEST(NormFitTest, SaysWhereTheSphereIsBare) {
  const AccelerometerModel aut = some_accelerometer();
  std::vector<Pose> upper;
  for (const Pose& pose : poses_of(aut, 200, 1e-5, 9, false)) {
    if (pose.reading.z() > aut.offset.z() + 0.1) upper.push_back(pose);
  }
  const CalibrationResult result = analyse_norm(upper);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why, HasSubstr("no pose within"));
  const CalibrationResult whole = analyse_norm(poses_of(aut, 200, 1e-5, 9, false));
  EXPECT_EQ(whole.verdict, Verdict::kUsable);
  EXPECT_GT(whole.norm->sphere_coverage, 0.8);
  EXPECT_EQ(whole.norm->coverage_words, "");
}

TEST(NormFitTest, PosesThatDetermineNothingGiveNoNumbers) {
  const AccelerometerModel aut = some_accelerometer();
  const auto not_usable = [](const std::vector<Pose>& poses, const char* word) {
    const CalibrationResult result = analyse_norm(poses);
    EXPECT_EQ(result.verdict, Verdict::kNotUsable);
    EXPECT_THAT(result.why, HasSubstr(word));
    EXPECT_TRUE(std::isnan(result.intrinsic_sensitivity[0].value));
  };
  not_usable(poses_of(aut, 8, 0.0, 11, false), "nine");
  not_usable({}, "nine");
  std::vector<Pose> planar = poses_of(aut, 40, 0.0, 11, false);
  for (Pose& pose : planar) {
    const double a = pose.reading.x() * 10.0;
    pose.reading = aut.sensitivity_matrix * Eigen::Vector3d(std::cos(a), std::sin(a), 0.0);
  }
  not_usable(planar, "do not determine");
  not_usable(std::vector<Pose>(20, planar[0]), "read the same");
  planar[3].reading(0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(analyse_norm(planar), UnusableData);
}

// Reference: README of the shared data, "an independent norm fit on the static means".
TEST(NormFitTest, RealAccelerometerAgreesWithTheReferenceFit) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "real/xsens_acc.txt");
  const ImportedPoses imported = import_poses(path);
  EXPECT_TRUE(imported.from_time_series);
  EXPECT_EQ(imported.samples, 51175U);
  const CalibrationResult result = analyse_norm(imported.record);
  ASSERT_NE(result.verdict, Verdict::kNotUsable) << result.why;
  constexpr double kGravity = 9.81744;  // m/s2
  const double sensitivity[3] = {414.447, 412.121, 414.619};
  const double u_sensitivity[3] = {0.026, 0.014, 0.016};
  const double angle[3] = {89.795, 88.776, 89.471};
  const double u_angle[3] = {0.008, 0.007, 0.027};
  const double offset[3] = {33123.87, 33275.14, 32364.50};
  const double u_offset[3] = {0.25, 0.14, 0.15};
  for (std::size_t j = 0; j < 3; ++j) {
    const auto near = [](double value, double u, double reference, double u_reference) {
      EXPECT_LT(std::abs(value - reference), 2.0 * std::hypot(u, u_reference));
      EXPECT_LT(u, 2.0 * u_reference);  // an agreement bought with a large uncertainty is none
    };
    near(result.intrinsic_sensitivity[j].value / kGravity,
         result.intrinsic_sensitivity[j].standard_uncertainty / kGravity, sensitivity[j], u_sensitivity[j]);
    near(result.intrinsic_angle[j].value, result.intrinsic_angle[j].standard_uncertainty, angle[j],
         u_angle[j]);
    near(result.offset[j].value, result.offset[j].standard_uncertainty, offset[j], u_offset[j]);
  }
  EXPECT_NEAR(result.norm->norm_rms * kGravity, 1.1e-3, 2e-4);
  EXPECT_GE(result.norm->poses, 30);
}

TEST(NormFitTest, FileOfPosesWorks) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "real/michaelwro_poses.txt");
  const ImportedPoses imported = import_poses(path);
  EXPECT_FALSE(imported.from_time_series);
  EXPECT_EQ(imported.record.dwells.size(), 178U);
  const CalibrationResult result = analyse_norm(imported.record);
  ASSERT_NE(result.verdict, Verdict::kNotUsable) << result.why;
  EXPECT_GE(result.norm->poses, 170);
  // A MEMS accelerometer in g: some per cent of sensitivity, some hundredths of offset, angles within some
  // degrees.
  for (std::size_t j = 0; j < 3; ++j) {
    EXPECT_NEAR(result.intrinsic_sensitivity[j].value, 1.0, 0.05);
    EXPECT_NEAR(result.intrinsic_angle[j].value, 90.0, 2.0);
    EXPECT_NEAR(result.offset[j].value, 0.0, 0.1);
  }
  EXPECT_LT(result.norm->norm_rms, 2e-3);
}

}  // namespace
}  // namespace abcal
