#include "protocol/model/forward_model.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

namespace abcal {
namespace {

// A few ulp of numbers of order 1, after some ten operations.
constexpr double kRoundOff = 4e-15;

AcsErrors some_errors(std::mt19937_64& engine, double size) {
  std::normal_distribution<double> normal(0.0, size);
  AcsErrors errors;
  errors.alignment = {normal(engine), normal(engine), normal(engine)};
  errors.d2 = Angle::radians(normal(engine));
  errors.d3 = Angle::radians(normal(engine));
  errors.mean_step_x = Angle::radians(normal(engine));
  errors.mean_step_z = Angle::radians(normal(engine));
  for (auto& list : errors.step_errors) {
    for (int n = 0; n < 5; ++n) list.push_back(Angle::radians(normal(engine)));
  }
  return errors;
}

// The equations of docs/theory/model.md as they stand there: the sensitivity vectors turn, z stays.
double reading_by_turning_the_vector(int experiment, int n, Angle alpha, const AcsErrors& errors,
                                     const Eigen::Vector3d& s) {
  const Eigen::Vector3d x = errors.alignment.x_axis();
  const Eigen::Vector3d z = errors.alignment.z_axis();
  const auto f =
      errors.step_errors[static_cast<std::size_t>(experiment - 1)][static_cast<std::size_t>(n - 1)];
  const Angle minus_90 = Angle::degrees(-90.0);
  if (experiment == 1) return rodrigues(s, x, alpha + errors.mean_step_x + f).z();
  if (experiment == 2)
    return rodrigues(rodrigues(s, z, minus_90 + errors.d2), x, alpha + errors.mean_step_x + f).z();
  return rodrigues(rodrigues(s, x, minus_90 + errors.d3), rodrigues(z, x, minus_90 + errors.d3),
                   alpha + errors.mean_step_z + f)
      .z();
}

TEST(RodriguesTest, TurnsRightHandedAndAFullTurnReturns) {
  const Eigen::Vector3d x = Eigen::Vector3d::UnitX();
  const Eigen::Vector3d y = Eigen::Vector3d::UnitY();
  const Eigen::Vector3d z = Eigen::Vector3d::UnitZ();
  EXPECT_EQ(rodrigues(x, z, Angle::degrees(90.0)), y);
  EXPECT_EQ(rodrigues(y, x, Angle::degrees(90.0)), z);
  EXPECT_EQ(rodrigues(z, x, Angle::degrees(-90.0)), y);
  EXPECT_EQ(rodrigues(Eigen::Vector3d(0.1, 0.2, 0.3), z, Angle::degrees(360.0)),
            Eigen::Vector3d(0.1, 0.2, 0.3));
}

TEST(RodriguesTest, AgreesWithEigenAboutAnyAxis) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector3d v(normal(engine), normal(engine), normal(engine));
    const Eigen::Vector3d e = Eigen::Vector3d(normal(engine), normal(engine), normal(engine)).normalized();
    const Angle a = Angle::degrees(180.0 * normal(engine));
    EXPECT_LT((rodrigues(v, e, a) - Eigen::AngleAxisd(a.rad(), e) * v).norm(), kRoundOff * (1.0 + v.norm()));
  }
}

TEST(ForwardModelTest, TurningGravityBackEqualsTurningTheSensitivityVectors) {
  std::mt19937_64 engine(2);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 50; ++trial) {
    const AcsErrors errors = some_errors(engine, 0.1);  // large on purpose: not only to first order
    const Eigen::Vector3d s(normal(engine), normal(engine), normal(engine));
    for (int experiment = 1; experiment <= 3; ++experiment) {
      for (int n = 1; n <= 5; ++n) {
        const Angle alpha = Angle::degrees(71.0 * (n - 1));
        const Eigen::Vector3d g = gravity_in_aut(experiment, n, alpha, errors);
        EXPECT_NEAR(s.dot(g), reading_by_turning_the_vector(experiment, n, alpha, errors, s),
                    kRoundOff * (1.0 + s.norm()));
        EXPECT_NEAR(g.norm(), 1.0, kRoundOff);
      }
    }
  }
}

