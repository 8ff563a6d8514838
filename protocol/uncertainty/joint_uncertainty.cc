#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/norm/norm_fit.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/uncertainty/certified_uncertainty.h"
#include "protocol/uncertainty/joint_trials.h"
#include "protocol/uncertainty/measurement_trials.h"
#include "protocol/uncertainty/norm_trials.h"
#include "protocol/uncertainty/run_uncertainty.h"

namespace abcal {
namespace {

/// Trials that are solved in full as well.
constexpr std::size_t kSolvedInFull = 16;
/// Trials of a common fit that a thread takes at a time: each takes a tenth of a second or more.
constexpr std::uint64_t kSolvedTogether = 4;
/// Solutions in full may differ from the linear ones by this many standard uncertainties (rms): a difference
/// that is independent of the error adds 2 % to u.
constexpr double kMostDeviation = 0.2;
/// Student's distribution has a standard deviation above two degrees of freedom.
constexpr double kFewestScatterDegrees = 3.0;
/// A difference below this number of its own standard errors is chance.
constexpr double kStandardErrors = 3.0;

void describe(const RunRecord& record, const CalibrationResult& result, RunUncertainty& study) {
  study.estimator = result.estimator;
  study.source = record.source;
  study.response_unit = record.response_unit;
  study.tolerances = record.tolerances;
  study.result = result;
  if (result.verdict == Verdict::kNotUsable)
    throw std::runtime_error(record.source + ": no uncertainty without a result: " + result.why.english());
  study.budget = make_budget(record, result);
  JointComparison& joint = study.joint.emplace();
  const std::vector<Quantity> quantities = quantities_of_outputs(result);
  OutputVector value;
  for (int k = 0; k < kStudyOutputs; ++k) {
    const Quantity& quantity = quantities[static_cast<std::size_t>(k)];
    value(k) = quantity.value;
    joint.standard_uncertainty(k) = quantity.standard_uncertainty;
    joint.expanded(k) = coverage_factor(quantity) * quantity.standard_uncertainty;
  }
  study.value = to_output(value);
  study.standard_uncertainty = joint.standard_uncertainty;
}

/// Compares the linear solution with that in full for the first trials.
void check_in_full(const JointTrials& trials, const MonteCarloResult& made, JointComparison& joint) {
  const std::size_t count = std::min<std::size_t>(kSolvedInFull, made.trials);
  std::vector<double> linear(kStudyOutputs * count);
  trials(0, count, linear.data());
  std::vector<OutputVector> deviation(count);
  side_by_side(count, [&](std::size_t t) {
    const OutputVector full = trials.solved_in_full(t);
    for (Eigen::Index k = 0; k < kStudyOutputs; ++k)
      deviation[t](k) =
          (full(k) - linear[static_cast<std::size_t>(k) * count + t]) / joint.standard_uncertainty(k);
  });
  joint.solved_in_full = static_cast<int>(count);
  OutputVector squares = OutputVector::Zero();
  for (const OutputVector& one : deviation) {
    if (one.allFinite()) {
      squares += one.cwiseAbs2();
    } else {
      ++joint.not_converged;
    }
  }
  const int converged = joint.solved_in_full - joint.not_converged;
  if (converged > 0) joint.largest_deviation = std::sqrt(squares.maxCoeff() / converged);
}

/// Names the outputs whose Monte Carlo differs from what the result states.
/// @param by_u  false: only the intervals, as Student's distribution has a larger standard deviation than its
/// scale
void compare_with_stated(const MonteCarloResult& made, JointComparison& joint, bool by_u = true) {
  if (made.trials < 2) return;
  const auto trials = static_cast<double>(made.trials);
  for (int k = 0; k < kStudyOutputs; ++k) {
    const auto compare = [&](const char* of, double found, double stated, double relative_error) {
      const double difference = std::abs(found / stated - 1.0);
      if (difference > kNamedDifference && difference > kStandardErrors * relative_error)
        joint.differences.push_back({k, of, found, stated});
    };
    if (by_u)
      compare("standard uncertainty", made.standard_deviation(k), joint.standard_uncertainty(k),
              1.0 / std::sqrt(2.0 * trials));
    if (made.coverage.empty()) continue;
    const CoverageInterval& interval = made.coverage[static_cast<std::size_t>(k)].symmetric;
    // The standard error of an end point is sqrt(p (1 - p) / trials) over the density there; both ends of a
    // normal distribution at 97.5 %: 2.67 u / sqrt(trials) each.
    compare("half 95.45 % interval", 0.5 * (interval.high - interval.low), joint.expanded(k),
            2.67 / std::numbers::sqrt2 / 1.96 / std::sqrt(trials));
  }
}

void warn(JointComparison& joint, const std::string& unit, std::vector<std::string>& warnings) {
  // One sentence for each output: its standard uncertainty, its interval, or both.
  std::map<int, std::string> words;
  for (const StudyDifference& one : joint.differences) {
    std::string& sentence = words[one.output];
    sentence +=
        fmt::format("{}the {} by Monte Carlo is {:.1e} {}, where the result states {:.1e} ({:+.0f} %)",
                    sentence.empty() ? "" : "; ", one.of, one.monte_carlo, output_unit(one.output, unit),
                    one.stated, 100.0 * (one.monte_carlo / one.stated - 1.0));
  }
  for (const auto& [output, sentence] : words)
    warnings.push_back(fmt::format("{}: {} (docs/uncertainty.md)", output_symbol(output), sentence));
  if (joint.not_converged > 0)
    warnings.push_back(fmt::format("{} of {} trials that were solved in full have no solution",
                                   joint.not_converged, joint.solved_in_full));
  if (joint.largest_deviation > kMostDeviation)
    warnings.push_back(fmt::format(
        "the trials are solved by the derivatives at the run's own solution; solved in full, {} of them "
        "differ by {:.2g} standard uncertainties (rms): the intervals are known no better than that",
        joint.solved_in_full, joint.largest_deviation));
}

void warn_of_larger(const CertifiedUncertainty& made, RunUncertainty& study) {
  if (!made.any_larger()) return;
  study.warnings.push_back(
      fmt::format("{}: with the truth drawn from this result, U by Monte Carlo ({} trials) is larger than "
                  "the stated one; a certificate states the larger (docs/certificate.md)",
                  made.larger(), made.trials));
}

/// The norm fit has no matrix: nothing was drawn of its elements.
void leave_out_matrix(MonteCarloResult& made) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  made.mean.head<kFirstOffset>().setConstant(kNone);
  made.standard_deviation.head<kFirstOffset>().setConstant(kNone);
  made.covariance.topRows<kFirstOffset>().setConstant(kNone);
  made.covariance.leftCols<kFirstOffset>().setConstant(kNone);
  for (std::size_t k = 0; k < std::min<std::size_t>(kFirstOffset, made.coverage.size()); ++k)
    made.coverage[k].symmetric = made.coverage[k].shortest = {kNone, kNone};
}

}  // namespace

