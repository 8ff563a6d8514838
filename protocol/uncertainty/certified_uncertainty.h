#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// The magnitude that errors do not exceed with a probability, from a number of trials.
struct ErrorQuantile {
  double found = 0.0;
  double lower = 0.0;  ///< 99 % lower bound (order statistics; distribution-free).
};
/// @param magnitudes  of the errors; sorted by the call
/// @throws std::invalid_argument  for too few magnitudes to have a lower bound, or p outside (0, 1)
ErrorQuantile error_quantile(std::vector<double>& magnitudes, double p);

/// The expanded uncertainty of a quantity by Monte Carlo, and the one that the result states; both for the
/// same coverage probability.
struct CertifiedExpanded {
  double stated = 0.0;
  ErrorQuantile monte_carlo;

  /// Whether that by Monte Carlo is to be stated: its lower bound exceeds the stated one by more than 5 %. A
  /// smaller one is never taken.
  bool is_larger() const { return monte_carlo.lower > kLarger * stated; }
  static constexpr double kLarger = 1.05;
};

/// Trials of a certificate. JCGM 101:2008, 7.2.2 asks for 1e4/(1 - p); the bound allows for fewer.
inline constexpr std::uint64_t kCertifiedTrials = 2000;

/// Monte Carlo of a joint result that is certified (JCGM 101:2008, 8): whether its U may be stated. Each
/// trial draws the truth from what the run leaves possible, makes new readings of it with the signs of its
/// own hysteresis, and applies the whole estimator (JointTrials). U by Monte Carlo is the magnitude that the
/// error does not exceed with the probability of the stated U, so that a bias counts.
struct CertifiedUncertainty {
  std::uint64_t trials = 0, seed = 0;
  std::array<CertifiedExpanded, kStudyOutputs> outputs;      ///< As in study_output.h.
  OutputCovariance mean_squares = OutputCovariance::Zero();  ///< Mean squares of the errors.

  bool any_larger() const;
  /// "s_ux, phi_uv": the outputs whose U by Monte Carlo is stated.
  std::string larger() const;
  /// A covariance with which no combination of the twelve outputs is less uncertain than by `stated` or by
  /// the mean squares of the errors.
  Covariance12 covariance(const Covariance12& stated) const;
  /// The standard uncertainty that makes U of a quantity that by Monte Carlo; 0 where that is not stated.
  /// @param k  coverage factor of the quantity
  double standard_uncertainty(int output, double k) const;
};

/// @param result  joint result of the item alone
/// @param own  its solution
/// @throws std::runtime_error  as run_monte_carlo()
CertifiedUncertainty certified_uncertainty(const RunRecord& record, const CalibrationResult& result,
                                           const ItemFit& own, std::uint64_t seed,
                                           std::uint64_t trials = kCertifiedTrials);

/// The same for a run whose joint result was computed before. Absent: the result is not one of the joint
/// estimator, it has no numbers, or it uses a record of the stage, which the trials do not draw from.
/// @param sha256  of the run file, from which the seed is taken
std::optional<CertifiedUncertainty> certified_uncertainty_of(const RunRecord& record,
                                                             const CalibrationResult& result,
                                                             const std::string& sha256);

/// The first 64 bits of a SHA-256 in hexadecimal digits.
std::uint64_t seed_of_sha256(const std::string& sha256);

}  // namespace abcal
