#include "protocol/estimators/joint/joint_study.h"

#include <Random123/philox.h>
#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <limits>
#include <mutex>
#include <numbers>
#include <stdexcept>
#include <thread>

#include "protocol/estimators/circle/sensitivity_matrix.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/model/alignment.h"
#include "protocol/model/forward_model.h"

namespace abcal {
namespace {

/// Standard normals of one trial. Counter-based, so that a trial needs no other trial's numbers.
class TrialNormals {
 public:
  TrialNormals(std::uint64_t seed, std::uint64_t trial) : key_{{seed}}, trial_(trial) {}

  double operator()() {
    if (have_second_) {
      have_second_ = false;
      return second_;
    }
    const r123::Philox2x64::ctr_type bits = r123::Philox2x64{}({{trial_, next_++}}, key_);
    // 53 bits each; the first in (0, 1], so that its logarithm exists. Box and Muller.
    const double u = (static_cast<double>(bits[0] >> 11U) + 1.0) * 0x1p-53;
    const double turn = static_cast<double>(bits[1] >> 11U) * 0x1p-53 * 2.0 * std::numbers::pi;
    const double radius = std::sqrt(-2.0 * std::log(u));
    second_ = radius * std::sin(turn);
    have_second_ = true;
    return radius * std::cos(turn);
  }

