// Comparisons whose truth is drawn: six institutes, an artefact that drifts, a faulty stage.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <boost/math/distributions/non_central_chi_squared.hpp>
#include <cmath>
#include <random>
#include <string>

#include "app/laboratory/pilot/artefact_drift.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr Index kQuantities = 9;
constexpr std::size_t kInstitutes = 6;
/// Who has the artefact at each transfer; institute 0 is the pilot.
constexpr std::array<std::size_t, 9> kSchedule{0, 1, 2, 0, 3, 4, 0, 5, 0};

/// One comparison with its truth.
class Round {
 public:
  explicit Round(std::uint64_t seed) : engine_(seed) {
    const VectorXd unit = units();
    for (Index q = 0; q < kQuantities; ++q) {
      truth_.conservativeResize(q + 1);
      truth_(q) = (q < 3 ? 1.0 : q < 6 ? 90.0 : 0.0) + 1e4 * unit(q) * normal();
    }
    rate_ = 1.5 * unit.cwiseProduct(normals());
    shared_u_ = 0.5 * unit;
    std::array<VectorXd, kInstitutes> common;
    std::array<MatrixXd, kInstitutes> own;
    for (std::size_t i = 0; i < kInstitutes; ++i) {
      own[i] = drawn_covariance();
      common[i] = VectorXd::Zero(kQuantities);
    }
    // Institutes 1 and 2 calibrated their stages with one polygon.
    const VectorXd of_source = shared_u_.cwiseProduct(normals());
    common[1] = common[2] = of_source;
    // Stated covariances hold the shared part; the pilot's repeats have their own scatter.
    repeatability_ = 0.3 * unit;
    const VectorXd pilots = correlated(reduced(own[0], repeatability_));
    for (std::size_t k = 0; k < kSchedule.size(); ++k) {
      const std::size_t i = kSchedule[k];
      ArtefactMeasurement& one = measurements_.emplace_back();
      one.participant = i;
      one.time = static_cast<double>(k);
      one.covariance = own[i];
      one.values = truth_ + one.time * rate_;
      if (i == 0) {
        one.repeatability = repeatability_;
        const VectorXd part = repeatability_.cwiseQuotient(own[0].diagonal().cwiseSqrt());
        one.values += pilots + correlated(part.asDiagonal() * own[0] * part.asDiagonal());
      } else {
        one.values += correlated(own[i]) + common[i];
      }
      if (i == 1 || i == 2) one.covariance.diagonal() += shared_u_.cwiseAbs2();
    }
  }

  /// Breaks the stage of one institute: its results are off in a drawn direction by 12 to 20 of its own
  /// uncertainties, all quantities together.
  std::size_t break_a_stage() {
    const auto faulty = static_cast<std::size_t>(uniform(0.0, static_cast<double>(kInstitutes)));
    const double size = uniform(12.0, 20.0);
    const VectorXd direction = normals().normalized();
    for (ArtefactMeasurement& one : measurements_)
      if (one.participant == faulty)
        one.values += size * (MatrixXd(Eigen::LLT<MatrixXd>(one.covariance).matrixL()) * direction);
    return faulty;
  }

  /// A fault of one institute: its result is off by so many of its standard uncertainties, in one quantity or
  /// in all, with drawn signs.
  std::size_t break_by(double size, bool in_all) {
    const auto faulty = static_cast<std::size_t>(uniform(0.0, static_cast<double>(kInstitutes)));
    const auto single = static_cast<Index>(uniform(0.0, static_cast<double>(kQuantities)));
    fault_ = VectorXd::Zero(kQuantities);
    for (const ArtefactMeasurement& one : measurements_)
      if (one.participant == faulty) fault_ = size * one.covariance.diagonal().cwiseSqrt();
    for (Index q = 0; q < kQuantities; ++q) {
      if (uniform(0.0, 1.0) < 0.5) fault_(q) = -fault_(q);
      if (!in_all && q != single) fault_(q) = 0.0;
    }
    for (ArtefactMeasurement& one : measurements_)
      if (one.participant == faulty) one.values += fault_;
    return faulty;
  }
  const VectorXd& fault() const { return fault_; }

  /// Drops the artefact after a transfer: it is off from then on, in one quantity.
  void drop_after(std::size_t transfer, Index quantity, double change) {
    for (std::size_t k = transfer + 1; k < measurements_.size(); ++k)
      measurements_[k].values(quantity) += change;
  }

  TransferredResults transferred(DriftModel model = DriftModel::kLine) const {
    return transferred_results(measurements_, {{"polygon", {1, 2}, shared_u_, false}},
                               std::vector<double>(kInstitutes, 2.0), 0, model, 0.01);
  }
  VectorXd truth_at(double time) const { return truth_ + time * rate_; }
  const VectorXd& rate() const { return rate_; }
  static VectorXd units() { return VectorXd{{2e-5, 2e-5, 2e-5, 2e-3, 2e-3, 2e-3, 3e-5, 3e-5, 3e-5}}; }

