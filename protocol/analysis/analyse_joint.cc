#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "protocol/analysis/effect_fit.h"
#include "protocol/analysis/flagged_angles.h"
#include "protocol/analysis/intrinsic_properties.h"
#include "protocol/analysis/joint_data.h"
#include "protocol/analysis/joint_fit.h"
#include "protocol/analysis/joint_verdict.h"
#include "protocol/analysis/joint_work.h"
#include "protocol/analysis/objection.h"
#include "protocol/analysis/undetermined.h"
#include "protocol/analysis/unusable_data.h"
#include "protocol/analysis/voltmeter.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
/// 15 readings for 12 unknowns without a prior, and something to test them by.
constexpr std::size_t kFewestAngles = 5;
/// A process less probable than this is not told.
constexpr double kProcessTold = 0.5;
/// Standard uncertainties from which on a drift is told.
constexpr double kDriftTold = 3.0;

Quantity quantity(double value, double variance, double variance_b, std::string unit) {
  Quantity out;
  out.value = value;
  out.standard_uncertainty = std::sqrt(std::max(0.0, variance));
  out.type_b = std::sqrt(std::clamp(variance_b, 0.0, std::max(0.0, variance)));
  out.type_a = std::sqrt(std::max(0.0, variance - std::max(0.0, variance_b)));
  out.unit = std::move(unit);
  return out;
}

void fill_line_response(const EffectFit& fit, CalibrationResult& result) {
  const std::string unit = result.response_unit;
  const std::string per_g = unit + "/g_loc";
  const Covariance12& covariance = fit.covariance_line;
  const Covariance12& type_b = fit.covariance_line_type_b;
  const auto output = [&](Eigen::Index i, const std::string& of_unit) {
    Quantity out = quantity(fit.line(i), covariance(i, i), type_b(i, i), of_unit);
    out.degrees_of_freedom = fit.degrees_of_freedom(i);
    return out;
  };
  Eigen::Matrix3d s;
  result.sensitivity_matrix.emplace();
  for (Eigen::Index j = 0; j < 3; ++j) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      s(j, k) = fit.line(3 * j + k);
      (*result.sensitivity_matrix)[static_cast<std::size_t>(j)][static_cast<std::size_t>(k)] =
          output(3 * j + k, per_g);
    }
    result.offset[static_cast<std::size_t>(j)] = output(9 + j, unit);
  }
  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(s);
  const Covariance9 covariance9 = carried_covariance(jacobian, covariance);
  const Covariance9 type_b9 = carried_covariance(jacobian, type_b);
  // An intrinsic property has the degrees of freedom of the least known element that it is made of.
  const auto degrees = [&](Eigen::Index row) {
    double least = std::numeric_limits<double>::infinity();
    for (Eigen::Index i = 0; i < 12; ++i) {
      const double share = jacobian(row, i) * jacobian(row, i) * covariance(i, i);
      if (share > 0.05 * covariance9(row, row)) least = std::min(least, fit.degrees_of_freedom(i));
    }
    return least;
  };
  for (Eigen::Index j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    Quantity& norm = result.intrinsic_sensitivity[at] =
        quantity(intrinsic.sensitivity(j), covariance9(j, j), type_b9(j, j), per_g);
    norm.degrees_of_freedom = degrees(j);
    Quantity& angle = result.intrinsic_angle[at] =
        quantity(intrinsic.angle_deg(j), covariance9(3 + j, 3 + j), type_b9(3 + j, 3 + j), "degree");
    angle.degrees_of_freedom = degrees(3 + j);
  }
  result.covariance = covariance;
  result.covariance_type_b = type_b;
  result.covariance_type_a = covariance - type_b;
  result.covariance_intrinsic = covariance9;
  result.covariance_intrinsic_type_b = type_b9;
  result.covariance_intrinsic_type_a = covariance9 - type_b9;
}

/// Unknown "effect" of an output (-1: the stage), the i-th of it; -1 where it is not in the fit.
Eigen::Index place_of(const EffectFit& fit, std::string_view effect, int output, int i = 0) {
  for (std::size_t at = 0; at < fit.unknowns.size(); ++at) {
    if (fit.unknowns[at].effect == effect && fit.unknowns[at].output == output && i-- == 0)
      return static_cast<Eigen::Index>(at);
  }
  return -1;
}