TEST(ForwardModelTest, PerfectStageGivesTheTextbookForces) {
  const AcsErrors perfect;
  const double c = std::cos(Angle::degrees(30.0).rad());
  const double s = 0.5;
  const Angle a = Angle::degrees(30.0);
  // Experiment 1: s_y z-component rises with sin a. Experiments 2 and 3: x and y take their turn (ABC
  // equations).
  EXPECT_LT((gravity_in_aut(1, 1, a, perfect) - Eigen::Vector3d(0, s, c)).norm(), kRoundOff);
  EXPECT_LT((gravity_in_aut(2, 1, a, perfect) - Eigen::Vector3d(-s, 0, c)).norm(), kRoundOff);
  EXPECT_LT((gravity_in_aut(3, 1, a, perfect) - Eigen::Vector3d(-s, -c, 0)).norm(), kRoundOff);
  EXPECT_EQ(gravity_in_aut(1, 1, Angle(), perfect), Eigen::Vector3d(0, 0, 1));
}

TEST(ForwardModelTest, MeanAndSingleStepErrorsAddToTheAngle) {
  AcsErrors errors;
  errors.mean_step_x = Angle::degrees(0.25);
  errors.mean_step_z = Angle::degrees(0.5);
  errors.step_errors[1] = {Angle(), Angle::degrees(0.125)};
  EXPECT_EQ(errors.rotation_error(1, 7).deg(), 0.25);
  EXPECT_EQ(errors.rotation_error(2, 2).deg(), 0.375);
  EXPECT_EQ(errors.rotation_error(2, 3).deg(), 0.25);  // beyond the list: zero
  EXPECT_EQ(errors.rotation_error(3, 1).deg(), 0.5);
  EXPECT_EQ(gravity_in_aut(2, 2, Angle::degrees(10.0), errors),
            gravity_in_aut(2, 2, Angle::degrees(10.375), AcsErrors()));
  EXPECT_THROW(errors.rotation_error(4, 1), std::invalid_argument);
  EXPECT_THROW(errors.rotation_error(1, 0), std::invalid_argument);
  EXPECT_THROW(gravity_circle(0, errors), std::invalid_argument);
}

TEST(ForwardModelTest, TheMatrixTiltsWithThePlatter) {
  const Alignment alignment{3e-3, -2e-3, 1e-3};
  Eigen::Matrix3d s;
  s << 1.0, 0.1, 0.2, -0.1, 0.9, 0.3, 0.2, 0.1, 1.1;
  const Eigen::Matrix3d turned = tilted(s, alignment);
  // The platter's z direction becomes Z: what pointed along z points along the axis.
  EXPECT_LT((tilted(Eigen::Matrix3d::Identity(), alignment).row(2).transpose() - alignment.z_axis()).norm(),
            kRoundOff);
  const Eigen::Quaterniond rotation =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), alignment.z_axis());
  for (Eigen::Index j = 0; j < 3; ++j) {
    EXPECT_LT((turned.row(j).transpose() - rotation * s.row(j).transpose()).norm(), kRoundOff);
  }
  EXPECT_EQ(tilted(s, Alignment{0.0, 0.0, 0.01}), s);  // X plays no part
}

TEST(ForwardModelTest, ResponseAddsNonLinearityAndDrift) {
  AccelerometerModel a;
  a.sensitivity_matrix << 2, 0, 0, 0, 3, 0, 0, 0, 4;
  a.offset = {10, 20, 30};
  a.k2 = {0.5, 0, 0};
  a.k3 = {0, 0.25, 0};
  a.drift = {0, 0, 8};
  const Eigen::Vector3d r = response(a, {1, 1, 1}, -0.25);
  EXPECT_EQ(r, Eigen::Vector3d(10 + 2 + 0.5 * 4, 20 + 3 + 0.25 * 27, 30 + 4 - 2));
}

}  // namespace
}  // namespace abcal
