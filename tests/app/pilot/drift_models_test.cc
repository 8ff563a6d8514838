// The drift of the artefact as a line or a random walk: one model against formulas, the mean of all models
// against a numerical integration, and drawn comparisons.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "app/laboratory/pilot/artefact_drift.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kRepeatability =
    0.2;  ///< The repeatability of the pilot, in standard uncertainties of a participant.
const std::vector<double> kCoverageFactors(5, 2.0);
/// Who has the artefact at each transfer; participant 0 is the pilot.
constexpr std::array<std::size_t, 9> kTransfers{0, 1, 2, 0, 3, 0, 4, 0, 0};

/// Correlated quantities with values that are neither a line nor a constant.
std::vector<ArtefactMeasurement> some_measurements(Index quantities) {
  constexpr std::array<double, 9> kValues{10.0, 10.9, 10.2, 10.7, 12.1, 10.5, 11.0, 11.6, 11.4};
  std::vector<ArtefactMeasurement> list;
  for (std::size_t k = 0; k < kTransfers.size(); ++k) {
    ArtefactMeasurement& one = list.emplace_back();
    one.participant = kTransfers[k];
    one.time = static_cast<double>(k);
    one.values = VectorXd::NullaryExpr(
        quantities, [&](Index q) { return kValues[(k + 3 * static_cast<std::size_t>(q)) % kValues.size()]; });
    one.covariance = MatrixXd::Constant(quantities, quantities, 0.4);
    one.covariance.diagonal().setOnes();
    one.repeatability = VectorXd::Constant(quantities, kRepeatability);
  }
  return list;
}

TransferredResults transferred(const std::vector<ArtefactMeasurement>& list, DriftModel model,
                               const DriftPrior& prior = {}) {
  return transferred_results(list, {}, kCoverageFactors, 0, model, 0.01, prior);
}

TEST(DriftModels, LineOfUnknownSizeIsTheLineOfLeastSquares) {
  const std::vector<ArtefactMeasurement> list = some_measurements(3);
  const TransferredResults line = transferred(list, DriftModel::kLine);
  // The prior of the rate draws it to 0 by its variance over that of the prior, 1e-8 or less here.
  const TransferredResults averaged =
      transferred(list, DriftModel::kLineOrWalk, {.walk = 0.0, .sizes = {1e4}});
  EXPECT_LT((averaged.results.values - line.results.values).cwiseAbs().maxCoeff(), 1e-7);
  EXPECT_LT((averaged.results.covariance - line.results.covariance).cwiseAbs().maxCoeff(), 1e-7);
  EXPECT_LT((averaged.rate - line.rate).cwiseAbs().maxCoeff(), 1e-7);
  EXPECT_LT((averaged.rate_covariance - line.rate_covariance).cwiseAbs().maxCoeff(), 1e-7);
  EXPECT_EQ(averaged.walk_probability, VectorXd::Zero(3));
  EXPECT_EQ(averaged.line->chi2, line.line->chi2) << "the test of the line alone is that of the line";
  EXPECT_EQ(line.walk_probability.size(), 0);
}