 private:
  r123::Philox2x64::key_type key_;
  std::uint64_t trial_;
  std::uint64_t next_ = 0;
  bool have_second_ = false;
  double second_ = 0.0;
};

/// The true values from which one run was simulated.
struct Truth {
  AccelerometerModel accelerometer;  ///< Tilted, in response units.
  AcsErrors acs;
};

constexpr double kCoverageFactor = 1.959963984540054;  // 97.5 % quantile of N(0, 1)
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// Error and posterior uncertainty of one output in one trial, and the error of ABC. For the step errors:
/// mean squares over all of them.
struct TrialOutput {
  double covered = 0.0;
  double squared_error = 0.0;
  double variance = 0.0;
  double abc_squared_error = kNan;
};

struct Trial {
  bool solved = false;
  bool usable = false;
  bool nonlinearity_fitted = false;
  double chi2_per_dof = 0.0;
  int iterations = 0;
  std::vector<TrialOutput> outputs;
};

std::vector<std::string> output_names() {
  std::vector<std::string> names;
  const std::string axes = "uvw";
  for (const char j : axes) {
    for (const char k : {'x', 'y', 'z'}) names.push_back(fmt::format("s_{}{}", j, k));
  }
  for (const char j : axes) names.push_back(fmt::format("O_{}", j));
  for (const char j : axes) names.push_back(fmt::format("|s_{}|", j));
  names.insert(names.end(), {"phi_uv", "phi_vw", "phi_wu"});
  for (const char j : axes) names.push_back(fmt::format("k2_{}", j));
  for (const char j : axes) names.push_back(fmt::format("k3_{}", j));
  names.insert(names.end(), {"Zx", "Zy", "Xz", "d2", "d3", "F_X", "F_Z"});
  for (const char j : axes) names.push_back(fmt::format("b_{}", j));
  names.push_back("f");
  return names;
}

/// Readings by the literal equations of docs/theory/model.md (the fit turns gravity instead, with closed
/// forms of its own): every row of the matrix is turned with the stage, and gravity acts on its z component.
Eigen::Vector3d readings_at(const Truth& truth, int experiment, int n, Angle alpha, double t) {
  const AcsErrors& acs = truth.acs;
  const Eigen::Vector3d x = acs.alignment.x_axis();
  const Eigen::Vector3d z = acs.alignment.z_axis();
  const Angle quarter = Angle::degrees(-90.0);
  const Angle actual = alpha + acs.rotation_error(experiment, n);
  Eigen::Vector3d out;
  for (int j = 0; j < 3; ++j) {
    Eigen::Vector3d s = truth.accelerometer.sensitivity_matrix.row(j);
    if (experiment == 1) {
      s = rodrigues(s, x, actual);
    } else if (experiment == 2) {
      s = rodrigues(rodrigues(s, z, quarter + acs.d2), x, actual);
    } else {
      s = rodrigues(rodrigues(s, x, quarter + acs.d3), rodrigues(z, x, quarter + acs.d3), actual);
    }
    const double l = s.z();  // linear response less offset
    out(j) = truth.accelerometer.offset(j) +
             l * (1.0 + l * (truth.accelerometer.k2(j) + l * truth.accelerometer.k3(j))) +
             truth.accelerometer.drift(j) * t;
  }
  return out;
}

Truth draw_truth(const JointStudyOptions& options, TrialNormals& normal) {
  Truth truth;
  Eigen::Matrix3d platter;
  for (int j = 0; j < 3; ++j) {
    for (int k = 0; k < 3; ++k) {
      platter(j, k) = j == k ? 1.0 + options.diagonal_sd * normal() : options.off_diagonal_sd * normal();
    }
  }
  AccelerometerModel& aut = truth.accelerometer;
  for (int j = 0; j < 3; ++j) aut.offset(j) = options.off_diagonal_sd * normal() * options.scale;
  for (int j = 0; j < 3; ++j) aut.k2(j) = options.k * normal() / options.scale;
  for (int j = 0; j < 3; ++j) aut.k3(j) = options.k * normal() / (options.scale * options.scale);
  for (int j = 0; j < 3; ++j) aut.drift(j) = options.drift * normal() * options.scale;
  const Tolerances& tolerances = options.tolerances;
  const double alignment = sincos(tolerances.alignment).sin;
  truth.acs.alignment = {alignment * normal(), alignment * normal(), alignment * normal()};
  truth.acs.d2 = tolerances.initial_turn * normal();
  truth.acs.d3 = tolerances.initial_turn * normal();
  truth.acs.mean_step_x = tolerances.zero * normal();
  truth.acs.mean_step_z = tolerances.zero * normal();
  for (auto& list : truth.acs.step_errors) {
    for (int n = 0; n < options.steps; ++n) list.push_back(tolerances.step * normal());
    if (options.joint.one_map_per_axis && &list == &truth.acs.step_errors[1]) list = truth.acs.step_errors[0];
  }
  aut.sensitivity_matrix = options.scale * tilted(platter, truth.acs.alignment);
  return truth;
}

RunRecord simulated_run(const JointStudyOptions& options, const Truth& truth, TrialNormals& normal) {
  RunRecord record;
  record.source = "joint study";
  record.tolerances = without_further_effects(options.tolerances);
  record.steps = options.steps;
  record.step = Angle::degrees(360.0 / options.steps);
  const double noise = options.noise * options.scale;
  const int last = 3 * options.steps - 1;
  for (int i = 0; i <= last; ++i) {
    DwellRecord dwell;
    dwell.experiment = i / options.steps + 1;
    dwell.n = i % options.steps + 1;
    dwell.alpha = record.step * static_cast<double>(dwell.n - 1);
    const double t = static_cast<double>(i) / static_cast<double>(last) - 0.5;
    dwell.mean = readings_at(truth, dwell.experiment, dwell.n, dwell.alpha, t);
    for (int j = 0; j < 3; ++j) dwell.mean(j) += noise * normal();
    dwell.u_mean = Eigen::Vector3d::Constant(noise);
    record.dwells.push_back(dwell);
  }
  return record;
}

/// Plain ABC on a uniform full circle, where sums of sines and cosines are the least-squares fit.
AbcOutputs plain_abc(const RunRecord& record) {
  AbcCoefficients coefficients = AbcCoefficients::Zero();
  const double weight = 1.0 / record.steps;
  for (const DwellRecord& dwell : record.dwells) {
    const SinCos a = sincos(dwell.alpha);
    for (int j = 0; j < 3; ++j) {
      coefficients(abc_index(dwell.experiment, j, kA)) += 2.0 * weight * a.sin * dwell.mean(j);
      coefficients(abc_index(dwell.experiment, j, kB)) += 2.0 * weight * a.cos * dwell.mean(j);
      coefficients(abc_index(dwell.experiment, j, kC)) += weight * dwell.mean(j);
    }
  }
  return abc_outputs(coefficients);
}

/// The measurand: the least-squares line over all directions of gravity, of an item with k2 and k3.
struct LineResponse {
  Eigen::Matrix3d sensitivity_matrix;
  Eigen::Vector3d offset;
};
LineResponse line_response(const AccelerometerModel& aut) {
  const Eigen::Vector3d squares = aut.sensitivity_matrix.rowwise().squaredNorm();
  LineResponse out{aut.sensitivity_matrix, aut.offset};
  for (int j = 0; j < 3; ++j) {
    out.sensitivity_matrix.row(j) *= 1.0 + 0.6 * aut.k3(j) * squares(j);
    out.offset(j) += aut.k2(j) * squares(j) / 3.0;
  }
  return out;
}

TrialOutput compare(const Quantity& found, double truth, double abc = kNan) {
  const double error = found.value - truth;
  const double u = found.standard_uncertainty;
  return {std::abs(error) <= kCoverageFactor * u ? 1.0 : 0.0, error * error, u * u,
          (abc - truth) * (abc - truth)};
}

Trial run_trial(const JointStudyOptions& options, std::uint64_t index) {
  TrialNormals normal(options.seed, index);
  const Truth truth = draw_truth(options, normal);
  const RunRecord record = simulated_run(options, truth, normal);
  JointOptions joint_options = options.joint;
  joint_options.noise_process = false;  // the simulated noise is white
  const CalibrationResult result = analyse_joint(record, joint_options);
  Trial trial;
  if (!result.joint || !result.sensitivity_matrix) return trial;
  trial.solved = true;
  trial.usable = result.verdict == Verdict::kUsable;
  trial.nonlinearity_fitted = result.joint->nonlinearity_fitted;
  trial.chi2_per_dof = result.diagnostics.chi2.value_or(kNan) / result.diagnostics.degrees_of_freedom;
  trial.iterations = result.joint->iterations;

  const AbcOutputs abc = plain_abc(record);
  const IntrinsicProperties abc_intrinsic = intrinsic_properties(sensitivity_matrix_of(abc));
  const AccelerometerModel& aut = truth.accelerometer;
  const LineResponse line = line_response(aut);
  const IntrinsicProperties true_intrinsic = intrinsic_properties(line.sensitivity_matrix);
  const JointResult& joint = *result.joint;
  auto& out = trial.outputs;
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      const int row = static_cast<int>(j);
      const int col = static_cast<int>(k);
      out.push_back(compare((*result.sensitivity_matrix)[j][k], line.sensitivity_matrix(row, col),
                            abc(s_index(row, col))));
    }
  }
  const auto triple = [&](const std::array<Quantity, 3>& found, const Eigen::Vector3d& expected,
                          const Eigen::Vector3d& plain) {
    for (std::size_t j = 0; j < 3; ++j) {
      const auto at = static_cast<Eigen::Index>(j);
      out.push_back(compare(found[j], expected(at), plain(at)));
    }
  };
  const Eigen::Vector3d none = Eigen::Vector3d::Constant(kNan);
  triple(result.offset, line.offset, offset_of(abc));
  triple(result.intrinsic_sensitivity, true_intrinsic.sensitivity, abc_intrinsic.sensitivity);
  triple(result.intrinsic_angle, true_intrinsic.angle_deg, abc_intrinsic.angle_deg);
  triple(joint.k2, aut.k2, none);
  triple(joint.k3, aut.k3, none);
  triple(joint.alignment, {truth.acs.alignment.zx, truth.acs.alignment.zy, truth.acs.alignment.xz}, none);
  triple({joint.initial_turn_error[0], joint.initial_turn_error[1], joint.mean_step_error[0]},
         {truth.acs.d2.deg(), truth.acs.d3.deg(), truth.acs.mean_step_x.deg()}, none);
  triple({joint.mean_step_error[1], joint.drift[0], joint.drift[1]},
         {truth.acs.mean_step_z.deg(), aut.drift(0), aut.drift(1)}, none);
  out.push_back(compare(joint.drift[2], aut.drift(2)));
  TrialOutput steps;
  double count = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t n = 0; n < joint.step_error[i].size(); ++n) {
      const TrialOutput one = compare(joint.step_error[i][n], truth.acs.step_errors[i][n].deg());
      steps.covered += one.covered;
      steps.squared_error += one.squared_error;
      steps.variance += one.variance;
      count += 1.0;
    }
  }
  steps.covered /= count;
  steps.squared_error /= count;
  steps.variance /= count;
  out.push_back(steps);
  return trial;
}

