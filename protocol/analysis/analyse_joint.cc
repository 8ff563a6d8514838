#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "protocol/analysis/chi2_tail.h"
#include "protocol/analysis/intrinsic_properties.h"
#include "protocol/analysis/joint_data.h"
#include "protocol/analysis/joint_fit.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;

/// Below this probability chi2 contradicts the model.
constexpr double kChi2Level = kFalseAlarm;
/// The six k's are left out only where they lower chi2 by no more than their number, which is what six
/// useless unknowns do on the average: a run in which they mean anything keeps them (docs/joint_estimator.md
/// gives the coverage with weak non-linearity).
constexpr double kNonlinearityGain = 6.0;
/// An estimate this many prior standard deviations from its prior's mean contradicts the tolerance. The prior
/// is a statement about the bench; chi2 with its hundreds of degrees of freedom does not notice one wrong
/// statement.
constexpr double kPriorLevel = kFalseAlarmDeviate;
/// Autocorrelation of successive residuals, in standard deviations, that a model without error does not
/// reach.
constexpr double kAutocorrelationLevel = kFalseAlarmDeviate;

/// Correlation of successive residuals within an experiment, in standard deviations. A smooth error of the
/// model shows here even when the size of the noise is not known beforehand.
double residual_autocorrelation(const std::vector<JointReading>& readings, const JointFit& fit) {
  double products = 0.0;
  double squares = 0.0;
  double square_products = 0.0;
  std::array<const Eigen::Vector3d*, 3> previous{};  // of each experiment: maps may interleave them
  std::vector<Eigen::Vector3d> scaled(readings.size());
  for (std::size_t i = 0; i < readings.size(); ++i) {
    scaled[i] = fit.residuals[i].cwiseQuotient(readings[i].u);
    const Eigen::Vector3d*& before = previous[static_cast<std::size_t>(readings[i].experiment - 1)];
    if (before != nullptr) {
      // The three residuals of an angle are dependent (they share f): their sum of products is one draw.
      const double product = before->dot(scaled[i]);
      products += product;
      square_products += product * product;
    }
    squares += scaled[i].squaredNorm();
    before = &scaled[i];
  }
  // Noise-free readings leave rounding errors, which may well follow the angle.
  if (!(square_products > 0.0) || squares < 1e-3 * static_cast<double>(readings.size())) return 0.0;
  return products / std::sqrt(square_products);
}

Quantity quantity(double value, double variance, double variance_b, std::string unit) {
  Quantity out;
  out.value = value;
  out.standard_uncertainty = std::sqrt(std::max(0.0, variance));
  out.type_b = std::sqrt(std::clamp(variance_b, 0.0, std::max(0.0, variance)));
  out.type_a = std::sqrt(std::max(0.0, variance - std::max(0.0, variance_b)));
  out.unit = std::move(unit);
  return out;
}

/// Sensitivity and offset among the 28 unknowns, in the order of Covariance12.
Eigen::Index unknown_of_output(Eigen::Index output) {
  return output < 9 ? kOwnUnknowns * (output / 3) + output % 3 : kOwnUnknowns * (output - 9) + kOffsetIndex;
}

/// Gives `fit` the uncertainties of `wider`, except those of the unknowns that it leaves out.
void widen_outputs(const JointFit& wider, JointFit& fit) {
  fit.covariance = wider.covariance;
  fit.covariance_type_b = wider.covariance_type_b;
  fit.u_step_error = wider.u_step_error;
}

void fill_outputs(const JointFit& fit, CalibrationResult& result) {
  const std::string unit = result.response_unit;
  const std::string per_g = unit + "/g_loc";
  Covariance12 covariance;
  Covariance12 type_b;
  for (Eigen::Index a = 0; a < 12; ++a) {
    for (Eigen::Index b = 0; b < 12; ++b) {
      covariance(a, b) = fit.covariance(unknown_of_output(a), unknown_of_output(b));
      type_b(a, b) = fit.covariance_type_b(unknown_of_output(a), unknown_of_output(b));
    }
  }
  Eigen::Matrix3d s;
  result.sensitivity_matrix.emplace();
  for (Eigen::Index j = 0; j < 3; ++j) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      const Eigen::Index i = 3 * j + k;
      s(j, k) = fit.value(unknown_of_output(i));
      (*result.sensitivity_matrix)[static_cast<std::size_t>(j)][static_cast<std::size_t>(k)] =
          quantity(s(j, k), covariance(i, i), type_b(i, i), per_g);
    }
    result.offset[static_cast<std::size_t>(j)] =
        quantity(fit.value(unknown_of_output(9 + j)), covariance(9 + j, 9 + j), type_b(9 + j, 9 + j), unit);
  }
  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(s);
  const Covariance9 covariance9 = jacobian * covariance * jacobian.transpose();
  const Covariance9 type_b9 = jacobian * type_b * jacobian.transpose();
  for (Eigen::Index j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    result.intrinsic_sensitivity[at] =
        quantity(intrinsic.sensitivity(j), covariance9(j, j), type_b9(j, j), per_g);
    result.intrinsic_angle[at] =
        quantity(intrinsic.angle_deg(j), covariance9(3 + j, 3 + j), type_b9(3 + j, 3 + j), "degree");
  }
  result.covariance = covariance;
  result.covariance_type_b = type_b;
  result.covariance_type_a = covariance - type_b;
  result.covariance_intrinsic = covariance9;
  result.covariance_intrinsic_type_b = type_b9;
  result.covariance_intrinsic_type_a = covariance9 - type_b9;
}