RunUncertainty norm_uncertainty(const RunRecord& record, const UncertaintyOptions& options) {
  require_trials(options);
  RunUncertainty study;
  study.seed = options.seed;
  std::optional<NormFit> fit;
  describe(record, analyse_norm(record, &fit), study);
  const double degrees = std::min(fit->scatter_degrees, fit->turn_degrees);
  if (degrees < kFewestScatterDegrees ||
      !study.standard_uncertainty.tail<kStudyOutputs - kFirstOffset>().allFinite()) {
    study.no_trials = fmt::format(
        "Monte Carlo is not made: the scatter of the poses has {:.2g} degrees of freedom, and its "
        "distribution has a "
        "standard deviation from {:g} on. More poses, or poses with stated uncertainties, give them.",
        degrees, kFewestScatterDegrees);
    return study;
  }
  const NormTrials trials(*fit, record.tolerances, options.seed);
  study.combined = run_monte_carlo(
      kStudyOutputs, [&](std::uint64_t first, std::size_t count, double* out) { trials(first, count, out); },
      monte_carlo_options(options));
  study.interrupted = study.combined.interrupted;
  if (!fit->solution.orientation) leave_out_matrix(study.combined);
  compare_with_stated(study.combined, *study.joint, !std::isfinite(degrees));
  warn(*study.joint, study.response_unit, study.warnings);
  if (const std::uint64_t count = trials.not_converged(); count > 0)
    study.warnings.push_back(
        fmt::format("{} trials have no solution and count as their linear approximation", count));
  return study;
}

RunUncertainty joint_uncertainty(const RunRecord& record, const UncertaintyOptions& options) {
  require_trials(options);
  RunUncertainty study;
  study.seed = options.seed;
  JointOptions joint_options;
  joint_options.measured_alignment = record.measured_alignment;
  const ItemFit own = fit_item(record, joint_options);
  describe(record, joint_result(record, own), study);

  const JointTrials trials(own, record, options.seed);
  study.combined = run_monte_carlo(
      kStudyOutputs, [&](std::uint64_t first, std::size_t count, double* out) { trials(first, count, out); },
      monte_carlo_options(options));
  study.interrupted = study.combined.interrupted;
  check_in_full(trials, study.combined, *study.joint);
  compare_with_stated(study.combined, *study.joint);
  warn(*study.joint, study.response_unit, study.warnings);
  if (!study.interrupted)
    warn_of_larger(certified_uncertainty(record, study.result, own, options.seed), study);
  if (study.combined.interval_method == IntervalMethod::kNone) return study;
  for (int k = 0; k < kStudyOutputs; ++k) {
    const Coverage& coverage = study.combined.coverage[static_cast<std::size_t>(k)];
    study.validation.push_back(validate_gum(
        {0.0, study.budget.combined(k)},
        {coverage.symmetric, static_cast<double>(study.combined.trials), study.combined.coverage_probability},
        options.validation_digits));
  }
  return study;
}

RunUncertainty common_fit_uncertainty(const CommonFit& fit, const CalibrationResult& result,
                                      const UncertaintyOptions& options) {
  require_trials(options);
  RunUncertainty study;
  study.seed = options.seed;
  const auto first = std::ranges::find(fit.places, fit.item, &ItemInRun::item);
  if (first == fit.places.end()) throw std::invalid_argument("common fit: no such item");
  describe(fit.records[static_cast<std::size_t>(first - fit.places.begin())], result, study);
  study.source = result.source;
  const MeasurementTrials trials(fit.records, fit.places, fit.item, options.seed);
  MonteCarloOptions monte_carlo = monte_carlo_options(options);
  monte_carlo.block = kSolvedTogether;
  study.combined = run_monte_carlo(
      kStudyOutputs, [&](std::uint64_t from, std::size_t count, double* out) { trials(from, count, out); },
      monte_carlo);
  study.interrupted = study.combined.interrupted;
  compare_with_stated(study.combined, *study.joint);
  warn(*study.joint, study.response_unit, study.warnings);
  return study;
}

}  // namespace abcal