void check(const JointStudyOptions& options) {
  const auto require = [](bool holds, const std::string& message) {
    if (!holds) throw std::invalid_argument("joint study: " + message);
  };
  require(options.trials >= 1, fmt::format("{} trials; 1 or more are required", options.trials));
  require(options.threads >= 1, fmt::format("{} threads; 1 or more are required", options.threads));
  require(options.steps >= 5, fmt::format("{} angles an experiment; 5 or more are required", options.steps));
  const auto size = [&](double value, const char* name, bool may_be_zero) {
    require(std::isfinite(value) && (value > 0.0 || (may_be_zero && value == 0.0)),
            fmt::format("{} is {}; a finite number {} 0 is required", name, value, may_be_zero ? ">=" : ">"));
  };
  size(options.noise, "noise", false);
  size(options.scale, "scale", false);
  size(options.k, "k", true);
  size(options.drift, "drift", true);
  size(options.diagonal_sd, "spread of the diagonal", true);
  size(options.off_diagonal_sd, "spread of the off-diagonal elements", true);
  // A wrong size is reported here, not in the middle of the first trial.
  for (const EffectSizeKey& key : effect_size_keys())
    size(key.get(options.tolerances), std::string(key.key).c_str(), true);
}

}  // namespace

const JointStudyOutput& JointStudy::output(const std::string& name) const {
  for (const JointStudyOutput& one : outputs) {
    if (one.name == name) return one;
  }
  throw std::out_of_range("joint study: no output named " + name);
}

