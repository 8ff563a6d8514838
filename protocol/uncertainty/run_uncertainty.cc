#include "protocol/uncertainty/run_uncertainty.h"

#include <fmt/format.h>
#include <Eigen/Eigenvalues>
#include <cmath>
#include <stdexcept>

#include "protocol/analysis/analyse.h"
#include "protocol/uncertainty/published_tables.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/type_b.h"

namespace abcal {

namespace {

/// The square root by eigenvalues: the covariance may be singular (no noise, no drift), and negative in a
/// direction in which the correction for k2 and k3 makes the drawn errors smaller.
Covariance12 root_of_positive_part(const Covariance12& covariance) {
  const Eigen::SelfAdjointEigenSolver<Covariance12> eigen(covariance);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal();
}

// Type B errors of the stage and, besides, normal errors of s and O with the covariance of the rest of the
// budget.
TrialBlock whole_budget(const TypeBSampler& sampler, const Covariance12& other, std::uint64_t seed) {
  const Covariance12 root = root_of_positive_part(other);
  const AccelerometerUnderTest accelerometer = sampler.study().accelerometer;
  const OutputVector truth = to_vector(outputs_of(accelerometer.sensitivity_matrix, accelerometer.offset));
  return [&sampler, root, accelerometer, truth, seed](std::uint64_t first, std::size_t count, double* out) {
    sampler(first, count, out);
    for (std::size_t t = 0; t < count; ++t) {
      RandomStream stream(seed, StreamPurpose::kReadings, first + t);
      Eigen::Matrix<double, 12, 1> normals;
      for (double& normal : normals) normal = stream.normal();
      const Eigen::Matrix<double, 12, 1> other_errors = root * normals;
      Eigen::Matrix3d s = accelerometer.sensitivity_matrix;
      Eigen::Vector3d offset = accelerometer.offset;
      for (Eigen::Index k = 0; k < 12; ++k) {
        const double error = out[static_cast<std::size_t>(k) * count + t] + other_errors(k);
        (k < 9 ? s(k / 3, k % 3) : offset(k - 9)) += error;
      }
      const OutputVector errors = to_vector(outputs_of(s, offset)) - truth;
      for (Eigen::Index k = 0; k < kStudyOutputs; ++k)
        out[static_cast<std::size_t>(k) * count + t] = errors(k);
    }
  };
}

}  // namespace

RunUncertainty run_uncertainty(const RunRecord& record, const UncertaintyOptions& options) {
  check_tolerances(record.tolerances);
  if (options.trials && *options.trials < 2) {
    throw std::invalid_argument("number of trials = " + std::to_string(*options.trials) +
                                ", at least 2 are needed");
  }
  RunUncertainty study;
  study.source = record.source;
  study.response_unit = record.response_unit;
  study.tolerances = record.tolerances;
  study.seed = options.seed;
  study.paper_preset = options.paper_preset;
  study.result = analyse_abc(record, {options.resolution});
  if (study.result.verdict == Verdict::kNotUsable) {
    throw std::runtime_error(record.source + ": no uncertainty without a result: " + study.result.why);
  }
  study.value = outputs_of(study.result.sensitivity_values(), study.result.offset_values());

  TypeBStudy type_b;
  type_b.design = AbcDesign::of_record(record);
  type_b.accelerometer = {study.result.sensitivity_values(), study.result.offset_values()};
  type_b.tolerances = record.tolerances;
  type_b.seed = options.seed;
  const TypeBSampler sampler(type_b);

  int stage = 0;
  const auto engine = [&] {
    MonteCarloOptions monte_carlo;
    monte_carlo.trials = options.trials;
    monte_carlo.digits = options.digits;
    monte_carlo.threads = options.threads;
    monte_carlo.team = options.team;
    monte_carlo.stop = options.stop;
    if (options.progress) {
      const auto before = static_cast<std::uint64_t>(stage) * options.trials.value_or(0);
      monte_carlo.progress = [&options, before](std::uint64_t done, std::uint64_t planned) {
        options.progress(before + done, 3 * planned);
      };
    }
    ++stage;
    return monte_carlo;
  };
  const TrialBlock type_b_block = [&](std::uint64_t first, std::size_t count, double* out) {
    sampler(first, count, out);
  };
  study.type_b = run_monte_carlo(kStudyOutputs, type_b_block, engine());
  study.budget = make_budget(record, study.result, options.resolution);
  study.combined = run_monte_carlo(
      kStudyOutputs, whole_budget(sampler, study.budget.added_covariance, options.seed), engine());
  study.acs_measured = options.measured.has_value();
  study.type_a = run_type_a(record, options.measured.value_or(MeasuredAcs::not_measured(record)),
                            options.seed, engine());
  study.interrupted = study.type_b.interrupted || study.combined.interrupted || study.type_a.interrupted;

  study.standard_uncertainty = study.combined.standard_deviation;
  const OutputVector bounds = to_vector(published_bounds(study.result.sensitivity_values()));
  study.bounds = to_output(bounds);
  if (options.paper_preset) {
    const OutputVector others =
        study.budget.covariance.diagonal() - study.budget.type_b_covariance.diagonal();
    study.standard_uncertainty = (bounds.cwiseAbs2() + others.cwiseMax(0.0)).cwiseSqrt();
    for (int k = 0; k < kStudyOutputs; ++k) {
      const double own = study.type_b.standard_deviation(k);
      if (!(own > bounds(k))) continue;
      study.warnings.push_back(fmt::format(
          "{}: this bench's own type B standard uncertainty {:.2g} exceeds the paper's bound {:.2g}",
          output_symbol(k), own, bounds(k)));
    }
  }
  if (study.combined.interval_method != IntervalMethod::kNone) {
    // First order of what is drawn, so that the equations are judged and not the part that is cut off.
    const Covariance12 root = root_of_positive_part(study.budget.added_covariance);
    const auto first_order = [&](int k) {
      if (k >= 12) return study.budget.combined(k);
      return std::sqrt(study.budget.published_type_b_covariance(k, k) + root.row(k).squaredNorm());
    };
    for (int k = 0; k < kStudyOutputs; ++k) {
      study.validation.push_back(
          validate_gum(0.0, first_order(k), study.combined.coverage[static_cast<std::size_t>(k)].symmetric,
                       static_cast<double>(study.combined.trials), study.combined.coverage_probability,
                       options.validation_digits));
    }
  }
  return study;
}

}  // namespace abcal