Quantity unknown_quantity(const EffectFit& fit, Eigen::Index at, double factor, std::string unit) {
  if (at < 0) return {};
  Quantity out;
  out.value = fit.value(at) * factor;
  out.standard_uncertainty = std::sqrt(fit.covariance(at, at)) * std::abs(factor);
  out.unit = std::move(unit);
  return out;
}

/// K0 to K3 along the output's own axis, from s, O, k2, k3 at zero.
ModelEquation model_equation_of(const EffectFit& fit, const std::string& unit) {
  ModelEquation out;
  const auto count = static_cast<Eigen::Index>(fit.unknowns.size());
  static constexpr std::array<const char*, 4> kPer{"", "/g_loc", "/g_loc^2", "/g_loc^3"};
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    const Eigen::Index s = place_of(fit, "s", j);
    const Eigen::Vector3d row = fit.value.segment<3>(s);
    const double norm = row.norm();
    Eigen::Matrix<double, 4, Eigen::Dynamic> by = Eigen::Matrix<double, 4, Eigen::Dynamic>::Zero(4, count);
    Eigen::Vector4d value = Eigen::Vector4d::Zero();
    const Eigen::Index offset = place_of(fit, "O", j);
    value(0) = fit.value(offset);
    by(0, offset) = 1.0;
    value(1) = norm;
    for (Eigen::Index k = 0; k < 3; ++k) by(1, s + k) = row(k) / norm;
    for (int order = 2; order <= 3; ++order) {
      const Eigen::Index k = place_of(fit, order == 2 ? "k2" : "k3", j);
      if (k < 0) continue;
      value(order) = fit.value(k) * std::pow(norm, order);
      by(order, k) = std::pow(norm, order);
    }
    const double size = fit.unit(j);
    out.covariance[at] = size * size * carried_covariance(by, fit.covariance);
    for (int order = 0; order <= 3; ++order) {
      Quantity& k = out.k[at][static_cast<std::size_t>(order)];
      if (order >= 2 && place_of(fit, order == 2 ? "k2" : "k3", j) < 0) continue;
      k.value = size * value(order);
      k.standard_uncertainty = std::sqrt(out.covariance[at](order, order));
      k.unit = unit + kPer[static_cast<std::size_t>(order)];
    }
  }
  return out;
}

void fill_step_errors(const EffectFit& fit, const JointData& data, const RunRecord& record,
                      JointResult& out) {
  int largest_n = record.steps;
  for (const DwellRecord* dwell : data.dwells) {
    if (!dwell->closing) largest_n = std::max(largest_n, dwell->n);
  }
  for (auto& list : out.step_error) list.resize(static_cast<std::size_t>(std::max(0, largest_n)));
  for (std::size_t i = 0; i < data.readings.size(); ++i) {
    const DwellRecord& dwell = *data.dwells[i];
    if (dwell.closing || dwell.n < 1) continue;
    Quantity& f =
        out.step_error[static_cast<std::size_t>(dwell.experiment - 1)][static_cast<std::size_t>(dwell.n - 1)];
    f.value = fit.step_error[i] * kDegreesPerRadian;
    f.standard_uncertainty = fit.u_step_error[i] * kDegreesPerRadian;
    f.unit = "degree";
  }
}

JointResult joint_outputs(const EffectFit& fit, const std::string& unit) {
  JointResult out;
  static constexpr std::array<const char*, 3> kAlignment{"Zx", "Zy", "Xz"};
  for (std::size_t i = 0; i < 3; ++i)
    out.alignment[i] = unknown_quantity(fit, place_of(fit, kAlignment[i], -1), 1.0, "1");
  const auto angle = [&](const char* name) {
    return unknown_quantity(fit, place_of(fit, name, -1), kDegreesPerRadian, "degree");
  };
  out.initial_turn_error = {angle("d2"), angle("d3")};
  out.mean_step_error = {angle("F_X"), angle("F_Z")};
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    const double size = fit.unit(j);
    out.drift[at] = unknown_quantity(fit, place_of(fit, "drift", j), size, unit);
    out.k2[at] = unknown_quantity(fit, place_of(fit, "k2", j), 1.0 / size, "1/" + unit);
    out.k3[at] = unknown_quantity(fit, place_of(fit, "k3", j), 1.0 / (size * size), "1/" + unit + "^2");
    // Each half Legendre polynomial is 1/2 at the end of the run.
    const Eigen::Index first = place_of(fit, "drift", j);
    if (first < 0) continue;
    Quantity& end = out.drift_at_end[at];
    end.value = 0.5 * size * fit.value.segment<3>(first).sum();
    end.standard_uncertainty = 0.5 * size * std::sqrt(fit.covariance.block<3, 3>(first, first).sum());
    end.unit = unit;
  }
  out.nonlinearity_fitted = place_of(fit, "k2", 0) >= 0 || place_of(fit, "k3", 0) >= 0;
  out.iterations = fit.iterations;
  out.process_probability = fit.noise.process_probability;
  out.process_tau = fit.noise.tau;
  out.process_rho = fit.noise.rho;
  return out;
}

