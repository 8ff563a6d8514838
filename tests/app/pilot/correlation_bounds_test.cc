// Correlations of certificates that are possible and not known: the covariance that they make, and what they
// change in an outcome.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <string>
#include <vector>

#include "app/laboratory/pilot/artefact_drift.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using testing::AllOf;
using testing::HasSubstr;

/// @param scale  standard uncertainty of the first of two quantities; that of the second is twice it
ArtefactMeasurement result(std::size_t participant, double value, double scale, double correlation = 0.3) {
  const MatrixXd covariance{{scale * scale, 2.0 * correlation * scale * scale},
                            {2.0 * correlation * scale * scale, 4.0 * scale * scale}};
  return {participant, static_cast<double>(participant), VectorXd::Constant(2, value), covariance,
          VectorXd::Constant(2, 0.6)};
}

SharedSource bound(double correlation, std::vector<std::size_t> participants,
                   std::vector<Index> quantities = {0, 1}) {
  return {.name = "gravity network",
          .participants = std::move(participants),
          .u = {},
          .correlation = correlation,
          .quantities = std::move(quantities)};
}

/// Some roundings of numbers of the order of 1.
constexpr double kRounding = 1e-14;

TEST(CorrelationBounds, ResultsOfLikeCorrelationsHaveTheBoundInAllQuantities) {
  const std::vector<ArtefactMeasurement> results{result(0, 0, 1.0), result(1, 0, 2.0), result(2, 0, 1.0)};
  const MatrixXd covariance = measurements_covariance(results, {bound(0.5, {0, 1})});
  // The cross-covariance is that of the quantities of one participant, times the bound and the ratio of u.
  EXPECT_LT((covariance.block(0, 2, 2, 2) - 0.5 * 2.0 * results[0].covariance).norm(), kRounding);
  EXPECT_LT((covariance.block(2, 0, 2, 2) - 0.5 * 2.0 * results[0].covariance).norm(), kRounding);
  EXPECT_EQ(covariance.block(0, 4, 4, 2).norm(), 0.0) << "the third is not concerned";
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_LT(
        (covariance.block(2 * static_cast<Index>(i), 2 * static_cast<Index>(i), 2, 2) - results[i].covariance)
            .norm(),
        kRounding);
}

TEST(CorrelationBounds, OthersHaveAtMostTheBoundAndQuantitiesCanBeLeftOut) {
  const std::vector<ArtefactMeasurement> unlike{result(0, 0, 1.0, 0.9), result(1, 0, 1.0, -0.9)};
  const MatrixXd covariance = measurements_covariance(unlike, {bound(0.5, {0, 1})});
  // The root of a 2 x 2 correlation matrix r has the diagonal (sqrt(1 + r) + sqrt(1 - r)) / 2 and, off it,
  // half the difference; the product for r and -r is the identity times sqrt(1 - r^2).
  EXPECT_NEAR(covariance(0, 2), 0.5 * std::sqrt(1.0 - 0.81), kRounding);
  EXPECT_NEAR(covariance(0, 3), 0.0, kRounding);
  const MatrixXd first =
      measurements_covariance({result(0, 0, 1.0), result(1, 0, 1.0)}, {bound(-0.5, {0, 1}, {0})});
  EXPECT_NEAR(first(0, 2), -0.5, kRounding);
  EXPECT_EQ(first(1, 3), 0.0);
}

TEST(CorrelationBounds, RepeatsAreCorrelatedByTheirCommonPart) {
  const std::vector<ArtefactMeasurement> results{result(0, 0, 1.0), result(1, 0, 1.0), result(0, 0, 1.0)};
  const MatrixXd covariance = measurements_covariance(results, {bound(0.5, {0, 1})});
  // The repeatability 0.6 leaves the common part 0.8 of u = 1.
  EXPECT_NEAR(covariance(0, 2), 0.5 * 0.8, kRounding);
  EXPECT_NEAR(covariance(4, 2), 0.5 * 0.8, kRounding);
}

TEST(CorrelationBounds, ImpossibleCorrelationIsNamed) {
  const auto refusal = [](const std::vector<SharedSource>& sources) {
    try {
      measurements_covariance({result(0, 0, 1.0), result(1, 0, 1.0), result(2, 0, 1.0)}, sources);
    } catch (const KeyComparisonError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_EQ(refusal({bound(-0.49, {0, 1, 2})}), "accepted");
  // Three results cannot all be correlated by less than -1/2; the smallest eigenvalue is 1 - 2 * 0.6, times
  // that of the two quantities, which lies between 1 - 0.3 and 1 + 0.3.
  EXPECT_THAT(refusal({bound(-0.6, {0, 1, 2})}),
              AllOf(HasSubstr("correlation -0.6 by gravity network"), HasSubstr("not positive definite"),
                    HasSubstr("-0.26"), HasSubstr("required: a smaller correlation")));
  EXPECT_THAT(refusal({bound(1.0, {0, 1})}), HasSubstr("not positive definite"));
  // Together with a stated part.
  const SharedSource stated{.name = "polygon", .participants = {0, 1}, .u = VectorXd{{0.9, 1.8}}};
  EXPECT_EQ(refusal({stated}), "accepted");
  EXPECT_EQ(refusal({bound(0.5, {0, 1})}), "accepted");
  EXPECT_THAT(refusal({stated, bound(0.5, {0, 1})}), HasSubstr("correlation 0.5 by gravity network"));
}

TEST(CorrelationBounds, OutcomeIsThatOfTheFormulaOfTwoCorrelatedResults) {
  // Three results of u = 1; the first two have the correlation r. The generalised mean has the weights
  // 1 : 1 : 1 + r, and 1/u^2 = 1 + 2 / (1 + r).
  constexpr double kR = 0.6;
  const std::vector<ArtefactMeasurement> results{result(0, 1.0, 1.0, 0.0), result(1, 2.0, 1.0, 0.0),
                                                 result(2, 6.0, 1.0, 0.0)};
  const TransferredResults transferred =
      transferred_results(results, {bound(kR, {0, 1})}, {2.0, 2.0, 2.0}, 0, DriftModel::kNone, 0.01);
  const ReferenceValue reference =
      reference_value(transferred.results, {.procedure = ReferenceProcedure::kMean});
  EXPECT_NEAR(reference.values(0), (1.0 + 2.0 + (1.0 + kR) * 6.0) / (3.0 + kR), 1e-13);
  EXPECT_NEAR(reference.covariance(0, 0), 1.0 / (1.0 + 2.0 / (1.0 + kR)), 1e-13);
  const PairEquivalence pair = pair_equivalence(transferred.results, 0, 1);
  EXPECT_NEAR(pair.covariance(0, 0), 2.0 * (1.0 - kR), 1e-13);
  EXPECT_NEAR(pair.expanded(0), 2.0 * std::sqrt(2.0 * (1.0 - kR)), 1e-13);
}

}  // namespace
}  // namespace abcal