 private:
  double normal() { return std::normal_distribution<double>()(engine_); }
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }
  VectorXd normals() {
    return VectorXd::NullaryExpr(kQuantities, [this] { return normal(); });
  }
  VectorXd correlated(const MatrixXd& covariance) {
    return MatrixXd(Eigen::LLT<MatrixXd>(covariance).matrixL()) * normals();
  }
  MatrixXd drawn_covariance() {
    const MatrixXd root = MatrixXd::NullaryExpr(kQuantities, 2 * kQuantities, [this] { return normal(); });
    const VectorXd u = uniform(0.7, 2.0) * units();
    return u.asDiagonal() * (root * root.transpose() / (2.0 * kQuantities)) * u.asDiagonal();
  }
  /// The common part of a covariance whose repeats scatter by `repeatability`.
  static MatrixXd reduced(const MatrixXd& covariance, const VectorXd& repeatability) {
    const VectorXd u = covariance.diagonal().cwiseSqrt();
    const VectorXd factor =
        (VectorXd::Ones(kQuantities) - repeatability.cwiseQuotient(u).cwiseAbs2()).cwiseSqrt();
    return factor.asDiagonal() * covariance * factor.asDiagonal();
  }

  std::mt19937_64 engine_;
  VectorXd truth_, rate_, shared_u_, repeatability_, fault_;
  std::vector<ArtefactMeasurement> measurements_;
};

/// How often the truth was inside what was stated.
struct Coverage95 {
  int rounds = 0, joint = 0, named = 0, wrongly_named = 0, steps = 0;
  int refused = 0;  ///< No majority agreed: no reference value, and it is said.
  std::array<int, kQuantities> of_quantity{};
  int pairs = 0, pairs_inside = 0, rates = 0;
};

Coverage95 compare_rounds(int rounds, bool with_fault, ReferenceProcedure procedure) {
  Coverage95 found;
  const double limit = chi2_quantile(0.95, static_cast<double>(kQuantities)), k = normal_quantile(0.975);
  for (int r = 0; r < rounds; ++r) {
    Round round(static_cast<std::uint64_t>(1000 + r));
    const std::size_t faulty = with_fault ? round.break_a_stage() : kInstitutes;
    const TransferredResults transferred = round.transferred();
    ReferenceValue reference;
    try {
      reference = reference_value(transferred.results, {.procedure = procedure});
    } catch (const KeyComparisonError&) {
      ++found.refused;
      continue;
    }
    ++found.rounds;
    if (transferred.step) ++found.steps;
    const VectorXd error = reference.values - round.truth_at(transferred.reference_time);
    const VectorXd unit = Round::units().cwiseInverse();
    const MatrixXd scaled = unit.asDiagonal() * reference.covariance * unit.asDiagonal();
    const VectorXd scaled_error = unit.cwiseProduct(error);
    if (scaled_error.dot(Eigen::LDLT<MatrixXd>(scaled).solve(scaled_error)) <= limit) ++found.joint;
    for (Index q = 0; q < kQuantities; ++q)
      if (std::abs(error(q)) <= k * std::sqrt(reference.covariance(q, q)))
        ++found.of_quantity[static_cast<std::size_t>(q)];
    for (const FaultyParticipant& one : faulty_participants(transferred.results, 0.01))
      ++(one.participant == faulty ? found.named : found.wrongly_named);
    const VectorXd rate_error = transferred.rate - round.rate();
    if (std::abs(rate_error(0)) <= k * std::sqrt(transferred.rate_covariance(0, 0))) ++found.rates;
    // Two good institutes: their difference is truly 0.
    const Index a = faulty == 1 || faulty == 4 ? 3 : 1, b = faulty == 5 || a == 3 ? 2 : 4;
    const PairEquivalence pair = pair_equivalence(transferred.results, a, b);
    for (Index q = 0; q < kQuantities; ++q) {
      ++found.pairs;
      if (std::abs(pair.difference(q)) <= k * std::sqrt(pair.covariance(q, q))) ++found.pairs_inside;
    }
  }
  return found;
}

/// Four standard deviations of a fraction of 95 %.
double tolerance(int count) {
  return 4.0 * std::sqrt(0.95 * 0.05 / count);
}

