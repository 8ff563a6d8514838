// Reference value, degrees of equivalence and linking of a comparison, against published and independent
// numbers.

#include "app/laboratory/pilot/key_comparison.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "app/laboratory/compare/random_effects.h"
#include "tests/app/pilot/published_comparison.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using test::kVibration;
using test::published_comparison;
using test::published_u_ref;
using test::univariate_results;
using testing::ElementsAre;
using testing::IsEmpty;

/// Results of several correlated quantities of different sizes, drawn.
ParticipantResults drawn(Index n, Index p, std::uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal;
  const auto matrix = [&](Index rows, Index columns) {
    return MatrixXd(MatrixXd::NullaryExpr(rows, columns, [&] { return normal(engine); }));
  };
  ParticipantResults results{.quantities = p,
                             .values = VectorXd(n * p),
                             .covariance = MatrixXd::Zero(n * p, n * p),
                             .coverage_factors = std::vector<double>(static_cast<std::size_t>(n), 2.0)};
  VectorXd unit(p);
  for (Index q = 0; q < p; ++q) unit(q) = std::pow(10.0, -static_cast<double>(q % 4));
  // A part that all share, and an own part of each.
  const MatrixXd root = matrix(n * p, n * p) / std::sqrt(static_cast<double>(n * p));
  const MatrixXd own = root * root.transpose() + 0.3 * MatrixXd::Identity(n * p, n * p);
  const VectorXd all = unit.replicate(n, 1);
  results.covariance = all.asDiagonal() * own * all.asDiagonal();
  const VectorXd truth = matrix(p, 1) * 10.0;
  results.values =
      truth.replicate(n, 1) + MatrixXd(Eigen::LLT<MatrixXd>(results.covariance).matrixL()) * matrix(n * p, 1);
  return results;
}

constexpr double kHalfOfLastDigit = 0.05;

TEST(KeyComparison, PublishedVibrationComparisonByProcedureA) {
  const ParticipantResults results = published_comparison();
  // The institutes stated 0.1 % (PTB), 0.3 % (NIST, NRC), 0.5 % (BNM-CESTA) of 0.13 pC/(m/s2).
  EXPECT_NEAR(2.0 * std::sqrt(results.covariance(0, 0)), 1.3, 0.1);
  EXPECT_NEAR(2.0 * std::sqrt(results.covariance(10, 10)), 3.9, 0.1);
  const ReferenceValue reference = reference_value(results, {});
  EXPECT_EQ(reference.procedure, ReferenceProcedure::kMean) << "the institutes agree";
  // The published differences are from the weighted mean, so that theirs is 0 to the printed digit.
  EXPECT_NEAR(reference.values(0), 0.0, kHalfOfLastDigit);
  EXPECT_NEAR(std::sqrt(reference.covariance(0, 0)), published_u_ref(), 1e-9);
  for (std::size_t i = 0; i < std::size(kVibration); ++i) {
    const auto at = static_cast<Index>(i);
    EXPECT_NEAR(reference.differences(at), kVibration[i].difference, kHalfOfLastDigit)
        << kVibration[i].institute;
    EXPECT_NEAR(reference.expanded(at), kVibration[i].expanded, kHalfOfLastDigit) << kVibration[i].institute;
  }
  const ComparisonConsistency consistency = consistency_of_participants(results);
  EXPECT_NEAR(consistency.joint.chi2, 11.3, 0.05);
  EXPECT_EQ(consistency.joint.degrees_of_freedom, 11);
  EXPECT_NEAR(consistency.birge(0), std::sqrt(11.27 / 11.0), 1e-3);
  // One claim is beyond its U, as published.
  int beyond = 0;
  for (const ClaimTest& claim : test_claims(results, reference)) beyond += claim.beyond;
  EXPECT_EQ(beyond, 1);
  EXPECT_THAT(faulty_participants(results, 0.01), IsEmpty());
}

