#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "app/studies/constant_rate/constant_rate_study.h"

namespace abcal {
namespace {

TEST(ConstantRateStudyTest, ReachesItsFiguresAndCovers) {
  const ConstantRateStudy study = run_constant_rate_study({.benches = 12, .seed = 7, .threads = 2});
  ASSERT_EQ(study.outcomes.size(), 2U);
  EXPECT_LE(study.outcomes[0].longest_s, 90.0);
  EXPECT_LE(study.outcomes[1].longest_s, 100.0);
  for (const ConstantRateOutcome& outcome : study.outcomes) {
    EXPECT_EQ(outcome.failed, 0) << outcome.words;
    for (const NamedErrorGroup& each : outcome.groups) {
      // 24 to 72 errors of 12 benches: the rms of z is known to some 15 %.
      EXPECT_GT(each.group.rms_z, 0.0) << outcome.words << ", " << each.name;
      EXPECT_LT(each.group.rms_z, 1.5) << outcome.words << ", " << each.name;
      // Benches whose readings wander have larger ones.
      if (each.group.limit > 0.0) {
        EXPECT_LE(each.group.rms_u, 1.2 * each.group.limit) << outcome.words << ", " << each.name;
      }
    }
  }
}

TEST(ConstantRateStudyTest, IsTheSameForAnyNumberOfThreads) {
  const auto with = [](int threads) {
    return constant_rate_json(run_constant_rate_study({.benches = 2, .seed = 3, .threads = threads})).dump();
  };
  EXPECT_EQ(with(1), with(2));
}

}  // namespace
}  // namespace abcal