std::vector<EffectReading> effect_readings(const JointData& data, bool one_map_per_axis) {
  std::vector<EffectReading> out;
  std::map<std::pair<int, long long>, int> maps;
  for (std::size_t i = 0; i < data.readings.size(); ++i) {
    const JointReading& from = data.readings[i];
    EffectReading to{from.experiment, from.sin_alpha, from.cos_alpha, from.t, from.value, from.u, -1};
    if (one_map_per_axis) {
      // Modulo 360 degrees, to the microdegree, so that equal angles compare equal.
      const double alpha = data.dwells[i]->alpha.deg();
      const double turn = alpha - 360.0 * std::floor(alpha / 360.0);
      const std::pair key(from.experiment == 3 ? 1 : 0, std::llround(turn * 1e6) % 360'000'000LL);
      to.map = maps.try_emplace(key, static_cast<int>(maps.size())).first->second;
    }
    out.push_back(to);
  }
  return out;
}

/// A dead output has no sensitivity, and readings without scatter have no uncertainty.
std::vector<std::string> outputs_that_never_change(const std::vector<EffectReading>& readings) {
  std::vector<std::string> names;
  for (const auto& [j, name] : {std::pair{0, "u"}, {1, "v"}, {2, "w"}})
    if (std::all_of(readings.begin(), readings.end(),
                    [&, k = j](const EffectReading& at) { return at.value[k] == readings.front().value[k]; }))
      names.emplace_back(name);
  return names;
}

/// A first guess of noise that nobody stated: the fit replaces it.
void guess_noise(std::vector<EffectReading>& readings) {
  Eigen::Vector3d low = readings.front().value;
  Eigen::Vector3d high = low;
  for (const EffectReading& at : readings) {
    low = low.cwiseMin(at.value);
    high = high.cwiseMax(at.value);
  }
  const Eigen::Vector3d size = (0.5e-5 * (high - low)).cwiseMax(1e-300);
  for (EffectReading& at : readings) at.u = size;
}

void fill_gravity_of(const RunRecord& record, CalibrationResult& result) {
  result.g_loc.unit = "m/s2";
  if (!record.g_loc_known) return;
  result.g_loc.value = record.g_loc.value_mps2;
  result.g_loc.standard_uncertainty = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
  result.g_loc.type_b = result.g_loc.standard_uncertainty;
  result.g_loc_source = record.g_loc.source;
}

std::string words_about_noise(const EffectFit& fit, const RunRecord& record) {
  if (!(fit.noise.process_probability > kProcessTold) || fit.noise.tau == 0.0) return {};
  return fmt::format(
      "the readings of {} wander from angle to angle: {:.2g} times their uncertainty, correlated over some "
      "{:.0f} angles (probability {:.3f}); it is in the uncertainties",
      record.source.empty() ? "this run" : record.source, fit.noise.tau, fit.noise.rho,
      fit.noise.process_probability);
}

/// Where an offset drifted by more than its uncertainty explains: what O means then.
void note_drifts(CalibrationResult& result) {
  for (std::size_t j = 0; j < 3; ++j) {
    const Quantity& end = result.joint->drift_at_end[j];
    if (!(std::abs(end.value) > kDriftTold * end.standard_uncertainty)) continue;
    result.diagnostics.notes.push_back(fmt::format(
        "the offset of {} drifted: O_{} is its mean over the run; at the end of the run it was {:+.2g} "
        "{} from that (standard uncertainty {:.1g} {}), {:.6g} {}",
        "uvw"[j], "uvw"[j], end.value, end.unit, end.standard_uncertainty, end.unit,
        result.offset[j].value + end.value, end.unit));
  }
}