JointResult joint_outputs(const JointFit& fit, const JointData& data, const JointModel& model,
                          const RunRecord& record) {
  JointResult out;
  const auto of = [&](int i, double factor, const std::string& unit) {
    return quantity(fit.value(i) * factor, fit.covariance(i, i) * factor * factor,
                    fit.covariance_type_b(i, i) * factor * factor, unit);
  };
  out.alignment = {of(kZx, 1.0, "1"), of(kZy, 1.0, "1"), of(kXz, 1.0, "1")};
  out.initial_turn_error = {of(kD2, kDegreesPerRadian, "degree"), of(kD3, kDegreesPerRadian, "degree")};
  if (model.mean_step) {
    out.mean_step_error = {of(kFX, kDegreesPerRadian, "degree"), of(kFZ, kDegreesPerRadian, "degree")};
  }
  const std::string& unit = record.response_unit;
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    if (model.drift) out.drift[at] = of(kOwnUnknowns * j + kDriftIndex, 1.0, unit);
    if (model.nonlinearity) {
      out.k2[at] = of(kOwnUnknowns * j + kK2Index, 1.0, "1/" + unit);
      out.k3[at] = of(kOwnUnknowns * j + kK3Index, 1.0, "1/" + unit + "^2");
    }
  }
  int largest_n = record.steps;
  for (const DwellRecord* dwell : data.dwells) {
    if (!dwell->closing) largest_n = std::max(largest_n, dwell->n);
  }
  for (auto& list : out.step_error) list.resize(static_cast<std::size_t>(std::max(0, largest_n)));
  for (std::size_t i = 0; i < data.readings.size(); ++i) {
    const DwellRecord& dwell = *data.dwells[i];
    if (dwell.closing || dwell.n < 1) continue;
    const auto step = static_cast<std::size_t>(data.readings[i].step_error);
    Quantity& f =
        out.step_error[static_cast<std::size_t>(dwell.experiment - 1)][static_cast<std::size_t>(dwell.n - 1)];
    f.value = fit.step_error[step] * kDegreesPerRadian;
    f.standard_uncertainty = fit.u_step_error[step] * kDegreesPerRadian;
    f.unit = "degree";
  }
  out.nonlinearity_fitted = model.nonlinearity;
  out.iterations = fit.iterations;
  return out;
}

/// Names of the unknowns that stand farther from their priors than the tolerances allow.
std::vector<std::string> contradicted_priors(const JointFit& fit, const JointPriors& priors,
                                             const JointModel& model, const Eigen::Vector3d& unit) {
  std::vector<std::string> out;
  const auto test = [&](const std::string& name, double deviation) {
    if (!(std::abs(deviation) <= kPriorLevel)) {
      out.push_back(fmt::format("{} is {:.1f} standard deviations from what the bench's tolerances say", name,
                                deviation));
    }
  };
  static constexpr const char* kNames[kGeometryUnknowns] = {"Zx", "Zy", "Xz", "d2", "d3", "F_X", "F_Z"};
  for (int i = 0; i < kGeometryUnknowns; ++i) {
    if (!model.mean_step && kZx + i >= kFX) continue;
    test(kNames[i], (fit.value(kZx + i) - priors.mean(i)) / priors.sd(i));
  }
  for (int j = 0; j < 3; ++j) {
    const int own = kOwnUnknowns * j;
    const char name = "uvw"[j];
    if (model.drift)
      test(fmt::format("drift of {}", name), fit.value(own + kDriftIndex) / (priors.drift * unit(j)));
    if (model.nonlinearity) {
      test(fmt::format("k2 of {}", name), fit.value(own + kK2Index) * unit(j) / priors.k2);
      test(fmt::format("k3 of {}", name), fit.value(own + kK3Index) * unit(j) * unit(j) / priors.k3);
    }
  }
  return out;
}

void add_flags(const RunRecord& record, Diagnostics& diagnostics) {
  for (std::uint32_t bit = 0; bit < 32; ++bit) {
    const std::uint32_t flag = 1U << bit;
    const auto dwells = std::count_if(record.dwells.begin(), record.dwells.end(),
                                      [&](const DwellRecord& dwell) { return (dwell.flags & flag) != 0U; });
    if (dwells > 0) diagnostics.flags.push_back({describe_flags(flag), static_cast<int>(dwells)});
  }
  diagnostics.angles_flagged =
      static_cast<int>(std::count_if(record.dwells.begin(), record.dwells.end(),
                                     [](const DwellRecord& dwell) { return dwell.flags != kFlagNone; }));
}

}  // namespace