void expect_covers(const Coverage95& found, double lower_by) {
  const auto part = [&](int count) { return static_cast<double>(count) / found.rounds; };
  EXPECT_NEAR(part(found.joint), 0.95, tolerance(found.rounds) + lower_by);
  for (const int inside : found.of_quantity)
    EXPECT_NEAR(part(inside), 0.95, tolerance(found.rounds) + lower_by);
  EXPECT_NEAR(part(found.rates), 0.95, tolerance(found.rounds));
  EXPECT_NEAR(static_cast<double>(found.pairs_inside) / found.pairs, 0.95, 2.0 * tolerance(found.pairs));
  EXPECT_LE(found.refused, found.rounds / 200);
  testing::Test::RecordProperty("joint", found.joint);
  testing::Test::RecordProperty("refused", found.refused);
  testing::Test::RecordProperty("least_quantity", *std::ranges::min_element(found.of_quantity));
  testing::Test::RecordProperty("most_quantity", *std::ranges::max_element(found.of_quantity));
  testing::Test::RecordProperty("named", found.named);
  testing::Test::RecordProperty("wrongly_named", found.wrongly_named);
}

TEST(ComparisonRounds, ReferenceCoversTheDriftingArtefact) {
  const Coverage95 good = compare_rounds(1000, false, ReferenceProcedure::kMean);
  expect_covers(good, 0.0);
  EXPECT_LE(good.wrongly_named, 20);
  EXPECT_LE(good.steps, 25);
}

TEST(ComparisonRounds, FaultyStageIsNamedAndTheReferenceHolds) {
  const Coverage95 faulty = compare_rounds(1000, true, ReferenceProcedure::kSubset);
  expect_covers(faulty, 0.01);
  EXPECT_GE(faulty.named, 950);
  EXPECT_LE(faulty.wrongly_named, 20);
}

/// How often a fault is named, and how often the theory of the two tests says.
struct Naming {
  int rounds = 0, named = 0, with_quantity = 0, wrong = 0;
  double by_chi2 = 0.0;      ///< Expected number that the test of all quantities names.
  double by_quantity = 0.0;  ///< Expected number that the test of the faulty quantity names.
  /// Expected number of the best test there is, which knows the quantity and the sign of the fault and only
  /// not the institute.
  double at_best = 0.0;
};