/// The verdict, its reasons and the notes.
void judge_joint(const EffectFit& fit, const JointWork& work, const RunRecord& record,
                 CalibrationResult& result) {
  const EffectFitOptions& options = work.options;
  const JointTests& tests = work.tests;
  Diagnostics& diagnostics = result.diagnostics;
  result.joint->effects = tests.effects;
  result.joint->contradicted_sizes = contradicted_sizes(tests);
  result.joint->norm_against_joint = tests.norm_against_joint;
  std::vector<std::string> contradictions;
  std::string about_chi2;
  if (options.white_known) {
    diagnostics.chi2 = fit.chi2;
    diagnostics.chi2_probability = tests.chi2_probability;
    about_chi2 = fmt::format("chi2 {:.4g} for {} degrees of freedom (probability {:.2g})", fit.chi2,
                             fit.chi2_degrees_of_freedom, tests.chi2_probability);
    if (!(tests.chi2_probability >= tests.level)) {
      contradictions.push_back(about_chi2 +
                               ": the model does not explain the readings within their uncertainties");
    }
  } else {
    const Eigen::Vector3d u = fit.noise.white.cwiseProduct(work.readings.front().u);
    about_chi2 = fmt::format(
        "the readings carry no uncertainty: noise {:.2g}, {:.2g}, {:.2g} {} estimated from the "
        "residuals, so chi2 cannot test the model",
        u(0), u(1), u(2), record.response_unit);
    diagnostics.notes.push_back(about_chi2);
  }
  for (std::string& words : contradictions_of(tests, record.response_unit))
    contradictions.push_back(std::move(words));
  const std::string about_nonlinearity =
      result.joint->nonlinearity_fitted ? "non-linearity fitted" : "non-linearity left out, as asked";
  diagnostics.notes.push_back(about_nonlinearity);
  note_drifts(result);
  if (!tests.norm_against_joint.done)
    diagnostics.notes.push_back("the norm fit could not be compared with this one: " +
                                tests.norm_against_joint.why_not);
  if (std::string words = words_about_noise(fit, record); !words.empty())
    diagnostics.notes.push_back(std::move(words));
  for (const Undetermined& outputs : undetermined_outputs(fit.shares, fit.covariance_line, fit.unit,
                                                          record.tolerances, EffectsAre::kEstimated))
    (outputs.doubtful ? contradictions : diagnostics.notes).push_back(outputs.words);
  if (!options.mean_step) {
    contradictions.push_back(
        "the mean step errors were left out, so the orientation about X is not what it seems");
  }
  if (contradictions.empty()) {
    result.verdict = Verdict::kUsable;
    result.why = fmt::format("{}; {}", about_chi2, about_nonlinearity);
  } else {
    result.verdict = Verdict::kDoubtful;
    result.why = fmt::format("{}; {}", fmt::join(contradictions, "; "), about_nonlinearity);
  }
}

/// The solution, or why there is none.
std::optional<EffectSolution> solve_or_reason(std::span<const EffectReading> readings,
                                              const EffectFitOptions& options, std::string& why) {
  try {
    EffectSolution solution = solve_effects(readings, options);
    if (solution.fit.converged) return solution;
    why = fmt::format(
        "the joint fit did not converge ({} iterations): the readings are not those of the three "
        "experiments, or their angles are wrong",
        solution.fit.iterations);
  } catch (const UnusableData& error) {
    why = error.what();
  }
  return std::nullopt;
}

/// Noise from angle to angle of which the norm of the readings shows nothing is none of the outputs: it turns
/// them alike, as errors of the stage do that are larger than stated. The fit without that noise says which.
std::vector<std::string> hidden_by_process(std::span<const EffectReading> readings, const EffectFit& fit,
                                           const EffectFitOptions& options, const JointTests& tests,
                                           const std::string& response_unit) {
  constexpr double kNormIsSound = 1e-3;
  constexpr double kNormWanders = 3.0;  // standard deviations
  const bool wanders = fit.noise.process_probability > kProcessTold && fit.noise.tau > 0.0;
  const SpecificationTest& norm = tests.norm_against_joint;
  if (!options.white_known || !wanders || !norm.done || !(norm.norm_probability >= kNormIsSound) ||
      norm.norm_autocorrelation > kNormWanders)
    return {};
  EffectFitOptions white = options;
  white.noise_process = false;
  std::string why;
  const std::optional<EffectSolution> solution = solve_or_reason(readings, white, why);
  if (!solution) return {};
  const EffectFit& without = solution->fit;
  const JointTests again = test_joint_fit(readings, without, white);
  std::vector<std::string> found = contradictions_of(again, response_unit);
  if (!(again.chi2_probability >= again.level))
    found.push_back(
        fmt::format("chi2 {:.4g} for {} degrees of freedom", without.chi2, without.chi2_degrees_of_freedom));
  if (found.empty()) return {};
  return {fmt::format(
      "the readings wander from angle to angle, but their norm does not: the stage does more than "
      "is stated (without that noise: {})",
      fmt::join(found, "; "))};
}

}  // namespace