CalibrationResult analyse_joint(const RunRecord& record, const JointOptions& options) {
  CalibrationResult result;
  result.estimator = "joint";
  result.source = record.source;
  result.response_unit = record.response_unit;
  if (record.g_loc_known) {
    result.g_loc.value = record.g_loc.value_mps2;
    result.g_loc.standard_uncertainty = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
    result.g_loc.type_b = result.g_loc.standard_uncertainty;
    result.g_loc_source = record.g_loc.source;
  }
  result.g_loc.unit = "m/s2";

  const JointPriors priors = JointPriors::from(record.tolerances, options.measured_alignment);
  JointData data = collect_joint_data(record, options.one_map_per_axis);
  Diagnostics& diagnostics = result.diagnostics;
  diagnostics.angles_used = static_cast<int>(data.readings.size());
  add_flags(record, diagnostics);
  if (data.clipped > 0) diagnostics.notes.push_back(fmt::format("{} clipped angles left out", data.clipped));
  if (data.not_finite > 0) {
    diagnostics.notes.push_back(fmt::format("{} angles without finite readings left out", data.not_finite));
  }
  if (data.readings.size() <
      5) {  // 15 readings for 12 unknowns without a prior, and something to test them by
    result.why = fmt::format("{} usable angles; the joint estimator needs 5 or more", data.readings.size());
    return result;
  }

  JointModel model{.nonlinearity = options.nonlinearity != Nonlinearity::kLeftOut,
                   .drift = options.drift,
                   .mean_step = options.mean_step};
  JointModel linear_model = model;
  linear_model.nonlinearity = false;
  JointFit fit;
  std::string about_nonlinearity;
  try {
    fit = data.u_known ? joint_fit(data.readings, priors, model)
                       : fit_with_unknown_noise(data.readings, priors, model);
    if (options.nonlinearity == Nonlinearity::kDecide && fit.converged) {
      const JointFit linear = joint_fit(data.readings, priors, linear_model);
      const double gain = linear.converged ? linear.chi2 - fit.chi2 : std::numeric_limits<double>::infinity();
      if (gain <= kNonlinearityGain) {
        // Not seen is not absent: k2 and k3 of their own uncertainty would still shift the result, so the
        // uncertainties stay those of the fit with them (only then does the coverage hold).
        const JointFit with_them = fit;
        model = linear_model;
        fit = data.u_known ? linear : fit_with_unknown_noise(data.readings, priors, model);
        if (fit.converged) widen_outputs(with_them, fit);
        about_nonlinearity = fmt::format(
            "non-linearity left out: k2 and k3 would lower chi2 by {:.3g} only; what they might be is in the "
            "uncertainties",
            gain);
      } else {
        about_nonlinearity =
            fmt::format("non-linearity fitted: without k2 and k3 chi2 is {:.4g} higher", gain);
      }
    } else {
      about_nonlinearity =
          model.nonlinearity ? "non-linearity fitted, as asked" : "non-linearity left out, as asked";
    }
  } catch (const std::runtime_error& error) {
    result.why = error.what();
    return result;
  }
  if (!fit.converged) {
    result.why = fmt::format(
        "the joint fit did not converge ({} iterations): the readings are not those of the three "
        "experiments, or their angles are wrong",
        fit.iterations);
    return result;
  }

  fill_outputs(fit, result);
  result.joint = joint_outputs(fit, data, model, record);
  diagnostics.degrees_of_freedom = fit.degrees_of_freedom;
  diagnostics.reciprocal_condition = fit.reciprocal_condition;
  diagnostics.rank =
      kJointUnknowns - (model.mean_step ? 0 : 2) - (model.drift ? 0 : 3) - (model.nonlinearity ? 0 : 6);

  std::vector<std::string> contradictions;
  std::string about_chi2;
  if (data.u_known) {
    const double probability = chi2_tail(fit.chi2, fit.degrees_of_freedom);
    diagnostics.chi2 = fit.chi2;
    diagnostics.chi2_probability = probability;
    about_chi2 = fmt::format("chi2 {:.4g} for {} degrees of freedom (probability {:.2g})", fit.chi2,
                             fit.degrees_of_freedom, probability);
    if (!(probability >= kChi2Level)) {
      contradictions.push_back(about_chi2 +
                               ": the model does not explain the readings within their uncertainties");
    }
  } else {
    Eigen::Vector3d u = data.readings.front().u;
    about_chi2 = fmt::format(
        "the readings carry no uncertainty: noise {:.2g}, {:.2g}, {:.2g} {} estimated from the "
        "residuals, so chi2 cannot test the model",
        u(0), u(1), u(2), record.response_unit);
    diagnostics.notes.push_back(about_chi2);
    const double correlation = residual_autocorrelation(data.readings, fit);
    if (std::abs(correlation) > kAutocorrelationLevel) {
      contradictions.push_back(
          fmt::format("successive residuals are correlated ({:.1f} standard deviations): the model does not "
                      "explain the readings",
                      correlation));
    }
  }
  diagnostics.notes.push_back(about_nonlinearity);
  for (std::string& text : contradicted_priors(
           fit, priors, model, intrinsic_properties(result.sensitivity_values()).sensitivity)) {
    contradictions.push_back(std::move(text));
  }
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
  return result;
}

}  // namespace abcal
