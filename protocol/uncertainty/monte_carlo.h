#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/uncertainty/coverage.h"

namespace abcal {

class MonteCarloTeam;

/// Makes trials first .. first + count - 1 of a study: output k of trial first + i goes to out[k * count +
/// i]. Called from several threads at once; must depend on the trial's number alone.
using TrialBlock = std::function<void(std::uint64_t first, std::size_t count, double* out)>;

struct MonteCarloOptions {
  /// Fixed number of trials. Absent: adaptive (JCGM 101:2008, 7.9) to `digits`.
  std::optional<std::uint64_t> trials = 1'000'000;
  int digits = 2;  ///< Significant digits of u that an adaptive run must reach: 1 or 2.
  /// Adaptive: the tolerance is divided by this (JCGM 101 section 8.2 asks 5 when it validates the GUM
  /// framework).
  double tolerance_divisor = 1.0;
  /// Trials that a thread takes at a time. The result depends on it in the last bits.
  std::uint64_t block = 1000;
  std::uint64_t most_trials = 100'000'000;  ///< Limit at which an adaptive run ends without having converged,
                                            ///< and reports it.
  unsigned threads = 0;                     ///< 0: as many as the machine has.
  double coverage_probability = kCoverageProbability;
  MonteCarloTeam* team = nullptr;  ///< Other processes that share the work; null: this one alone.
  std::stop_token stop;            ///< On a request to stop, the engine reports its results so far.
  /// Called from time to time with the number of trials done and planned (0: not known), by any worker, one
  /// at a time.
  std::function<void(std::uint64_t done, std::uint64_t planned)> progress;
};

/// How the coverage intervals were found.
enum class IntervalMethod { kNone, kExact, kHistogram };

struct MonteCarloResult {
  std::uint64_t trials = 0;
  bool interrupted = false;  ///< Stopped before the stated number of trials or digits.
  bool adaptive = false;
  bool converged = false;  ///< Adaptive: the stated digits were reached. Fixed number: all trials were made.
  Eigen::VectorXd mean;
  Eigen::VectorXd standard_deviation;
  Eigen::MatrixXd covariance;
  std::vector<Coverage> coverage;  ///< Empty with kNone (too few trials for an interval).
  double coverage_probability = kCoverageProbability;
  IntervalMethod interval_method = IntervalMethod::kNone;
  /// Adaptive: twice the standard deviation of the averages over the blocks (y, u, y_low, y_high) over the
  /// tolerance, the largest of each output. At most 1 where converged.
  Eigen::VectorXd reached;
  std::string note;  ///< Remark on these figures for the reader; printed unchanged.
};

/// Runs a study of `outputs` outputs.
///
/// Trials are made in blocks; a block's mean and scatter are merged in the order of the blocks (Chan, Golub &
/// LeVeque), and counts are whole numbers, so the result is the same to the last bit for any number of
/// threads. Up to 1e6 trials every value is kept and the intervals are exact; beyond, they come from a grid
/// set by the first 1e4 trials (bins of 1e-3 u), which `note` reports. Under 300 MB for 18 outputs at any
/// number of trials.
/// @throws std::invalid_argument for 0 outputs, 0 or 1 trials, digits other than 1 or 2, p outside (0, 1).
/// @throws std::runtime_error if a trial gives a value that is not finite.
MonteCarloResult run_monte_carlo(int outputs, const TrialBlock& block, const MonteCarloOptions& options);

/// JCGM 101 7.9.2: half a unit of the last of `digits` significant digits of u. 0 for u = 0.
double numerical_tolerance(double u, int digits);

}  // namespace abcal