TEST(DriftModels, DriftWithoutSizeIsNone) {
  const TransferredResults none = transferred(some_measurements(3), DriftModel::kNone);
  const TransferredResults averaged =
      transferred(some_measurements(3), DriftModel::kLineOrWalk, {.walk = 0.5, .sizes = {1e-6}});
  EXPECT_LT((averaged.results.values - none.results.values).cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_LT((averaged.results.covariance - none.results.covariance).cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_NEAR(averaged.walk_probability(1), 0.5, 1e-9) << "no data can tell one from the other";
}

TEST(DriftModels, TwoRepeatsGiveALine) {
  std::vector<ArtefactMeasurement> list = some_measurements(2);
  std::erase_if(list, [](const ArtefactMeasurement& one) {
    return one.participant == 0 && one.time > 0.0 && one.time < 8.0;
  });
  const TransferredResults line = transferred(list, DriftModel::kLine);
  const TransferredResults averaged = transferred(list, DriftModel::kLineOrWalk);
  EXPECT_EQ(averaged.results.values, line.results.values);
  EXPECT_EQ(averaged.results.covariance, line.results.covariance);
  EXPECT_EQ(averaged.walk_probability.size(), 0) << "and does not speak of a walk";
}

TEST(DriftModels, PriorThatIsNoneIsRefused) {
  for (const DriftPrior& prior :
       {DriftPrior{.walk = 1.5, .sizes = {1.0}}, DriftPrior{.walk = 0.5, .sizes = {}},
        DriftPrior{.walk = 0.5, .sizes = {1.0, 0.0}}})
    EXPECT_THROW(transferred(some_measurements(1), DriftModel::kLineOrWalk, prior), KeyComparisonError);
}

/// The mean and covariance of the states of one model, by one update after the other: the value at the
/// reference time, then the drift at each measurement. No matrix of measurements, no least squares.
struct States {
  VectorXd mean;
  MatrixXd covariance;
  double log_evidence = 0.0;

  void update(const VectorXd& observes, double y, double variance) {
    const VectorXd gain = covariance * observes;
    const double predicted = observes.dot(gain) + variance, error = y - observes.dot(mean);
    log_evidence -= 0.5 * (std::log(predicted) + error * error / predicted);
    mean += gain * (error / predicted);
    covariance -= gain * gain.transpose() / predicted;
  }
};

constexpr double kVague = 1e7;  ///< Variance of the prior of the value at the reference time.
/// That prior changes numbers of the order of 1 by 1 / kVague and by rounding of kVague.
constexpr double kOfVague = 1e-6;

/// @param size  standard deviation of the change from the first to the last measurement
States states_of(const std::vector<ArtefactMeasurement>& list, bool walk, double size) {
  double reference_time = 0.0;
  for (const ArtefactMeasurement& one : list)
    if (one.participant == 0) reference_time += one.time / 5.0;
  const auto count = static_cast<Index>(list.size());
  const double span = list.back().time - list.front().time;
  States states{VectorXd::Zero(1 + count), MatrixXd::Zero(1 + count, 1 + count)};
  // The pilot's common error cannot be told from the value, so that both are one state.
  states.covariance(0, 0) = kVague;
  for (Index a = 0; a < count; ++a)
    for (Index b = 0; b < count; ++b) {
      const double s = list[static_cast<std::size_t>(a)].time - reference_time;
      const double t = list[static_cast<std::size_t>(b)].time - reference_time;
      // Two walks share the increments between the reference time and the nearer of their times.
      const double from = std::max(std::min(s, 0.0), std::min(t, 0.0));
      const double to = std::min(std::max(s, 0.0), std::max(t, 0.0));
      states.covariance(1 + a, 1 + b) =
          size * size * (walk ? std::max(0.0, to - from) / span : s * t / (span * span));
    }
  for (Index k = 0; k < count; ++k) {
    const ArtefactMeasurement& one = list[static_cast<std::size_t>(k)];
    if (one.participant != 0) continue;
    VectorXd observes = VectorXd::Zero(1 + count);
    observes(0) = observes(1 + k) = 1.0;
    states.update(observes, one.values(0) - list.front().values(0), kRepeatability * kRepeatability);
  }
  return states;
}

/// Compares with the mean of models whose states are given.
void expect_mean_of(const std::vector<States>& models, const std::vector<double>& prior,
                    const std::vector<ArtefactMeasurement>& list, const TransferredResults& found) {
  std::vector<double> weights;
  double sum = 0.0;
  for (std::size_t m = 0; m < models.size(); ++m) {
    weights.push_back(prior[m] * std::exp(models[m].log_evidence - models.front().log_evidence));
    sum += weights.back();
  }
  VectorXd mean = VectorXd::Zero(models.front().mean.size());
  MatrixXd second = MatrixXd::Zero(mean.size(), mean.size());
  for (std::size_t m = 0; m < models.size(); ++m) {
    mean += weights[m] / sum * models[m].mean;
    second += weights[m] / sum * (models[m].covariance + models[m].mean * models[m].mean.transpose());
  }
  const MatrixXd covariance = second - mean * mean.transpose();
  // Results: the pilot's value, and each other measurement minus its drift.
  MatrixXd picked = MatrixXd::Zero(6, mean.size());
  VectorXd results(5), own = VectorXd::Ones(5);
  picked(0, 0) = 1.0;
  results(0) = list.front().values(0);
  own(0) = 1.0 - kRepeatability * kRepeatability;  // the common error
  for (std::size_t k = 0; k < list.size(); ++k) {
    if (list[k].participant == 0) continue;
    picked(static_cast<Index>(list[k].participant), static_cast<Index>(k) + 1) = -1.0;
    results(static_cast<Index>(list[k].participant)) = list[k].values(0);
  }
  const double span = list.back().time - list.front().time;
  picked(5, mean.size() - 1) = 1.0 / span;
  picked(5, 1) = -1.0 / span;
  const VectorXd expected = picked * mean;
  const MatrixXd all = picked * covariance * picked.transpose();
  MatrixXd of_results = all.topLeftCorner(5, 5);
  of_results.diagonal() += own;
  EXPECT_LT((found.results.values - results - expected.head(5)).cwiseAbs().maxCoeff(), kOfVague);
  EXPECT_LT((found.results.covariance - of_results).cwiseAbs().maxCoeff(), kOfVague);
  EXPECT_NEAR(found.rate(0), expected(5), kOfVague);
  EXPECT_NEAR(found.rate_covariance(0, 0), all(5, 5), kOfVague);
}

TEST(DriftModels, WalkAloneIsTheUpdateOfItsStates) {
  const std::vector<ArtefactMeasurement> list = some_measurements(1);
  const TransferredResults walk = transferred(list, DriftModel::kLineOrWalk, {.walk = 1.0, .sizes = {7.0}});
  expect_mean_of({states_of(list, true, 7.0 * kRepeatability)}, {1.0}, list, walk);
  EXPECT_EQ(walk.walk_probability(0), 1.0);
}

TEST(DriftModels, MeanOfModelsHasTheCovarianceOfTheirMixture) {
  const std::vector<ArtefactMeasurement> list = some_measurements(1);
  const DriftPrior prior{.walk = 0.3, .sizes = {2.0, 5.0, 20.0}};
  std::vector<States> models;
  std::vector<double> probabilities;
  for (const bool walk : {false, true})
    for (const double size : prior.sizes) {
      models.push_back(states_of(list, walk, size * kRepeatability));
      probabilities.push_back(walk ? prior.walk : 1.0 - prior.walk);
    }
  const TransferredResults found = transferred(list, DriftModel::kLineOrWalk, prior);
  expect_mean_of(models, probabilities, list, found);
  EXPECT_GT(found.walk_probability(0), 0.05) << "both kinds count";
  EXPECT_LT(found.walk_probability(0), 0.95) << "both kinds count";
}

enum class Drift { kFromPrior, kNone, kLine, kWalk };

/// One comparison with its truth: quantities with drifts of their own.
class DriftingRound {
 public:
  static constexpr Index kQuantities = 3;

  /// @param size  change from the first to the last measurement, in repeatabilities
  DriftingRound(Drift drift, double size, std::uint64_t seed) : engine_(seed) {
    for (Index q = 0; q < kQuantities; ++q) {
      Drift kind = drift;
      double change = size * kRepeatability;
      if (drift == Drift::kFromPrior) {
        const DriftPrior prior;
        kind = uniform() < prior.walk ? Drift::kWalk : Drift::kLine;
        change = kRepeatability *
                 prior.sizes[static_cast<std::size_t>(uniform() * static_cast<double>(prior.sizes.size()))];
      }
      drifts_.push_back(drawn_drift(kind, change));
    }
    MatrixXd covariance = MatrixXd::Constant(kQuantities, kQuantities, 0.4);
    covariance.diagonal().setOnes();
    const MatrixXd root = Eigen::LLT<MatrixXd>(covariance).matrixL();
    const VectorXd pilots = std::sqrt(1.0 - kRepeatability * kRepeatability) * (root * normals());
    for (std::size_t k = 0; k < kTransfers.size(); ++k) {
      const VectorXd error = root * normals();
      ArtefactMeasurement& one = measurements_.emplace_back();
      one.participant = kTransfers[k];
      one.time = static_cast<double>(k);
      one.covariance = covariance;
      one.repeatability = VectorXd::Constant(kQuantities, kRepeatability);
      one.values = one.participant == 0 ? VectorXd(pilots + kRepeatability * error) : error;
      for (Index q = 0; q < kQuantities; ++q) one.values(q) += drifts_[static_cast<std::size_t>(q)][k];
    }
  }

  /// Errors of the reference value in its standard uncertainties.
  VectorXd deviates(DriftModel model) const {
    const TransferredResults transferred =
        abcal::transferred_results(measurements_, {}, kCoverageFactors, 0, model, 0.01);
    const ReferenceValue reference =
        reference_value(transferred.results, {.procedure = ReferenceProcedure::kMean});
    return reference.values.cwiseQuotient(reference.covariance.diagonal().cwiseSqrt());
  }

 private:
  double uniform() { return std::uniform_real_distribution<double>()(engine_); }
  double normal() { return std::normal_distribution<double>()(engine_); }
  VectorXd normals() {
    return VectorXd::NullaryExpr(kQuantities, [this] { return normal(); });
  }
  /// The drift at each transfer, 0 at the mean time of the pilot's measurements, which is 4.6.
  std::vector<double> drawn_drift(Drift kind, double change) {
    constexpr double kReferenceTime = 4.6, kSpan = 8.0;
    std::vector<double> drift(kTransfers.size(), 0.0);
    if (kind == Drift::kLine) {
      const double rate = change * normal() / kSpan;
      for (std::size_t k = 0; k < drift.size(); ++k)
        drift[k] = rate * (static_cast<double>(k) - kReferenceTime);
    } else if (kind == Drift::kWalk) {
      double at_reference = 0.0;
      for (std::size_t k = 1; k < drift.size(); ++k) {
        const double in_part = change * std::sqrt((kReferenceTime - 4.0) / kSpan) * normal();
        const double rest = change * std::sqrt((5.0 - kReferenceTime) / kSpan) * normal();
        if (k == 5) at_reference = drift[4] + in_part;
        drift[k] = drift[k - 1] + in_part + rest;
      }
      for (double& one : drift) one -= at_reference;
    }
    return drift;
  }

  std::mt19937_64 engine_;
  std::vector<std::vector<double>> drifts_;
  std::vector<ArtefactMeasurement> measurements_;
};

/// Fraction of rounds and quantities whose reference value covers the truth.
double covered(const std::string& name, Drift drift, double size, DriftModel model) {
  constexpr int kRounds = 1000;
  const double k = normal_quantile(0.975);
  Index inside = 0;
  for (int r = 0; r < kRounds; ++r)
    inside +=
        (DriftingRound(drift, size, static_cast<std::uint64_t>(7000 + r)).deviates(model).array().abs() <= k)
            .count();
  const double part = static_cast<double>(inside) / static_cast<double>(kRounds * DriftingRound::kQuantities);
  testing::Test::RecordProperty(name, std::to_string(part));
  return part;
}

/// Four standard deviations of 95 % of 1000 rounds: quantities of one round are correlated, so that their
/// number does not count.
const double kScatter = 4.0 * std::sqrt(0.95 * 0.05 / 1000.0);

TEST(DriftModels, ReferenceCoversDriftsOfThePrior) {
  EXPECT_NEAR(covered("averaged", Drift::kFromPrior, 0.0, DriftModel::kLineOrWalk), 0.95, kScatter);
}

TEST(DriftModels, ReferenceCoversEveryDrift) {
  const auto expect_covers = [](const std::string& name, Drift drift, double size) {
    EXPECT_GE(covered(name, drift, size, DriftModel::kLineOrWalk), 0.95 - kScatter) << name;
  };
  expect_covers("none", Drift::kNone, 0.0);
  for (const double size : {3.0, 30.0}) {
    const std::string of_size = " of " + std::to_string(static_cast<int>(size)) + " repeatabilities";
    expect_covers("line" + of_size, Drift::kLine, size);
    expect_covers("walk" + of_size, Drift::kWalk, size);
  }
}

TEST(DriftModels, LineAloneDoesNotCoverAWalk) {
  EXPECT_GE(covered("line on a line", Drift::kLine, 30.0, DriftModel::kLine), 0.95 - kScatter);
  EXPECT_LT(covered("line on a walk", Drift::kWalk, 30.0, DriftModel::kLine), 0.85);
}

}  // namespace
}  // namespace abcal
