// The uncertainty of the norm result: its budget, and Monte Carlo of the whole fit.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "protocol/estimators/norm/norm_fit.h"
#include "protocol/uncertainty/run_uncertainty.h"

namespace abcal {
namespace {

using testing::HasSubstr;

/// Poses of an item all over the sphere, or one on each face of a cube, with noise of the reading.
RunRecord poses(int count, double noise, bool with_u) {
  std::mt19937_64 engine(11);
  std::normal_distribution<double> normal(0.0, 1.0);
  Eigen::Matrix3d s;
  s << 1.02, 0.01, -0.02, 0.0, 0.98, 0.015, 0.01, 0.0, 1.01;
  RunRecord record;
  record.source = "made";
  record.estimator = "norm";
  record.tolerances = linear_item();
  for (int i = 0; i < count; ++i) {
    Eigen::Vector3d direction(normal(engine), normal(engine), normal(engine));
    if (count == 6) direction = (i % 2 == 0 ? 1.0 : -1.0) * Eigen::Vector3d::Unit(i / 2);
    DwellRecord& dwell = record.dwells.emplace_back();
    dwell.n = i + 1;
    dwell.mean = s * direction.normalized() + Eigen::Vector3d(0.01, -0.02, 0.03) +
                 noise * Eigen::Vector3d(normal(engine), normal(engine), normal(engine));
    if (with_u) dwell.u_mean = Eigen::Vector3d::Constant(noise);
  }
  return record;
}

RunUncertainty study_of(const RunRecord& record) {
  UncertaintyOptions options;
  options.trials = 4000;
  return norm_uncertainty(record, options);
}

/// Budget and Monte Carlo give what the result states; `by_interval`: the interval does.
void expect_agreement(const RunUncertainty& study, bool by_interval) {
  EXPECT_TRUE(study.warnings.empty()) << study.warnings.front();
  ASSERT_EQ(study.combined.coverage.size(), static_cast<std::size_t>(kStudyOutputs));
  for (int k = 0; k < kFirstOffset; ++k) {
    EXPECT_TRUE(std::isnan(to_vector(study.value)(k))) << k;
    EXPECT_TRUE(std::isnan(study.combined.standard_deviation(k))) << k;
  }
  for (int k = kFirstOffset; k < kStudyOutputs; ++k) {
    const double u = study.joint->standard_uncertainty(k);
    EXPECT_NEAR(study.budget.combined(k) / u, 1.0, 1e-9) << output_symbol(k);
    const CoverageInterval& interval = study.combined.coverage[static_cast<std::size_t>(k)].symmetric;
    // 4000 trials know a standard deviation to 1.1 %, and an interval to 2 %: five of them.
    if (by_interval) {
      EXPECT_NEAR(0.5 * (interval.high - interval.low) / study.joint->expanded(k), 1.0, 0.1)
          << output_symbol(k);
    } else {
      EXPECT_NEAR(study.combined.standard_deviation(k) / u, 1.0, 0.06) << output_symbol(k);
    }
  }
}

TEST(NormUncertaintyTest, StatedUncertaintiesOfThePosesGiveThoseOfTheResult) {
  const RunUncertainty study = study_of(poses(20, 1e-3, true));
  EXPECT_EQ(study.estimator, "norm");
  expect_agreement(study, false);
  ASSERT_EQ(study.budget.lines.size(), 1U);
  EXPECT_TRUE(study.budget.lines.front().type_a);
}

TEST(NormUncertaintyTest, AnEstimatedScatterGivesStudentsDistribution) {
  const RunUncertainty study = study_of(poses(14, 1e-3, false));
  expect_agreement(study, true);
  EXPECT_GT(study.joint->expanded(kFirstOffset) / study.joint->standard_uncertainty(kFirstOffset), 2.5);
}

TEST(NormUncertaintyTest, EffectsOfTheItemAreDrawnFromTheirStatedSizes) {
  // Fewer poses than unknowns: they cannot determine the effects.
  RunRecord record = poses(12, 1e-5, true);
  record.tolerances.k3 = 1e-3;
  record.tolerances.k2 = 1e-3;
  const RunUncertainty study = study_of(record);
  expect_agreement(study, false);
  EXPECT_EQ(study.budget.lines.size(), 3U);
}

TEST(NormUncertaintyTest, SixPosesRestOnTheStatedAnglesBetweenTheAxes) {
  RunRecord record = poses(6, 1e-4, true);
  record.tolerances.orthogonality = Angle::degrees(0.1);
  const RunUncertainty study = study_of(record);
  expect_agreement(study, false);
  EXPECT_NEAR(study.combined.standard_deviation(kFirstIntrinsicAngle), 0.1, 0.006);
  EXPECT_EQ(study.budget.lines.front().key, "orthogonality_deg");
  EXPECT_EQ(study.budget.lines.front().unit, "degree");
}

TEST(NormUncertaintyTest, TooFewDegreesOfFreedomMakeNoTrials) {
  const RunUncertainty study = study_of(poses(10, 1e-3, false));
  EXPECT_EQ(study.combined.trials, 0U);
  EXPECT_THAT(study.no_trials, HasSubstr("the scatter of the poses has 1 degrees of freedom"));
  EXPECT_GT(study.budget.combined(kFirstOffset), 0.0);
}

TEST(NormUncertaintyTest, WhatIsNotStatedOfTheItemIsNotCovered) {
  const Budget budget = study_of(poses(20, 1e-3, true)).budget;
  std::string all;
  for (const Message& words : budget.not_covered) all += words.english() + "\n";
  EXPECT_THAT(all, HasSubstr("(k2 not given)"));
  EXPECT_THAT(all, testing::Not(HasSubstr("stage")));
}

}  // namespace
}  // namespace abcal
