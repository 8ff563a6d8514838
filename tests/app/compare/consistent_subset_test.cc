// Which of several results agree, and which one is the outlier.

#include "app/laboratory/compare/consistent_subset.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include "protocol/estimators/checks/comparison.h"

namespace abcal {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

std::vector<Eigen::VectorXd> scalars(const std::vector<double>& values) {
  std::vector<Eigen::VectorXd> list;
  for (const double value : values) list.push_back(Eigen::VectorXd::Constant(1, value));
  return list;
}

Eigen::MatrixXd variances(const std::vector<double>& u) {
  Eigen::VectorXd squares(static_cast<Eigen::Index>(u.size()));
  for (std::size_t i = 0; i < u.size(); ++i) squares(static_cast<Eigen::Index>(i)) = u[i] * u[i];
  return squares.asDiagonal();
}

/// Results of nine properties of very different sizes, correlated as those of a calibration are, with the
/// covariances between results that a common stage makes.
class Simulated {
 public:
  Simulated(std::size_t results, double shared, unsigned seed) : results_(results), engine_(seed) {
    const Eigen::Matrix<double, 9, 1> u{1e-5, 2e-5, 3e-5, 5e-3, 4e-3, 6e-3, 2e-5, 2e-5, 5e-5};
    Covariance9 correlation = Covariance9::Constant(0.5);
    correlation.diagonal().setOnes();
    own_ = u.asDiagonal() * correlation * u.asDiagonal();
    covariance_ = Eigen::MatrixXd::Zero(rows(), rows());
    for (std::size_t i = 0; i < results; ++i) {
      for (std::size_t j = 0; j < results; ++j)
        covariance_.block<9, 9>(at(i), at(j)) = i == j ? own_ : Covariance9(shared * own_);
    }
    root_ = covariance_.llt().matrixL();
  }
  /// One draw; the true values are the same for all.
  std::vector<Eigen::VectorXd> draw() {
    std::normal_distribution<double> normal;
    Eigen::VectorXd z(rows());
    for (Eigen::Index i = 0; i < rows(); ++i) z(i) = normal(engine_);
    const Eigen::VectorXd x = root_ * z;
    std::vector<Eigen::VectorXd> list;
    for (std::size_t i = 0; i < results_; ++i) list.emplace_back(x.segment(at(i), 9));
    return list;
  }
  const Eigen::MatrixXd& covariance() const { return covariance_; }
  const Covariance9& own() const { return own_; }

 private:
  Eigen::Index rows() const { return at(results_); }
  static Eigen::Index at(std::size_t i) { return 9 * static_cast<Eigen::Index>(i); }