Naming name_faults(double size, bool in_all) {
  constexpr double kLevel = 0.01, kOfEach = 0.5 * kLevel / kInstitutes;
  const double limit = chi2_above(kOfEach, kQuantities);
  const double deviate = normal_quantile(1.0 - 0.5 * kOfEach / kQuantities);
  Naming found{.rounds = 1000};
  for (int r = 0; r < found.rounds; ++r) {
    Round round(static_cast<std::uint64_t>(50'000 + r));
    const std::size_t faulty = round.break_by(size, in_all);
    const ParticipantResults results = round.transferred().results;
    for (const FaultyParticipant& one : faulty_participants(results, kLevel)) {
      ++(one.participant == faulty ? found.named : found.wrong);
      if (one.participant == faulty && one.quantity && round.fault()(*one.quantity) != 0.0)
        ++found.with_quantity;
    }
    // The noncentrality is chi2 of the fault alone, without any other error.
    ParticipantResults fault_alone = results;
    fault_alone.values.setZero();
    fault_alone.values.segment(static_cast<Index>(faulty) * kQuantities, kQuantities) = round.fault();
    const double noncentrality = consistency_of_participants(fault_alone).joint.chi2;
    found.by_chi2 += boost::math::cdf(boost::math::complement(
        boost::math::non_central_chi_squared(static_cast<double>(kQuantities), noncentrality), limit));
    found.by_quantity += normal_tail(deviate - std::sqrt(noncentrality));
    found.at_best += normal_tail(normal_quantile(1.0 - kLevel / kInstitutes) - std::sqrt(noncentrality));
  }
  const std::string of = " at " + std::to_string(static_cast<int>(size)) + " u";
  const auto record = [&](const std::string& what, double number) {
    testing::Test::RecordProperty(what + of, static_cast<int>(std::lround(number)));
  };
  record("named", found.named);
  record("named with its quantity", found.with_quantity);
  record("named wrongly", found.wrong);
  record("expected by chi2", found.by_chi2);
  record("expected by the quantity", found.by_quantity);
  record("expected at best", found.at_best);
  return found;
}

/// At most 1 % of rounds accuse a good institute: three standard deviations of that count.
void expect_few_accusations(const Naming& found) {
  const double expected = 0.01 * found.rounds;
  EXPECT_LE(found.wrong, expected + 3.0 * std::sqrt(0.99 * expected));
}

TEST(ComparisonRounds, FaultOfThreeUncertaintiesInAllQuantitiesIsNamed) {
  const Naming found = name_faults(3.0, true);
  EXPECT_GE(found.named, 0.9 * found.rounds);
  expect_few_accusations(found);
}

TEST(ComparisonRounds, FaultOfOneQuantityIsNamedAsOftenAsTheTestsCan) {
  for (const double size : {3.0, 4.0, 5.0}) {
    const Naming found = name_faults(size, false);
    const auto deviations = [&](double expected) {
      return 4.0 * std::sqrt(expected * std::max(1.0, found.rounds - expected) / found.rounds);
    };
    // Each of the two tests alone names a part; together at most the sum.
    const double least = std::max(found.by_chi2, found.by_quantity);
    const double most = std::min(found.by_chi2 + found.by_quantity, static_cast<double>(found.rounds));
    EXPECT_GE(found.named, least - deviations(least)) << size;
    EXPECT_LE(found.named, most + deviations(most)) << size;
    EXPECT_LE(found.named, found.at_best + deviations(found.at_best)) << size;
    EXPECT_GE(found.with_quantity, found.by_quantity - deviations(found.by_quantity)) << size;
    expect_few_accusations(found);
    // 90 % of faults of 3 u are beyond what any test can name.
    if (size == 3.0) {
      EXPECT_LT(found.at_best, 0.9 * found.rounds);
    }
  }
}

TEST(ComparisonRounds, DetectableFaultsAreNamedWithTheirProbability) {
  constexpr double kPower = 0.9;
  int named = 0;
  constexpr int kRounds = 500;
  for (int r = 0; r < kRounds; ++r) {
    Round round(static_cast<std::uint64_t>(90'000 + r));
    const ParticipantResults before = round.transferred().results;
    const auto participant = static_cast<std::size_t>(r) % kInstitutes;
    const Index quantity = r % kQuantities, at = static_cast<Index>(participant) * kQuantities + quantity;
    ParticipantResults faulty = before;
    faulty.values(at) += detectable_faults(before, 0.01, kPower)(at);
    for (const FaultyParticipant& one : faulty_participants(faulty, 0.01))
      named += one.participant == participant ? 1 : 0;
  }
  // The joint test names some more.
  EXPECT_GE(named, kRounds * kPower - 4.0 * std::sqrt(kRounds * kPower * (1.0 - kPower)));
  EXPECT_LE(named, kRounds * 0.98);
}

TEST(ComparisonRounds, BrokenArtefactIsFoundBetweenItsTransfers) {
  int found = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    Round round(seed);
    const double change = 12.0 * Round::units()(4);
    round.drop_after(4, 4, change);  // the pilot measured at 3, then at 6
    const TransferredResults transferred = round.transferred();
    ASSERT_TRUE(transferred.step) << seed;
    if (transferred.step->before == 3 && transferred.step->after == 6 && transferred.step->quantity == 4)
      ++found;
    EXPECT_NEAR(transferred.step->change, change, 6.0 * transferred.step->u);
  }
  EXPECT_GE(found, 19);
}

TEST(ComparisonRounds, DriftIsTakenForDisagreementWithoutAModel) {
  Round round(3);
  EXPECT_TRUE(round.transferred(DriftModel::kNone).step) << "and not passed over";
  EXPECT_LT(round.transferred(DriftModel::kNone).constant.probability, 0.01);
}

TEST(ArtefactDrift, RefusesWhatItCannotFit) {
  const auto one = [](std::size_t participant, double time, double repeatability) {
    return ArtefactMeasurement{participant, time, VectorXd::Constant(1, 1.0), MatrixXd::Constant(1, 1, 0.01),
                               VectorXd::Constant(1, repeatability)};
  };
  const std::vector<double> k{2.0, 2.0};
  const auto transfer = [&](const std::vector<ArtefactMeasurement>& list, DriftModel model) {
    return transferred_results(list, {}, k, 0, model, 0.01);
  };
  EXPECT_NO_THROW(transfer({one(0, 0, 0.05), one(1, 1, 0), one(0, 2, 0.05)}, DriftModel::kLine));
  EXPECT_THROW(transfer({one(0, 0, 0.05), one(1, 1, 0)}, DriftModel::kLine), KeyComparisonError);
  EXPECT_THROW(transfer({one(0, 0, 0.0), one(1, 1, 0), one(0, 2, 0.05)}, DriftModel::kLine),
               KeyComparisonError);
  EXPECT_THROW(transfer({one(0, 0, 0.2), one(1, 1, 0), one(0, 2, 0.05)}, DriftModel::kLine),
               KeyComparisonError);
  EXPECT_THROW(transfer({one(0, 0, 0.05), one(1, 1, 0), one(1, 2, 0)}, DriftModel::kNone),
               KeyComparisonError);
  EXPECT_THROW(transfer({one(0, 0, 0.05)}, DriftModel::kNone), KeyComparisonError);
}

}  // namespace
}  // namespace abcal
