#include "protocol/uncertainty/type_a.h"

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/estimators/shared/known_acs_fit.h"
#include "protocol/model/forward_model.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

namespace {

// One reading as the trials need it.
struct Pose {
  int experiment = 0;
  Angle alpha;
  Angle step_mean, step_error;  // of f_i(n)
};

Angle element(const std::vector<Angle>& list, int n) {
  const auto index = static_cast<std::size_t>(n - 1);
  return index < list.size() ? list[index] : Angle();
}

void check_standard_error(const char* name, double value) {
  if (!(value >= 0.0 && std::isfinite(value))) {
    throw std::invalid_argument(std::string("standard error of ") + name + " = " + std::to_string(value) +
                                ", it must be finite and not negative");
  }
}

}  // namespace

MeasuredAcs MeasuredAcs::not_measured(const RunRecord& record) {
  MeasuredAcs measured;
  const double alignment = sincos(record.tolerances.alignment).sin;
  measured.standard_error.alignment = {alignment, alignment, alignment};
  measured.standard_error.d2 = measured.standard_error.d3 = record.tolerances.initial_turn;
  measured.standard_error.mean_step_x = measured.standard_error.mean_step_z = record.tolerances.zero;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing || dwell.experiment < 1 || dwell.experiment > 3 || dwell.n < 1) continue;
    std::vector<Angle>& f =
        measured.standard_error.step_errors[static_cast<std::size_t>(dwell.experiment - 1)];
    if (f.size() < static_cast<std::size_t>(dwell.n)) f.resize(static_cast<std::size_t>(dwell.n));
    f[static_cast<std::size_t>(dwell.n - 1)] = record.tolerances.step;
  }
  return measured;
}

MonteCarloResult run_type_a(const RunRecord& record, const MeasuredAcs& measured, std::uint64_t seed,
                            const MonteCarloOptions& options) {
  const AcsErrors& mean = measured.mean;
  const AcsErrors& error = measured.standard_error;
  check_standard_error("Zx", error.alignment.zx);
  check_standard_error("Zy", error.alignment.zy);
  check_standard_error("Xz", error.alignment.xz);
  check_standard_error("d2", error.d2.deg());
  check_standard_error("d3", error.d3.deg());
  check_standard_error("F_X", error.mean_step_x.deg());
  check_standard_error("F_Z", error.mean_step_z.deg());
  std::vector<Pose> poses;
  std::vector<Eigen::Vector3d> readings;
  std::vector<double> weights;
  bool weighted = true;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing) continue;
    if (dwell.experiment < 1 || dwell.experiment > 3 || dwell.n < 1) {
      throw std::invalid_argument(record.source + ": a reading of experiment " +
                                  std::to_string(dwell.experiment) + ", n = " + std::to_string(dwell.n) +
                                  " has no place");
    }
    const auto i = static_cast<std::size_t>(dwell.experiment - 1);
    poses.push_back({dwell.experiment, dwell.alpha, element(mean.step_errors[i], dwell.n),
                     element(error.step_errors[i], dwell.n)});
    check_standard_error("a step error", poses.back().step_error.deg());
    readings.push_back(dwell.mean);
    weighted = weighted && dwell.u_mean && (dwell.u_mean->array() > 0.0).all();
    if (weighted)
      weights.push_back(3.0 / dwell.u_mean->squaredNorm());  // as linear_fit_given_acs weighs a record
  }
  if (!weighted) weights.clear();

  const TrialBlock block = [&](std::uint64_t first, std::size_t count, double* out) {
    std::vector<Eigen::Vector3d> gravity(poses.size());
    for (std::size_t t = 0; t < count; ++t) {
      RandomStream stream(seed, StreamPurpose::kTypeA, first + t);
      AcsErrors acs;
      acs.alignment.zx = mean.alignment.zx + error.alignment.zx * stream.normal();
      acs.alignment.zy = mean.alignment.zy + error.alignment.zy * stream.normal();
      acs.alignment.xz = mean.alignment.xz + error.alignment.xz * stream.normal();
      acs.d2 = mean.d2 + error.d2 * stream.normal();
      acs.d3 = mean.d3 + error.d3 * stream.normal();
      const Angle f_x = mean.mean_step_x + error.mean_step_x * stream.normal();
      const Angle f_z = mean.mean_step_z + error.mean_step_z * stream.normal();
      const std::array<GravityCircle, 3> circles = {gravity_circle(1, acs), gravity_circle(2, acs),
                                                    gravity_circle(3, acs)};
      for (std::size_t i = 0; i < poses.size(); ++i) {
        const Pose& pose = poses[i];
        const Angle f = pose.step_mean + pose.step_error * stream.normal();
        gravity[i] = circles[static_cast<std::size_t>(pose.experiment - 1)].at(
            pose.alpha + (pose.experiment == 3 ? f_z : f_x) + f);
      }
      const KnownAcsFit fit = linear_fit_given_acs(gravity, readings, weights);
      const OutputVector values = to_vector(outputs_of(fit.sensitivity_matrix, fit.offset));
      for (std::size_t k = 0; k < kStudyOutputs; ++k)
        out[k * count + t] = values(static_cast<Eigen::Index>(k));
    }
  };
  return run_monte_carlo(kStudyOutputs, block, options);
}

}  // namespace abcal