  std::size_t results_;
  std::mt19937_64 engine_;
  Covariance9 own_;
  Eigen::MatrixXd covariance_, root_;
};

TEST(ConsistentSubset, ChiSquareOfScalarsByHand) {
  // Mean 2, residuals -1, 0, 1 in units of u = 0.5: chi2 = 8.
  const ConsistentSubset found =
      largest_consistent_subset(scalars({1.0, 2.0, 3.0}), variances({0.5, 0.5, 0.5}), 0.01);
  EXPECT_NEAR(found.all.chi2, 8.0, 1e-12);
  EXPECT_EQ(found.all.degrees_of_freedom, 2);
  EXPECT_NEAR(found.all.probability, std::exp(-4.0), 1e-14);
  EXPECT_TRUE(found.found);
  EXPECT_THAT(found.outliers, IsEmpty());
}

TEST(ConsistentSubset, TheOutlierIsNamedWhereverItStands) {
  for (std::size_t outlier = 0; outlier < 4; ++outlier) {
    std::vector<double> values{1.0, 1.1, 0.9, 1.05};
    values[outlier] = 25.0;
    const ConsistentSubset found =
        largest_consistent_subset(scalars(values), variances({0.1, 0.1, 0.1, 0.1}), 0.05);
    EXPECT_FALSE(found.agree(0.05));
    EXPECT_THAT(found.outliers, ElementsAre(outlier));
    EXPECT_EQ(found.alternatives, 0);
    EXPECT_GT(found.subset.probability, 0.05);
  }
}

TEST(ConsistentSubset, WithoutAMajorityNobodyIsTheOutlier) {
  const ConsistentSubset found =
      largest_consistent_subset(scalars({0.0, 0.1, 9.0, 9.1}), variances({0.1, 0.1, 0.1, 0.1}), 0.05);
  EXPECT_FALSE(found.found);
  EXPECT_THAT(found.outliers, IsEmpty());
}

TEST(ConsistentSubset, SaysThatAnotherChoiceWouldAgreeToo) {
  // 0 and 4 exclude one another (5.7 u of the difference); 2 lies within 2.83 u of both.
  const ConsistentSubset found =
      largest_consistent_subset(scalars({0.0, 1.9, 4.0}), variances({0.707, 0.707, 0.707}), 0.03);
  EXPECT_THAT(found.outliers, ElementsAre(2U));
  EXPECT_EQ(found.alternatives, 1);
}

// Removing results by the Schur complement is the same as testing the rest alone.
TEST(ConsistentSubset, ChiSquareOfTheSubsetIsThatOfTheRestAlone) {
  Simulated simulated(5, 0.4, 3);
  std::vector<Eigen::VectorXd> values = simulated.draw();
  values[1](0) += 1.0;  // 1e5 u
  values[3](4) -= 1.0;
  const ConsistentSubset found = largest_consistent_subset(values, simulated.covariance(), 1e-9);
  ASSERT_THAT(found.outliers, ElementsAre(1U, 3U));
  std::vector<Eigen::Index> kept;
  for (const Eigen::Index i : {0, 2, 4})
    for (Eigen::Index p = 0; p < 9; ++p) kept.push_back(9 * i + p);
  const ConsistentSubset rest =
      largest_consistent_subset({values[0], values[2], values[4]}, simulated.covariance()(kept, kept), 1e-9);
  EXPECT_NEAR(found.subset.chi2, rest.all.chi2, 1e-6 * rest.all.chi2);  // 1e5 u of the outliers cancel.
  EXPECT_EQ(found.subset.degrees_of_freedom, 18);
}

TEST(ConsistentSubset, ManyResultsAreTakenOutOneByOne) {
  std::vector<double> values(60, 1.0);
  for (std::size_t k = 0; k < 20; ++k) values[3 * k] = 100.0 + 10.0 * static_cast<double>(k);
  const ConsistentSubset found =
      largest_consistent_subset(scalars(values), variances(std::vector<double>(60, 0.1)), 0.05);
  EXPECT_FALSE(found.exhaustive);
  EXPECT_EQ(found.outliers.size(), 20U);
  EXPECT_TRUE(std::ranges::all_of(found.outliers, [](std::size_t i) { return i % 3 == 0; }));
}

TEST(ConsistentSubset, RefusesWhatCannotBeTested) {
  EXPECT_THROW(largest_consistent_subset(scalars({1.0}), variances({1.0}), 0.05), std::invalid_argument);
  EXPECT_THROW(largest_consistent_subset(scalars({1.0, 2.0}), variances({1.0, 0.0}), 0.05),
               std::invalid_argument);
  EXPECT_THROW(largest_consistent_subset(scalars({1.0, 2.0}), variances({1.0}), 0.05), std::invalid_argument);
  Eigen::MatrixXd contradictory(2, 2);
  contradictory << 1.0, 2.0, 2.0, 1.0;  // a correlation of 2
  EXPECT_FALSE(largest_consistent_subset(scalars({1.0, 2.0}), contradictory, 0.05).covariances_used);
}

/// Whether a rate over so many trials is within 4 standard deviations of an expected one.
void expect_rate(int count, int trials, double expected) {
  EXPECT_NEAR(static_cast<double>(count) / trials, expected,
              4.0 * std::sqrt(expected * (1.0 - expected) / trials));
}

// Identical pairs: the verdict is wrong as often as its level says, though 9 x 4.55 % of the E_n are above 1.
TEST(AgreementRates, APairIsCalledDifferentAsOftenAsTheLevelSays) {
  constexpr int kTrials = 4000;
  for (const double shared : {0.0, 0.6}) {
    Simulated simulated(2, shared, 11);
    int different = 0, with_one_beyond = 0;
    double beyond = 0.0;
    for (int trial = 0; trial < kTrials; ++trial) {
      const std::vector<Eigen::VectorXd> x = simulated.draw();
      const IntrinsicComparison pair = compare_intrinsic(x[0], simulated.own(), x[1], simulated.own(),
                                                         Covariance9(shared * simulated.own()));
      different += pair.agrees() ? 0 : 1;
      with_one_beyond += pair.largest_e_n > 1.0 ? 1 : 0;
      for (const PropertyDifference& p : pair.properties) beyond += std::abs(p.e_n) > 1.0 ? 1.0 : 0.0;
      EXPECT_DOUBLE_EQ(pair.expected_beyond(), 9 * kAgreementLevel);
    }
    expect_rate(different, kTrials, kAgreementLevel);
    EXPECT_NEAR(beyond / kTrials, 9 * kAgreementLevel, 0.05);  // Correlated: no binomial distribution.
    EXPECT_GT(with_one_beyond, 4 * different);                 // The rule of 1.0 had this rate.
  }
}

TEST(AgreementRates, SeveralResultsAreCalledDifferentAsOftenAsTheLevelSays) {
  constexpr int kTrials = 2000;
  Simulated simulated(4, 0.3, 12);
  int different = 0;
  for (int trial = 0; trial < kTrials; ++trial)
    different += largest_consistent_subset(simulated.draw(), simulated.covariance(), kAgreementLevel)
                         .agree(kAgreementLevel)
                     ? 0
                     : 1;
  expect_rate(different, kTrials, kAgreementLevel);
}

TEST(AgreementRates, ATrueDifferenceIsFoundAndTheOutlierNamed) {
  constexpr int kTrials = 500;
  Simulated pairs(2, 0.0, 13), four(4, 0.0, 14);
  int found = 0, named = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<Eigen::VectorXd> x = pairs.draw();
    x[1](1) += 6.0 * std::sqrt(2.0) * 2e-5;  // 6 standard uncertainties of the difference
    found += compare_intrinsic(x[0], pairs.own(), x[1], pairs.own()).agrees() ? 0 : 1;
    x = four.draw();
    x[0](1) += 10.0 * 2e-5;
    const ConsistentSubset subset = largest_consistent_subset(x, four.covariance(), kAgreementLevel);
    named += subset.outliers == std::vector<std::size_t>{0} ? 1 : 0;
  }
  EXPECT_GT(found, 0.99 * kTrials);
  EXPECT_GT(named, 0.90 * kTrials);  // With 4.55 % a further result is left out, too.
}

}  // namespace
}  // namespace abcal
