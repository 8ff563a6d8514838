// The whole computation of a comparison - shared effects, repeats of the pilot, drift, reference value,
// differences - against the posterior distribution of its unknowns: these are states with a prior, and each
// measurement updates them in turn. No matrix of all results, no least squares, no correction to one time.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>
#include <vector>

#include "app/laboratory/pilot/artefact_drift.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr Index kP = 9;

/// The states: truth at the reference time, rate, what the pilot's repeats have in common, a shared polygon,
/// and the gravity that two have in common.
constexpr Index kTruth = 0, kRate = kP, kPilot = 2 * kP, kPolygon = 3 * kP, kGravity = 4 * kP,
                kStates = 4 * kP + 1;

class Posterior {
 public:
  explicit Posterior(const VectorXd& prior_variance)
      : mean_(VectorXd::Zero(kStates)), covariance_(prior_variance.asDiagonal()) {}
  void set_prior(Index at, const MatrixXd& covariance) {
    covariance_.block(at, at, covariance.rows(), covariance.cols()) = covariance;
  }
  /// One measurement y = observes * states + noise.
  void update(const MatrixXd& observes, const VectorXd& y, const MatrixXd& noise) {
    const MatrixXd predicted = observes * covariance_ * observes.transpose() + noise;
    const MatrixXd gain = Eigen::FullPivLU<MatrixXd>(predicted).solve(observes * covariance_).transpose();
    mean_ += gain * (y - observes * mean_);
    // Joseph's form, which stays symmetric and positive.
    const MatrixXd left = MatrixXd::Identity(kStates, kStates) - gain * observes;
    covariance_ = left * covariance_ * left.transpose() + gain * noise * gain.transpose();
  }
  VectorXd mean() const { return mean_; }
  MatrixXd covariance() const { return covariance_; }

 private:
  VectorXd mean_;
  MatrixXd covariance_;
};

/// Ten institutes, the first is the pilot and measures four times.
class TenInstitutes {
 public:
  explicit TenInstitutes(std::uint64_t seed) : engine_(seed) {
    polygon_ = 0.4 * units();
    gravity_ = VectorXd::Zero(kP);
    gravity_.head(3) = 0.3 * units().head(3);
    repeatability_ = 0.35 * units();
    const std::vector<std::size_t> schedule{0, 1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 9, 0};
    const VectorXd truth = 1e3 * scaled_normals(), rate = 2.0 * scaled_normals();
    std::vector<MatrixXd> of_institute;
    for (std::size_t i = 0; i < kInstitutes; ++i) of_institute.push_back(stated());
    for (std::size_t k = 0; k < schedule.size(); ++k) {
      ArtefactMeasurement one;
      one.participant = schedule[k];
      one.time = static_cast<double>(k);
      one.covariance = of_institute[one.participant];
      one.values = truth + one.time * rate + Eigen::LLT<MatrixXd>(one.covariance).matrixL() * normals();
      one.repeatability = repeatability_;
      measurements_.push_back(one);
    }
  }
  static constexpr std::size_t kInstitutes = 10;
  static VectorXd units() { return VectorXd{{2e-5, 2e-5, 2e-5, 2e-3, 2e-3, 2e-3, 3e-5, 3e-5, 3e-5}}; }
  static bool has_polygon(std::size_t i) { return i == 2 || i == 5; }
  static bool has_gravity(std::size_t i) { return i == 3 || i == 7; }

  TransferredResults transferred() const {
    return transferred_results(measurements_,
                               {{"polygon", {2, 5}, polygon_, false}, {"gravity", {3, 7}, gravity_, true}},
                               std::vector<double>(kInstitutes, 2.0), 0, DriftModel::kLine, 0.01);
  }
  const VectorXd& origin() const { return measurements_.front().values; }
  /// The posterior of what differs from origin(), in units of units(), after the measurements of the named
  /// institutes.
  Posterior posterior(double reference_time, std::size_t without = kInstitutes) const {
    constexpr double kVague = 1e7;
    const VectorXd inverse = units().cwiseInverse();
    const auto in_units = [&](const MatrixXd& m) {
      return MatrixXd(inverse.asDiagonal() * m * inverse.asDiagonal());
    };
    Posterior posterior(VectorXd::Constant(kStates, kVague));
    const VectorXd part = repeatability_.cwiseQuotient(measurements_[0].covariance.diagonal().cwiseSqrt());
    const VectorXd common = (1.0 - part.array().square()).sqrt();
    posterior.set_prior(kPilot,
                        in_units(common.asDiagonal() * measurements_[0].covariance * common.asDiagonal()));
    posterior.set_prior(kPolygon, in_units(polygon_.cwiseAbs2().asDiagonal()));
    posterior.set_prior(kGravity, MatrixXd::Ones(1, 1));
    for (const ArtefactMeasurement& one : measurements_) {
      if (one.participant == without) continue;
      MatrixXd observes = MatrixXd::Zero(kP, kStates);
      observes.middleCols(kTruth, kP).setIdentity();
      observes.middleCols(kRate, kP) = (one.time - reference_time) * MatrixXd::Identity(kP, kP);
      MatrixXd noise = one.covariance;
      if (one.participant == 0) {
        observes.middleCols(kPilot, kP).setIdentity();
        noise = part.asDiagonal() * one.covariance * part.asDiagonal();
      }
      if (has_polygon(one.participant)) {
        observes.middleCols(kPolygon, kP).setIdentity();
        noise -= polygon_.cwiseAbs2().asDiagonal();
      }
      if (has_gravity(one.participant)) {
        observes.col(kGravity) = inverse.cwiseProduct(gravity_);
        noise -= gravity_ * gravity_.transpose();
      }
      posterior.update(observes, inverse.cwiseProduct(one.values - origin()), in_units(noise));
    }
    return posterior;
  }

