#include "app/results/analysis/estimators.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

#include "app/results/analysis/analyses.h"
#include "protocol/estimators/shared/unusable_data.h"

namespace abcal {
namespace {

using testing::HasSubstr;

TEST(EstimatorsTest, EachEntryIsFoundByItsName) {
  EXPECT_EQ(estimator_choice(), "abc, joint or norm");
  for (const Estimator& estimator : estimators()) EXPECT_EQ(&find_estimator(estimator.name), &estimator);
  EXPECT_THROW(find_estimator("best"), std::invalid_argument);
  EXPECT_TRUE(find_estimator(kDefaultEstimator).certifiable);
  const std::vector<std::string> named(kEstimatorNames.begin(), kEstimatorNames.end());
  EXPECT_EQ(estimator_names(), named);
  EXPECT_FALSE(find_estimator("norm").certifiable);
}

TEST(EstimatorsTest, AResultIsFoundByNameWhereverItStands) {
  std::vector<CalibrationResult> results(2);
  results[0].estimator = "joint";
  results[1].estimator = "abc";
  EXPECT_EQ(&result_of(results, "abc"), &results[1]);
  EXPECT_EQ(&result_of(results, "joint"), &results[0]);
  EXPECT_THROW(result_of(results, "norm"), std::logic_error);
}

// A record that an estimator refuses is not usable; a fault of the program is no verdict on a record.
TEST(EstimatorsTest, ARefusalIsAVerdictAndAnyOtherExceptionIsNot) {
  const Estimator refuses{.name = "refuses", .words = "", .fit = [](const RunRecord&) -> CalibrationResult {
                            throw UnusableData("two angles determine nothing");
                          }};
  const CalibrationResult result = analyse(RunRecord{}, refuses);
  EXPECT_EQ(result.verdict, Verdict::kNotUsable);
  EXPECT_EQ(result.estimator, "refuses");
  EXPECT_THAT(result.why, HasSubstr("two angles"));
  const Estimator broken{.name = "broken", .words = "", .fit = [](const RunRecord&) -> CalibrationResult {
                           return std::vector<CalibrationResult>().at(0);
                         }};
  EXPECT_THROW(analyse(RunRecord{}, broken), std::out_of_range);
  const Estimator mistaken{.name = "mistaken", .words = "", .fit = [](const RunRecord&) -> CalibrationResult {
                             throw std::invalid_argument("a size of a vector is wrong");
                           }};
  EXPECT_THROW(analyse(RunRecord{}, mistaken), std::invalid_argument);
}

TEST(EstimatorsTest, TheDeclaredEstimatorIsFirstAndThePublishedOneWhereNoneWasDeclared) {
  RunRecord record;
  record.dwells.emplace_back().experiment = 1;  // Without angles only the norm is left.
  EXPECT_EQ(declared_estimator(record).name, "abc");
  EXPECT_EQ(analyse_all(record).front().estimator, "abc");
  record.estimator = "joint";
  EXPECT_EQ(declared_estimator(record).name, "joint");
  const std::vector<CalibrationResult> results = analyse_all(record);
  ASSERT_EQ(results.size(), 3U);
  EXPECT_EQ(results[0].estimator, "joint");
  EXPECT_EQ(results[1].estimator, "abc");
  EXPECT_EQ(results[2].estimator, "norm");
  record.estimator = "best";
  EXPECT_THROW(declared_estimator(record), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
