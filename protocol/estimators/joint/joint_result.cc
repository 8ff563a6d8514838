#include "protocol/estimators/joint/joint_result.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "protocol/estimators/joint/joint_verdict.h"
#include "protocol/estimators/shared/flagged_angles.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;

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
  return scaled_quantity(fit.value(at), fit.covariance(at, at), factor, std::move(unit));
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

void fill_step_errors(const EffectFit& fit, const CollectedReadings& data, const RunRecord& record,
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
  if (place_of(fit, "d1, face 2", -1) >= 0)
    out.turn_error_face_2 = {angle("d1, face 2"), angle("d2, face 2"), angle("d3, face 2")};
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

/// The rates of a run, each once, by rising size: those of sweeps within 1 % of each other are one.
std::vector<double> rates_of(const CollectedReadings& data) {
  constexpr double kSame = 0.01;
  std::vector<double> rates;
  for (const EffectReading& reading : data.readings)
    if (reading.sweep >= 0) rates.push_back(std::abs(reading.mean_rate_radps));
  std::ranges::sort(rates);
  const auto same = [](double a, double b) { return std::abs(b - a) < kSame * b; };
  rates.erase(std::unique(rates.begin(), rates.end(), same), rates.end());
  return rates;
}

MotionResult motion_outputs(const EffectFit& fit, const CollectedReadings& data, const std::string& unit) {
  MotionResult out;
  const auto own = [&](const char* effect, int j, int i, double factor, const char* in) {
    return unknown_quantity(fit, place_of(fit, effect, j, i), factor, in);
  };
  for (const double rate : rates_of(data)) {
    RateResponse& response = out.responses.emplace_back();
    response.rate_deg_per_s = rate * kDegreesPerRadian;
    response.frequency_hz = rate / (2.0 * std::numbers::pi);
    const double relative = rate / kReferenceRate;
    for (int j = 0; j < 3; ++j) {
      Eigen::RowVectorXd by = Eigen::RowVectorXd::Zero(fit.value.size());
      for (const auto& [effect, power] : {std::pair{"low-pass", 2}, {"low-pass, fourth power", 4}})
        if (const Eigen::Index at = place_of(fit, effect, j); at >= 0) by(at) = -std::pow(relative, power);
      const double variance = by * fit.covariance * by.transpose();
      Quantity& amplitude = response.amplitude[static_cast<std::size_t>(j)];
      amplitude.value = 1.0 + by.dot(fit.value);
      amplitude.standard_uncertainty = std::sqrt(variance);
      amplitude.unit = "1";
    }
    response.phase = own("phase", -1, 0, std::pow(relative, 3) * kDegreesPerRadian, "degree");
  }
  constexpr double kMmPerM = 1e3;
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    for (int k = 0; k < 3; ++k)
      out.position[at][static_cast<std::size_t>(k)] = own("apparent position", j, k, kMmPerM, "mm");
    out.delay_difference[at] = own("delay", j, 0, 1.0, "s");
    out.rate_offset[at] = own("offset with the rate", j, 0, fit.unit(j), unit.c_str());
  }
  out.delay = {own("delay about X", -1, 0, 1.0, "s"), own("delay about Z", -1, 0, 1.0, "s")};
  for (std::size_t axis = 0; axis < 2; ++axis) out.delay[axis].value += data.delay_s[axis];
  out.axes_distance = own("distance of the axes", -1, 0, kMmPerM, "mm");
  return out;
}

void fill_gravity_of(const RunRecord& record, CalibrationResult& result) {
  result.g_loc.unit = "m/s2";
  if (!record.g_loc_known) return;
  result.g_loc.value = record.g_loc.value_mps2;
  result.g_loc.standard_uncertainty = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
  result.g_loc.type_b = result.g_loc.standard_uncertainty;
  result.g_loc_source = record.g_loc.source;
}

}  // namespace

Quantity scaled_quantity(double value, double variance, double factor, std::string unit) {
  Quantity out;
  out.value = value * factor;
  out.standard_uncertainty = std::sqrt(variance) * factor;
  out.unit = std::move(unit);
  return out;
}

CalibrationResult joint_result(const RunRecord& record, const ItemFit& own, const EffectFit* common) {
  CalibrationResult result;
  result.estimator = "joint";
  result.source = record.source;
  result.response_unit = record.response_unit;
  result.why = own.why;
  fill_gravity_of(record, result);
  Diagnostics& diagnostics = result.diagnostics;
  const CollectedReadings& data = own.data;
  diagnostics.angles_used = static_cast<int>(data.readings.size());
  count_flags(record, diagnostics);
  if (data.clipped > 0)
    diagnostics.notes.push_back(Message("{angles} clipped angles left out", data.clipped));
  if (data.stuck > 0)
    diagnostics.notes.push_back(Message("{angles} angles with a stuck output left out", data.stuck));
  if (data.not_finite > 0) {
    diagnostics.notes.push_back(Message("{angles} angles without finite readings left out", data.not_finite));
  }
  if (!own.solution) return result;
  const EffectFit& fit = common != nullptr ? *common : own.solution->fit;

  fill_line_response(fit, result);
  result.unstated_effects = unstated_effects(record.tolerances);
  result.model_equation = model_equation_of(fit, record.response_unit);
  result.joint = joint_outputs(fit, record.response_unit);
  if (!data.sweeps.empty()) result.joint->motion = motion_outputs(fit, data, record.response_unit);
  result.joint->shares = fit.shares;
  fill_step_errors(fit, data, record, *result.joint);
  diagnostics.degrees_of_freedom = fit.chi2_degrees_of_freedom;
  diagnostics.reciprocal_condition = fit.reciprocal_condition;
  diagnostics.rank = static_cast<int>(fit.unknowns.size());
  judge_joint(fit, own, record, result);
  for (const Message& words : own.hidden) {
    object_to(result, words);
    result.joint->contradicted_sizes.push_back(words);
  }
  object_to_flags(record, kSuspectFlags & ~kLeftOutFlags, result);
  add_voltmeter(record.tolerances, result);  // After the checks: no reading shows it.
  return result;
}

}  // namespace abcal