TEST(KeyComparison, PublishedVibrationComparisonBySubsetAndMedian) {
  ParticipantResults results = published_comparison();
  const ReferenceValue subset = reference_value(results, {.procedure = ReferenceProcedure::kSubset});
  EXPECT_EQ(subset.contributes.sum(), 12) << "all agree: the subset is all";
  EXPECT_NEAR(subset.values(0), 0.0, kHalfOfLastDigit);
  const ReferenceValue median = reference_value(results, {.procedure = ReferenceProcedure::kMedian});
  EXPECT_GT(std::sqrt(median.covariance(0, 0)), std::sqrt(subset.covariance(0, 0)));
  results.values(0) += 10.0;  // the institute with the smallest uncertainty is off
  const ReferenceValue without = reference_value(results, {.procedure = ReferenceProcedure::kSubset});
  EXPECT_EQ(without.contributes(0, 0), 0);
  EXPECT_EQ(without.contributes.sum(), 11);
  EXPECT_THAT(faulty_participants(results, 0.01),
              ElementsAre(testing::Field(&FaultyParticipant::participant, 0)));
  EXPECT_EQ(reference_value(results, {}).procedure, ReferenceProcedure::kMedian) << "A is not valid: B";
}

TEST(KeyComparison, MedianOfEqualNormalsHasTheVarianceOfTheBooks) {
  // Variances of the median of 3 and 5 standard normal values (D. Teichroew, Ann. Math. Stat. 27, 410, 1956).
  for (const auto& [n, variance] : {std::pair(3, 0.4486711), std::pair(5, 0.2868336)}) {
    const std::vector<double> zeros(static_cast<std::size_t>(n), 0.0), ones(zeros.size(), 1.0);
    const ReferenceValue reference = reference_value(
        univariate_results(zeros, ones), {.procedure = ReferenceProcedure::kMedian, .draws = 400'000});
    EXPECT_NEAR(reference.values(0), 0.0, 0.005);
    EXPECT_NEAR(reference.covariance(0, 0), variance, 0.004) << n;
    EXPECT_GT(reference.expanded(0), 1.5);
  }
}

TEST(KeyComparison, MeanOfManyQuantitiesAgreesWithConditioningOnContrasts) {
  const Index n = 5, p = 9;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const ParticipantResults results = drawn(n, p, seed);
    // Independently: the first result, corrected by what the contrasts between results tell of its error.
    MatrixXd contrasts = MatrixXd::Zero((n - 1) * p, n * p);
    for (Index i = 1; i < n; ++i) {
      contrasts.block((i - 1) * p, 0, p, p) = -MatrixXd::Identity(p, p);
      contrasts.block((i - 1) * p, i * p, p, p).setIdentity();
    }
    const VectorXd d = contrasts * results.values;
    const Eigen::ColPivHouseholderQR<MatrixXd> of_contrasts(contrasts * results.covariance *
                                                            contrasts.transpose());
    const MatrixXd cross = results.covariance.topRows(p) * contrasts.transpose();
    const VectorXd mean = results.values.head(p) - cross * of_contrasts.solve(d);
    const MatrixXd covariance =
        results.covariance.topLeftCorner(p, p) - cross * of_contrasts.solve(cross.transpose());
    const double chi2 = d.dot(of_contrasts.solve(d));

    const ReferenceValue reference = reference_value(results, {.procedure = ReferenceProcedure::kMean});
    const VectorXd u = covariance.diagonal().cwiseSqrt();
    EXPECT_LT((reference.values - mean).cwiseQuotient(u).cwiseAbs().maxCoeff(), 1e-8);
    EXPECT_LT(((reference.covariance - covariance).array() / (u * u.transpose()).array()).abs().maxCoeff(),
              1e-8);
    EXPECT_NEAR(consistency_of_participants(results).joint.chi2 / chi2, 1.0, 1e-8);
    // A best estimate and its differences are uncorrelated: u(D)^2 = u_i^2 - u_ref^2, and more generally.
    for (Index i = 0; i < n; ++i) {
      const MatrixXd expected = results.covariance.block(i * p, i * p, p, p) - covariance;
      const MatrixXd found = reference.difference_covariance.block(i * p, i * p, p, p);
      EXPECT_LT(((found - expected).array() / (u * u.transpose()).array()).abs().maxCoeff(), 1e-6);
    }
  }
}

TEST(KeyComparison, CovarianceOfDifferencesIsThatOfDraws) {
  const Index n = 4, p = 2;
  const ParticipantResults results = drawn(n, p, 7);
  const ReferenceOptions options{.procedure = ReferenceProcedure::kMean};
  const ReferenceValue reference = reference_value(results, options);
  const MatrixXd root = Eigen::LLT<MatrixXd>(results.covariance).matrixL();
  std::mt19937_64 engine(11);
  std::normal_distribution<double> normal;
  MatrixXd sum = MatrixXd::Zero(n * p, n * p);
  constexpr int kDraws = 5000;
  for (int k = 0; k < kDraws; ++k) {
    ParticipantResults draw = results;
    draw.values = root * VectorXd::NullaryExpr(n * p, [&] { return normal(engine); });
    const VectorXd d = reference_value(draw, options).differences;
    sum += d * d.transpose();
  }
  const VectorXd u = reference.difference_covariance.diagonal().cwiseSqrt();
  EXPECT_LT(((sum / kDraws - reference.difference_covariance).array() / (u * u.transpose()).array())
                .abs()
                .maxCoeff(),
            0.08);
}

TEST(KeyComparison, OneQuantityIsLeftOutWhereItAloneDisagrees) {
  ParticipantResults results = drawn(6, 3, 3);
  const double u = std::sqrt(results.covariance(3 * 3 + 1, 3 * 3 + 1));
  results.values(3 * 3 + 1) += 12.0 * u;
  const ReferenceValue whole = reference_value(results, {.procedure = ReferenceProcedure::kSubset});
  EXPECT_EQ(whole.contributes.row(3).sum(), 0);
  const ReferenceValue single =
      reference_value(results, {.procedure = ReferenceProcedure::kSubsetPerQuantity});
  EXPECT_THAT(std::vector<int>(single.contributes.row(3).begin(), single.contributes.row(3).end()),
              ElementsAre(1, 0, 1));
  EXPECT_GT(single.differences(3 * 3 + 1) / single.expanded(3 * 3 + 1), 3.0);
}

TEST(KeyComparison, RandomEffectsAgreeWithTheUnivariateMean) {
  const std::vector<double> values{1.0, 1.9, 0.2, 1.4, 2.5}, u{0.2, 0.3, 0.2, 0.5, 0.3};
  const ParticipantResults results = univariate_results(values, u);
  const ReferenceValue reference =
      reference_value(results, {.procedure = ReferenceProcedure::kRandomEffects});
  const RandomEffectsMean independent = random_effects_mean(values, results.covariance);
  EXPECT_NEAR(reference.values(0), independent.mean, 1e-6);
  EXPECT_NEAR(std::sqrt(reference.covariance(0, 0)), independent.standard_uncertainty, 1e-6);
  EXPECT_NEAR(reference.between(0), independent.between, 1e-6);
}

TEST(KeyComparison, RandomEffectsOfOneKindHaveOneSize) {
  // Effects of size 3 in two quantities and none in the third.
  std::mt19937_64 engine(5);
  std::normal_distribution<double> normal;
  const Index n = 40;
  ParticipantResults results{.quantities = 3,
                             .values = VectorXd(n * 3),
                             .covariance = MatrixXd::Identity(n * 3, n * 3),
                             .coverage_factors = std::vector<double>(40, 2.0)};
  for (Index i = 0; i < n * 3; ++i)
    results.values(i) = normal(engine) + (i % 3 < 2 ? 3.0 * normal(engine) : 0.0);
  const ReferenceValue reference =
      reference_value(results, {.procedure = ReferenceProcedure::kRandomEffects, .groups = {{0, 1}, {2}}});
  EXPECT_EQ(reference.between(0), reference.between(1));
  EXPECT_NEAR(reference.between(0), 3.0, 0.6);
  EXPECT_LT(reference.between(2), 0.7);
}

TEST(KeyComparison, PairsAndScores) {
  ParticipantResults results = univariate_results({1.0, 1.5}, {0.1, 0.2});
  results.coverage_factors = {2.0, 2.5};
  results.covariance(0, 1) = results.covariance(1, 0) = 0.01;
  const PairEquivalence pair = pair_equivalence(results, 0, 1);
  EXPECT_DOUBLE_EQ(pair.difference(0), -0.5);
  EXPECT_NEAR(pair.expanded(0), 2.5 * std::sqrt(0.01 + 0.04 - 0.02), 1e-12);
  const Scores scores = scores_of(-0.5, 0.2, 0.4, 0.25);
  EXPECT_DOUBLE_EQ(scores.e_n, -1.25);
  EXPECT_DOUBLE_EQ(scores.zeta, -2.5);
  EXPECT_DOUBLE_EQ(*scores.z, -2.0);
  EXPECT_FALSE(scores_of(1.0, 1.0, 2.0, std::nullopt).z);
}

TEST(KeyComparison, LinkMovesAllByTheLinkingParticipants) {
  const ParticipantResults results = univariate_results({1.0, 2.0, 3.0}, {0.1, 0.1, 0.1});
  const ReferenceValue reference = reference_value(results, {.procedure = ReferenceProcedure::kMean});
  // One participant whose earlier difference is exact: its linked one is that.
  const LinkedDifferences one =
      linked_differences(results, reference, {{0, VectorXd::Constant(1, 0.25), VectorXd::Constant(1, 1e-9)}});
  EXPECT_NEAR(one.differences(0), 0.25, 1e-9);
  EXPECT_NEAR(one.covariance(0, 0), 1e-18, 1e-15);
  EXPECT_NEAR(one.differences(2), 2.25, 1e-9);
  EXPECT_NEAR(one.covariance(2, 2), 0.02, 1e-9) << "x3 - x1";
  // Two of equal weight: the mean of their excesses, +1.5 and -0.5.
  const LinkedDifferences two =
      linked_differences(results, reference,
                         {{0, VectorXd::Constant(1, 0.5), VectorXd::Constant(1, 0.1)},
                          {2, VectorXd::Constant(1, 0.5), VectorXd::Constant(1, 0.1)}});
  EXPECT_NEAR(two.shift(0), 0.5, 1e-9);
  EXPECT_THROW(linked_differences(results, reference, {}), KeyComparisonError);
}

TEST(KeyComparison, RefusesWhatGivesNoReferenceValue) {
  EXPECT_THROW(reference_value(univariate_results({1.0}, {0.1}), {}), KeyComparisonError);
  EXPECT_THROW(reference_value(univariate_results({1.0, 2.0}, {0.1, 0.0}), {}), KeyComparisonError);
  ParticipantResults impossible = univariate_results({1.0, 2.0, 3.0}, {0.1, 0.1, 0.1});
  impossible.covariance(0, 1) = impossible.covariance(1, 0) = 0.02;
  EXPECT_THROW(reference_value(impossible, {}), std::invalid_argument);
  // No majority agrees.
  EXPECT_THROW(reference_value(univariate_results({0.0, 5.0, 10.0, 15.0}, {0.1, 0.1, 0.1, 0.1}),
                               {.procedure = ReferenceProcedure::kSubset}),
               KeyComparisonError);
}

}  // namespace
}  // namespace abcal