JointWork fit_jointly(const RunRecord& record, const JointOptions& options) {
  JointWork work;
  work.data = collect_joint_data(record, false);
  work.options = {.sizes = record.tolerances,
                  .measured_alignment = options.measured_alignment,
                  .nonlinearity = options.nonlinearity == Nonlinearity::kFitted,
                  .drift = options.drift,
                  .mean_step = options.mean_step,
                  .noise_process = options.noise_process,
                  .white_known = work.data.u_known};
  if (work.data.readings.size() < kFewestAngles) {
    work.why = fmt::format("{} usable angles; the joint estimator needs {} or more",
                           work.data.readings.size(), kFewestAngles);
    return work;
  }
  work.readings = effect_readings(work.data, options.one_map_per_axis);
  if (const auto still = outputs_that_never_change(work.readings); !still.empty()) {
    work.why = fmt::format("accelerometer {} does not respond: the same value at every angle",
                           fmt::join(still, ", "));
    return work;
  }
  if (!work.data.u_known) guess_noise(work.readings);
  work.solution = solve_or_reason(work.readings, work.options, work.why);
  if (!work.solution) return work;
  const EffectFit& fit = work.solution->fit;
  work.tests = test_joint_fit(work.readings, fit, work.options);
  work.hidden = hidden_by_process(work.readings, fit, work.options, work.tests, record.response_unit);
  return work;
}

CalibrationResult joint_result(const RunRecord& record, const JointWork& work, const EffectFit& fit) {
  CalibrationResult result;
  result.estimator = "joint";
  result.source = record.source;
  result.response_unit = record.response_unit;
  result.why = work.why;
  fill_gravity_of(record, result);
  Diagnostics& diagnostics = result.diagnostics;
  const JointData& data = work.data;
  diagnostics.angles_used = static_cast<int>(data.readings.size());
  count_flags(record, diagnostics);
  if (data.clipped > 0) diagnostics.notes.push_back(fmt::format("{} clipped angles left out", data.clipped));
  if (data.stuck > 0)
    diagnostics.notes.push_back(fmt::format("{} angles with a stuck output left out", data.stuck));
  if (data.not_finite > 0) {
    diagnostics.notes.push_back(fmt::format("{} angles without finite readings left out", data.not_finite));
  }
  if (!work.solution) return result;

  fill_line_response(fit, result);
  result.unstated_effects = unstated_effects(record.tolerances);
  result.model_equation = model_equation_of(fit, record.response_unit);
  result.joint = joint_outputs(fit, record.response_unit);
  result.joint->shares = fit.shares;
  fill_step_errors(fit, data, record, *result.joint);
  diagnostics.degrees_of_freedom = fit.chi2_degrees_of_freedom;
  diagnostics.reciprocal_condition = fit.reciprocal_condition;
  diagnostics.rank = static_cast<int>(fit.unknowns.size());
  judge_joint(fit, work, record, result);
  for (const std::string& words : work.hidden) {
    object_to(result, words);
    result.joint->contradicted_sizes.push_back(words);
  }
  object_to_flags(record, kSuspectFlags & ~kLeftOutFlags, result);
  add_voltmeter(record.tolerances, result);  // After the checks: no reading shows it.
  return result;
}

CalibrationResult joint_result(const RunRecord& record, const JointWork& work) {
  const EffectFit none;
  return joint_result(record, work, work.solution ? work.solution->fit : none);
}

CalibrationResult analyse_joint(const RunRecord& record, const JointOptions& options) {
  return joint_result(record, fit_jointly(record, options));
}

}  // namespace abcal
