#include "sim/body_motion.h"

#include <gtest/gtest.h>

#include <numbers>

#include "sim/sim_bench.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr Clock::Instant kWorldBegins{};
constexpr double kDegree = std::numbers::pi / 180.0;

/// Where a body that turns with these rates arrives, integrated by small steps.
Eigen::Matrix3d integrated(const SimBench& bench, Clock::Instant from, Clock::Instant to) {
  Eigen::Matrix3d R_LB = bench.body_motion(from).R_LB;
  constexpr auto kStep = milliseconds(1);
  for (Clock::Instant t = from; t < to; t += kStep) {
    const Eigen::Vector3d turn =
        bench.body_motion(t + kStep / 2).rate_B_radps * to_seconds(Clock::Duration(kStep));
    if (turn.norm() > 0.0)
      R_LB = (R_LB * Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix()).eval();
  }
  return R_LB;
}

TEST(BodyMotionTest, AtRestTheBodyIsAlongTheFrameAndTheFieldPointsNorthAndDown) {
  const SimBench bench{BenchTruth{}};
  const BodyMotion body = bench.body_motion(kWorldBegins + seconds(1));
  EXPECT_TRUE(body.R_LB.isIdentity(1e-15));
  EXPECT_EQ(body.rate_B_radps, Eigen::Vector3d::Zero());
  EXPECT_TRUE(body.field_B_gauss.isApprox(Eigen::Vector3d(0.25, 0.0, -0.45), 1e-15));
  // z up is z down turned by half a turn about north.
  EXPECT_TRUE(roll_pitch_yaw_of(body.to_ned()).isApprox(Eigen::Vector3d(std::numbers::pi, 0.0, 0.0), 1e-15));
  // x of the body points north: a quarter of a turn from east.
  EXPECT_NEAR(roll_pitch_yaw_of(body.to_enu())[2], 90.0 * kDegree, 1e-15);
  EXPECT_TRUE(roll_pitch_yaw_of(body.to_nwu()).isZero(1e-15));
}

TEST(BodyMotionTest, RatesIntegrateToTheAttitudeAlsoWithBothAxesAndStageErrors) {
  BenchTruth truth;
  truth.zx = 0.01;
  truth.xz = -0.02;
  truth.x.mean_step_error = Angle::degrees(0.3);
  truth.z.mean_step_error = Angle::degrees(-0.2);
  SimBench bench(truth);
  bench.move(StageAxis::kX, Angle::degrees(70.0), kWorldBegins);
  bench.move(StageAxis::kZ, Angle::degrees(-120.0), kWorldBegins + seconds(1));
  const Clock::Instant end = kWorldBegins + seconds(10);
  EXPECT_GT(bench.body_motion(kWorldBegins + seconds(2)).rate_B_radps.norm(), 20.0 * kDegree);
  EXPECT_EQ(bench.body_motion(end).rate_B_radps, Eigen::Vector3d::Zero());
  const Eigen::Matrix3d missing =
      integrated(bench, kWorldBegins, end).transpose() * bench.body_motion(end).R_LB;
  // Second order in steps of 1 ms at 20 deg/s, and the jerks of the profile: below a thousandth of a degree.
  EXPECT_LT(Eigen::AngleAxisd(missing).angle(), 0.001 * kDegree);
}

TEST(BodyMotionTest, AnIdealAccelerometerFeelsUpAlongTheSameBody) {
  BenchTruth truth;
  truth.sensitivity_matrix << 0.0, 0.0, -9.8, 0.0, 9.8, 0.0, 9.8, 0.0, 0.0;  // mounted on its side
  SimBench bench(truth);
  bench.move(StageAxis::kX, Angle::degrees(50.0), kWorldBegins);
  for (int n = 1; n < 40; ++n) {
    const Clock::Instant t = kWorldBegins + milliseconds(100 * n);
    const Eigen::Vector3d up_B = bench.body_motion(t).R_LB.row(2);
    EXPECT_TRUE(bench.output(t, 0).value.isApprox(9.8 * up_B, 1e-12));
  }
  // X turns about x of the platter, which is w of this instrument.
  EXPECT_NEAR(bench.body_motion(kWorldBegins + seconds(1)).rate_B_radps[2], 20.0 * kDegree, 1e-12);
}

TEST(BodyMotionTest, OutputsOfALeftHandedMatrixHaveARightHandedBody) {
  BenchTruth truth;
  truth.sensitivity_matrix.diagonal() << 1.0, 1.0, -1.0;
  const SimBench bench(truth);
  EXPECT_NEAR(bench.body_motion(kWorldBegins).R_LB.determinant(), 1.0, 1e-14);
}

}  // namespace
}  // namespace abcal::sim
