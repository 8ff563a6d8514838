// Stated sizes that are too large are said, and make no uncertainty smaller.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/statistics/distributions.h"
#include "tests/protocol/estimators/made_record.h"

namespace abcal {
namespace {

using testing::Contains;
using testing::ContainsRegex;
using testing::HasSubstr;
using testing::Not;

/// A run on a stage whose step errors and alignment have `share` of their stated sizes.
RunRecord run_with(double share, unsigned seed, double noise = 1e-5, int steps = 36) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  RunRecord stated = test::made_record({}, {}, steps, Angle::degrees(360.0 / steps));
  const EffectSizes& sizes = stated.tolerances;
  AcsErrors errors;
  const double q = share * sincos(sizes.alignment).sin;
  errors.alignment = {q * normal(engine), q * normal(engine), q * normal(engine)};
  errors.d2 = sizes.initial_turn * (share * normal(engine));
  errors.d3 = sizes.initial_turn * (share * normal(engine));
  errors.mean_step_x = sizes.zero * (share * normal(engine));
  errors.mean_step_z = sizes.zero * (share * normal(engine));
  for (std::vector<Angle>& list : errors.step_errors)
    for (int n = 0; n < steps; ++n) list.push_back(sizes.step * (share * normal(engine)));
  RunRecord record = test::made_record({}, errors, steps, Angle::degrees(360.0 / steps));
  record.tolerances.k2 = record.tolerances.k3 = 1e-6;  // The item is linear.
  record.tolerances.drift = 1e-8;
  test::add_noise(record, noise, engine);
  return record;
}

TEST(LowChi2Test, SizesThatAreStatedTooLargeAreSaidWithTheFactorAndTheKey) {
  const CalibrationResult result = analyse_joint(run_with(0.5, 3));
  const Diagnostics& d = result.diagnostics;
  ASSERT_TRUE(d.sizes_too_large) << *d.chi2 << " for " << d.degrees_of_freedom;
  EXPECT_NEAR(*d.sizes_too_large, std::sqrt(d.degrees_of_freedom / *d.chi2), 1e-12);
  EXPECT_LT(*d.low_chi2_probability, 1e-3);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << "sizes on the safe side are no fault";
  EXPECT_THAT(result.why, HasSubstr("far below"));
  EXPECT_THAT(result.why, Not(HasSubstr("probability 1)")));
  EXPECT_THAT(d.notes, Contains(HasSubstr("chi2 is far below its degrees of freedom")));
  // The step errors are half of what is stated; the other effects are too few to tell.
  EXPECT_THAT(d.notes, Contains(ContainsRegex("step_deg (1.[6-9]|2)")));
}

// One in a thousand sound runs has a chi2 below the limit: none of 40 with a probability of 0.96.
TEST(LowChi2Test, ASoundRunIsNotCalledTooLarge) {
  for (unsigned seed = 1; seed <= 40; ++seed) {
    const Diagnostics d = analyse_joint(run_with(1.0, seed, 1e-5, 12)).diagnostics;
    EXPECT_FALSE(d.sizes_too_large) << seed << ": " << *d.chi2 << " for " << d.degrees_of_freedom;
    EXPECT_NEAR(*d.low_chi2_probability + *d.chi2_probability, 1.0, 1e-9);
  }
}

/// Noise of each output that hardly changes from angle to angle (correlation length 10 angles).
RunRecord wandering(double tau, double stated, unsigned seed) {
  RunRecord record = run_with(1.0, seed, 0.1 * stated, 36);
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  const double decay = std::exp(-1.0 / 2.0);
  Eigen::Vector3d state = Eigen::Vector3d::Zero();
  for (DwellRecord& dwell : record.dwells) {
    for (double& each : state) each = decay * each + tau * std::sqrt(1.0 - decay * decay) * normal(engine);
    dwell.mean += state;
    dwell.u_mean = Eigen::Vector3d::Constant(stated);
  }
  return record;
}

// Where readings scatter less than stated the stated noise may be a process with little white noise. Its
// probability may not make an uncertainty smaller than the stated noise alone gives.
TEST(LowChi2Test, ItShrinksNoUncertainty) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    const RunRecord record = wandering(0.4e-4, 1e-4, seed);
    JointOptions white;
    white.noise_process = false;
    const CalibrationResult with = analyse_joint(record), stated = analyse_joint(record, white);
    ASSERT_GT(with.joint->process_tau, 0.0) << "the stated noise is taken for a process";
    for (Eigen::Index i = 0; i < 12; ++i)
      EXPECT_GE((*with.covariance)(i, i), (1.0 - 1e-9) * (*stated.covariance)(i, i)) << seed << " " << i;
  }
}

TEST(LowChi2Test, TheLowerTailKeepsItsDigits) {
  // chi2 with two degrees of freedom is exponential: P(x <= c) = 1 - exp(-c/2).
  EXPECT_NEAR(chi2_lower_tail(1e-12, 2) / 5e-13, 1.0, 1e-9);
  EXPECT_NEAR(chi2_lower_tail(3.0, 2), 1.0 - std::exp(-1.5), 1e-14);
  EXPECT_TRUE(std::isnan(chi2_lower_tail(1.0, 0)));
}

}  // namespace
}  // namespace abcal
