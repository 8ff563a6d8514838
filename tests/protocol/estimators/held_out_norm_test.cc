// |a| on poses that the fit did not see, as a check of the stated uncertainty.
#include "protocol/estimators/joint/held_out_norm.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

#include "protocol/estimators/joint/analyse_joint.h"
#include "tests/protocol/estimators/made_record.h"

namespace abcal {
namespace {

AccelerometerModel skewed_accelerometer() {
  AccelerometerModel aut;
  aut.sensitivity_matrix << 1.08, -0.05, 0.04, 0.37, 0.92, 0.29, -0.12, 0.26, 0.82;
  aut.offset << 0.05, 0.18, -0.23;
  return aut;
}

/// A run of 3 x 36 angles on a stage with errors, noise 1e-5.
RunRecord run_of(const AccelerometerModel& aut, unsigned seed, double noise = 1e-5) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, 1e-4);
  AcsErrors errors;
  errors.alignment = {normal(engine), normal(engine), normal(engine)};
  errors.mean_step_x = Angle::radians(normal(engine));
  for (std::vector<Angle>& list : errors.step_errors)
    for (int n = 0; n < 36; ++n) list.push_back(Angle::radians(normal(engine)));
  RunRecord record = test::made_record(aut, errors, 36, Angle::degrees(10.0));
  test::add_noise(record, noise, engine);
  return record;
}

TEST(HeldOutNormTest, ASoundRunHasTheNormThatItsUncertaintiesExpect) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    const HeldOutNorm norm = held_out_norm(run_of(skewed_accelerometer(), seed));
    EXPECT_EQ(norm.folds, 4);
    EXPECT_EQ(norm.poses, 108);
    // 108 poses: the root mean square is known to 1 / sqrt(216) = 7 %; four of these.
    EXPECT_NEAR(norm.rms_in_u, 1.0, 0.28) << seed;
    EXPECT_NEAR(norm.rms_of_model / norm.rms_expected, 1.0, 0.28) << seed;
    EXPECT_GT(norm.probability, 1e-4) << seed;
    EXPECT_GE(norm.largest, norm.rms);
  }
}

// The norm shows an uncertainty of the readings that is stated too small.
TEST(HeldOutNormTest, ReadingsNoisierThanStatedAreSeen) {
  RunRecord record = run_of(skewed_accelerometer(), 1, 3e-5);
  for (DwellRecord& dwell : record.dwells) dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
  JointOptions options;
  options.noise_process = false;  // It would find the noise itself.
  const HeldOutNorm norm = held_out_norm(record, options);
  EXPECT_GT(norm.rms_in_u, 2.0);
  EXPECT_LT(norm.probability, 1e-5);
}

// A turn of the whole item changes no magnitude: the check is blind to it, as it is said to be.
TEST(HeldOutNormTest, ItIsBlindToTheOrientation) {
  AccelerometerModel turned = skewed_accelerometer();
  const double angle = 0.01;
  Eigen::Matrix3d about_z;
  about_z << std::cos(angle), -std::sin(angle), 0.0, std::sin(angle), std::cos(angle), 0.0, 0.0, 0.0, 1.0;
  turned.sensitivity_matrix = turned.sensitivity_matrix * about_z;
  const HeldOutNorm before = held_out_norm(run_of(skewed_accelerometer(), 2));
  const HeldOutNorm after = held_out_norm(run_of(turned, 2));
  EXPECT_NEAR(after.rms / before.rms, 1.0, 0.05);
}

// The customer's equation is linear: a non-linearity of the item stays in its norm, and not in the model's.
TEST(HeldOutNormTest, ANonLinearityIsInTheCustomersEquationOnly) {
  AccelerometerModel curved = skewed_accelerometer();
  curved.k2 << 1e-3, 1e-3, 1e-3;
  const HeldOutNorm norm = held_out_norm(run_of(curved, 3));
  EXPECT_GT(norm.rms, 1e-4);
  EXPECT_NEAR(norm.rms_in_u, 1.0, 0.28);
}

TEST(HeldOutNormTest, TooFewAnglesGiveNone) {
  RunRecord record = run_of(skewed_accelerometer(), 1);
  record.dwells.resize(6);
  EXPECT_EQ(held_out_norm(record).folds, 0);
}

}  // namespace
}  // namespace abcal