 private:
  VectorXd normals() {
    std::normal_distribution<double> normal;
    return VectorXd::NullaryExpr(kP, [&] { return normal(engine_); });
  }
  VectorXd scaled_normals() { return units().cwiseProduct(normals()); }
  MatrixXd stated() {
    std::normal_distribution<double> normal;
    const MatrixXd root = MatrixXd::NullaryExpr(kP, 2 * kP, [&] { return normal(engine_); });
    const VectorXd u = std::uniform_real_distribution<double>(0.8, 2.5)(engine_) * units();
    return u.asDiagonal() * (root * root.transpose() / 18.0 + 0.3 * MatrixXd::Identity(kP, kP)) *
           u.asDiagonal();
  }

  std::mt19937_64 engine_;
  VectorXd polygon_, gravity_, repeatability_;
  std::vector<ArtefactMeasurement> measurements_;
};

// The prior of truth and rate has a variance of 1e7 squared units: it moves an estimate by 1e-7 of its
// distance from the first measurement.
constexpr double kOfVaguePrior = 1e-5;

TEST(BayesianUpdate, ReferenceValueIsThePosteriorOfTheTruth) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const TenInstitutes ten(seed);
    const TransferredResults transferred = ten.transferred();
    ASSERT_EQ(transferred.results.participants(), 10);
    const ReferenceValue reference =
        reference_value(transferred.results, {.procedure = ReferenceProcedure::kMean});
    const Posterior posterior = ten.posterior(transferred.reference_time);
    const VectorXd unit = TenInstitutes::units();
    const VectorXd u = posterior.covariance().diagonal().head(kP).cwiseSqrt();
    const VectorXd off = (reference.values - ten.origin()).cwiseQuotient(unit) - posterior.mean().head(kP);
    EXPECT_LT(off.cwiseQuotient(u).cwiseAbs().maxCoeff(), kOfVaguePrior) << seed;
    const MatrixXd found =
        unit.cwiseInverse().asDiagonal() * reference.covariance * unit.cwiseInverse().asDiagonal();
    const MatrixXd expected = posterior.covariance().topLeftCorner(kP, kP);
    EXPECT_LT(((found - expected).array() / (u * u.transpose()).array()).abs().maxCoeff(), kOfVaguePrior)
        << seed;
  }
}

TEST(BayesianUpdate, RateOfThePilotAloneIsWiderThanThatOfAllAndAgrees) {
  // The drift is that of the pilot's repeats; the posterior has what the other institutes tell of it, too.
  const TenInstitutes ten(3);
  const TransferredResults transferred = ten.transferred();
  const Posterior posterior = ten.posterior(transferred.reference_time);
  for (Index q = 0; q < kP; ++q) {
    const double unit = TenInstitutes::units()(q);
    const double u_all = std::sqrt(posterior.covariance()(kRate + q, kRate + q));
    const double u_pilot = std::sqrt(transferred.rate_covariance(q, q)) / unit;
    EXPECT_LE(u_all, u_pilot * (1.0 + kOfVaguePrior));
    // The difference of an estimate and a better one has the difference of their variances.
    EXPECT_LT(std::abs(transferred.rate(q) / unit - posterior.mean()(kRate + q)),
              4.0 * std::sqrt(u_pilot * u_pilot - u_all * u_all) + kOfVaguePrior);
  }
}

TEST(BayesianUpdate, DifferenceFromTheOthersIsTheOneThatNamesAFault) {
  // Prediction of institute 4 from the nine others: chi2 of what it gave is that of the naming test.
  const TenInstitutes ten(5);
  const TransferredResults transferred = ten.transferred();
  ReferenceOptions options{.procedure = ReferenceProcedure::kMean};
  ParticipantResults others = transferred.results;
  std::vector<Index> at;
  for (Index k = 0; k < others.values.size(); ++k)
    if (k / kP != 4) at.push_back(k);
  others.values = VectorXd(transferred.results.values(at));
  others.covariance = MatrixXd(transferred.results.covariance(at, at));
  others.coverage_factors.pop_back();
  const ReferenceValue reference = reference_value(others, options);
  const Posterior posterior = ten.posterior(transferred.reference_time, 4);
  const VectorXd u = posterior.covariance().diagonal().head(kP).cwiseSqrt();
  const VectorXd off =
      (reference.values - ten.origin()).cwiseQuotient(TenInstitutes::units()) - posterior.mean().head(kP);
  EXPECT_LT(off.cwiseQuotient(u).cwiseAbs().maxCoeff(), kOfVaguePrior);
}

}  // namespace
}  // namespace abcal