JointStudy run_joint_study(const JointStudyOptions& options) {
  check(options);
  std::vector<Trial> trials(static_cast<std::size_t>(options.trials));
  std::atomic<std::size_t> next{0};
  std::exception_ptr failure;
  std::mutex failure_mutex;
  std::mutex progress_mutex;
  const auto work = [&] {
    try {
      while (!options.stop.stop_requested()) {
        const std::size_t i = next++;
        if (i >= trials.size()) break;
        trials[i] = run_trial(options, i);
        if (options.progress && i % 16 == 0) {
          const std::lock_guard lock(progress_mutex);
          options.progress(static_cast<int>(i) + 1, options.trials);
        }
      }
    } catch (...) {
      const std::lock_guard lock(failure_mutex);
      failure = std::current_exception();  // rethrown below
      next = trials.size();
    }
  };
  {
    std::vector<std::jthread> helpers;
    for (int i = 1; i < options.threads; ++i) helpers.emplace_back(work);
    work();
  }
  if (failure) std::rethrow_exception(failure);
  // Every trial that was started was completed: after an interrupt the first trials remain, without a gap.
  trials.resize(std::min(trials.size(), next.load()));
  if (trials.empty()) throw std::runtime_error("joint study: interrupted before its first trial");

  // Trials are summed in their order, whichever thread computed them.
  JointStudy study;
  study.options = options;
  study.trials = static_cast<int>(trials.size());
  study.interrupted = study.trials < options.trials;
  const std::vector<std::string> names = output_names();
  for (const std::string& name : names) study.outputs.push_back({.name = name});
  int solved = 0;
  for (const Trial& trial : trials) {
    if (!trial.solved) {
      ++study.failed;
      continue;
    }
    ++solved;
    study.nonlinearity_fitted += trial.nonlinearity_fitted ? 1 : 0;
    study.not_usable_or_doubtful += trial.usable ? 0 : 1;
    study.mean_chi2_per_dof += trial.chi2_per_dof;
    study.mean_iterations += trial.iterations;
    for (std::size_t i = 0; i < names.size(); ++i) {
      const TrialOutput& one = trial.outputs[i];
      JointStudyOutput& sum = study.outputs[i];
      if (std::isnan(one.squared_error)) continue;  // left out of this trial's fit
      ++sum.trials;
      sum.coverage += one.covered;
      sum.rms_error += one.squared_error;
      sum.rms_uncertainty += one.variance;
      sum.abc_rms_error += one.abc_squared_error;
    }
  }
  study.mean_chi2_per_dof /= solved;
  study.mean_iterations /= solved;
  for (JointStudyOutput& output : study.outputs) {
    output.coverage /= output.trials;
    output.rms_error = std::sqrt(output.rms_error / output.trials);
    output.rms_uncertainty = std::sqrt(output.rms_uncertainty / output.trials);
    output.abc_rms_error = std::sqrt(output.abc_rms_error / output.trials);
  }
  return study;
}

}  // namespace abcal
