#include "protocol/uncertainty/campaign_summary.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

using testing::HasSubstr;

/// A result whose nine properties are all `value`.
CalibrationResult result_of(double value, double type_a, double type_b) {
  CalibrationResult result;
  result.estimator = "abc";
  result.verdict = Verdict::kUsable;
  result.source = "a.run";
  const Quantity quantity{value, std::hypot(type_a, type_b), type_a, type_b, "R"};
  result.intrinsic_sensitivity.fill(quantity);
  result.intrinsic_angle.fill(quantity);
  result.offset.fill(quantity);
  return result;
}

TEST(CampaignTest, TheMeanHasTheSpreadBetweenRunsAndTheCommonTypeB) {
  const std::vector<CalibrationResult> results{result_of(1.0, 1e-4, 5e-4), result_of(1.002, 1e-4, 5e-4),
                                               result_of(1.004, 1e-4, 5e-4)};
  const CampaignSummary summary = summarise_campaign(results);
  ASSERT_EQ(summary.properties.size(), 9U);
  const CampaignProperty& p = summary.properties.front();
  EXPECT_NEAR(p.spread.mean, 1.002, 1e-12);
  EXPECT_NEAR(p.spread.standard_deviation, 2e-3, 1e-12);
  EXPECT_NEAR(p.type_a, 2e-3 / std::sqrt(3.0), 1e-12);
  EXPECT_NEAR(p.type_b, 5e-4, 1e-12);
  EXPECT_NEAR(p.standard_uncertainty, std::hypot(2e-3 / std::sqrt(3.0), 5e-4), 1e-12);
  // Welch and Satterthwaite: 2 (u / u_A)^4.
  const double ratio = p.standard_uncertainty / p.type_a;
  EXPECT_NEAR(p.degrees_of_freedom, 2.0 * std::pow(ratio, 4), 1e-9);
  EXPECT_DOUBLE_EQ(p.coverage_factor, student_t_above(0.025, p.degrees_of_freedom));
  EXPECT_GT(p.coverage_factor, 3.182);  // t of 3 degrees of freedom
  EXPECT_LT(p.coverage_factor, 4.303);  // t of 2
}

TEST(CampaignTest, RunsThatAgreeByChanceAreNotBetterThanTheirReadings) {
  const std::vector<CalibrationResult> results{result_of(1.0, 1e-3, 1e-6), result_of(1.0, 1e-3, 1e-6)};
  const CampaignProperty p = summarise_campaign(results).properties.front();
  EXPECT_EQ(p.spread.between, 0.0);
  EXPECT_NEAR(p.type_a, 1e-3 / std::sqrt(2.0), 1e-12);
}

TEST(CampaignTest, TheIntervalCoversTheTruthIn95OutOf100Campaigns) {
  std::mt19937_64 engine(7);
  std::normal_distribution<double> normal;
  constexpr int kCampaigns = 4000;
  int covered = 0;
  for (int c = 0; c < kCampaigns; ++c) {
    std::vector<CalibrationResult> results;
    for (int k = 0; k < 4; ++k) {
      // Remounting scatters by 3e-3, the readings by 1e-3; the stage is wrong by the same each time.
      results.push_back(result_of(3e-3 * normal(engine) + 1e-3 * normal(engine), 1e-3, 1e-9));
    }
    const CampaignProperty p = summarise_campaign(results).properties.front();
    covered += std::abs(p.spread.mean) <= p.expanded_uncertainty() ? 1 : 0;
  }
  // Binomial standard deviation 0.34 %; type A within the runs as a floor makes it cover a little more.
  EXPECT_GT(covered, 0.94 * kCampaigns);
  EXPECT_LT(covered, 0.975 * kCampaigns);
}

TEST(CampaignTest, SaysWhyThereIsNoMean) {
  EXPECT_THAT(summarise_campaign(std::vector{result_of(1, 1, 1)}).why, HasSubstr("two or more"));
  std::vector<CalibrationResult> results{result_of(1, 1, 1), result_of(1, 1, 1)};
  results[1].verdict = Verdict::kNotUsable;
  EXPECT_THAT(summarise_campaign(results).why, HasSubstr("a.run: not usable"));
  results[1] = result_of(1, 0, 1);
  EXPECT_THAT(summarise_campaign(results).why, HasSubstr("type A"));
  EXPECT_TRUE(summarise_campaign(results).properties.empty());
}

}  // namespace
}  // namespace abcal
