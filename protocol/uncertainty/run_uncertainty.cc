#include "protocol/uncertainty/run_uncertainty.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/uncertainty/published_tables.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/type_b.h"

namespace abcal {

namespace {

/// The square root by eigenvalues: the covariance may be singular (no noise, no drift), so that round-off
/// makes some of them negative.
Covariance12 root_of(const Covariance12& covariance) {
  const SymmetricEigen eigen = symmetric_eigen(covariance);
  return scaled_columns(eigen.vectors, eigen.values.cwiseMax(0.0).cwiseSqrt());
}

/// Errors of the whole budget: the published protocol's own, drawn through its equations, as the correction
/// for k2 and k3 changes them, and besides normal errors of s and O by all that is not drawn so
/// (docs/effects.md).
TrialBlock whole_budget(const TypeBSampler& sampler, const Budget& budget, std::uint64_t seed) {
  const Covariance12 root = root_of(budget.added_covariance);
  const Covariance12 corrected = Covariance12::Identity() + budget.by_correction;
  const AccelerometerUnderTest accelerometer = sampler.study().accelerometer;
  const OutputVector truth = to_vector(outputs_of(accelerometer.sensitivity_matrix, accelerometer.offset));
  return [&sampler, root, corrected, accelerometer, truth, seed](std::uint64_t first, std::size_t count,
                                                                 double* out) {
    sampler(first, count, out);
    // Outputs are in columns; the first twelve are s row by row and O.
    Eigen::Map<Eigen::MatrixXd> errors(out, static_cast<Eigen::Index>(count), kStudyOutputs);
    Eigen::MatrixXd normals(static_cast<Eigen::Index>(count), 12);
    for (Eigen::Index t = 0; t < normals.rows(); ++t) {
      RandomStream stream(seed, StreamPurpose::kReadings, first + static_cast<std::uint64_t>(t));
      for (Eigen::Index k = 0; k < 12; ++k) normals(t, k) = stream.normal();
    }
    Eigen::MatrixXd changed = product_transposed(errors.leftCols<12>(), corrected);
    changed += product_transposed(normals, root);
    for (Eigen::Index t = 0; t < changed.rows(); ++t) {
      Eigen::Matrix3d s = accelerometer.sensitivity_matrix;
      Eigen::Vector3d offset = accelerometer.offset;
      for (Eigen::Index k = 0; k < 12; ++k) (k < 9 ? s(k / 3, k % 3) : offset(k - 9)) += changed(t, k);
      errors.row(t) = (to_vector(outputs_of(s, offset)) - truth).transpose();
    }
  };
}

}  // namespace

void require_trials(const UncertaintyOptions& options) {
  if (options.trials && *options.trials < 2)
    throw std::invalid_argument(fmt::format("number of trials = {}, at least 2 are needed", *options.trials));
}

MonteCarloOptions monte_carlo_options(const UncertaintyOptions& options) {
  MonteCarloOptions monte_carlo;
  monte_carlo.trials = options.trials;
  monte_carlo.digits = options.digits;
  monte_carlo.threads = options.threads;
  monte_carlo.team = options.team;
  monte_carlo.stop = options.stop;
  monte_carlo.progress = options.progress;
  return monte_carlo;
}

RunUncertainty run_uncertainty(const RunRecord& record, const UncertaintyOptions& options) {
  check_tolerances(record.tolerances);
  require_trials(options);
  if (has_two_faces(record)) {
    throw std::invalid_argument(
        record.source +
        ": has two faces, and the Monte Carlo study of ABC draws a stage at the poses of the published "
        "protocol only; required: a run of one face, or the joint estimator (--estimator joint)");
  }
  if (is_at_constant_rate(record)) {
    throw std::invalid_argument(record.source +
                                ": the stage turned at constant rates, and the Monte Carlo study of ABC "
                                "draws a stage at rest; required: "
                                "a run in steps, or the joint estimator (--estimator joint)");
  }
  RunUncertainty study;
  study.source = record.source;
  study.response_unit = record.response_unit;
  study.tolerances = record.tolerances;
  study.seed = options.seed;
  study.paper_preset = options.paper_preset;
  study.result = analyse_abc(record, {options.resolution});
  if (study.result.verdict == Verdict::kNotUsable) {
    throw std::runtime_error(record.source +
                             ": no uncertainty without a result: " + study.result.why.english());
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
    MonteCarloOptions monte_carlo = monte_carlo_options(options);
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
  study.combined =
      run_monte_carlo(kStudyOutputs, whole_budget(sampler, study.budget, options.seed), engine());
  const StageRecordInUse& measured = record.stage_record;
  if (measured.record) study.acs_measured = measured.record->sha256;
  study.type_a = run_type_a(record,
                            measured.record ? MeasuredAcs::of(*measured.record, measured.age_months)
                                            : MeasuredAcs::not_measured(record),
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
    for (int k = 0; k < kStudyOutputs; ++k) {
      study.validation.push_back(
          validate_gum({0.0, study.budget.combined(k)},
                       {study.combined.coverage[static_cast<std::size_t>(k)].symmetric,
                        static_cast<double>(study.combined.trials), study.combined.coverage_probability},
                       options.validation_digits));
    }
  }
  return study;
}

}  // namespace abcal
