#include "app/laboratory/certificate/derived.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numbers>
#include <stdexcept>
#include <unsupported/Eigen/AutoDiff>

#include "app/formats/typed_unit.h"
#include "app/results/analysis/report_data.h"
#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

using Gradient = Eigen::Matrix<double, 13, 1>;
using Real = Eigen::AutoDiffScalar<Gradient>;  // a number with its derivatives

/// The twelve outputs and g_loc as numbers that carry their derivatives along.
struct Inputs {
  std::array<std::array<Real, 3>, 3> s;
  std::array<Real, 3> offset;
  Real g_loc;
  Eigen::Matrix3d mounting;

  Inputs(const CalibrationResult& result, const Eigen::Matrix3d& stated) : mounting(stated) {
    int i = 0;
    const auto input = [&i](double value) { return Real(value, 13, i++); };
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t k = 0; k < 3; ++k) s[j][k] = input((*result.sensitivity_matrix)[j][k].value);
    for (std::size_t j = 0; j < 3; ++j) offset[j] = input(result.offset[j].value);
    g_loc = input(result.g_loc.value);
  }

  Real norm(std::size_t j) const { return sqrt(dot(j, j)); }
  Real dot(std::size_t i, std::size_t j) const {
    return s[i][0] * s[j][0] + s[i][1] * s[j][1] + s[i][2] * s[j][2];
  }
  /// Component of row j along the stated direction of output k.
  Real along(std::size_t j, std::size_t k) const {
    const auto row = static_cast<Eigen::Index>(k % 3);
    return s[j][0] * mounting(row, 0) + s[j][1] * mounting(row, 1) + s[j][2] * mounting(row, 2);
  }
  /// Root of the sum of squares of the components across the stated direction.
  Real transverse(std::size_t j) const {
    const Real a = along(j, j + 1), b = along(j, j + 2);
    return sqrt(Real(a * a + b * b));
  }
  /// Magnitude of the component along the stated direction.
  Real diagonal(std::size_t j) const {
    const Real of = along(j, j);
    return of.value() < 0.0 ? Real(-of) : of;
  }
};

class Deriver {
 public:
  Deriver(const CalibrationResult& result, const DeriveFrom& from)
      : result_(result), from_(from), inputs_(result, from.mounting) {}

  const Inputs& inputs() const { return inputs_; }

  DerivedQuantity quantity(const std::string& name, const std::string& unit, const Real& value) const {
    DerivedQuantity derived;
    derived.name = name;
    derived.gradient = value.derivatives();
    derived.value.unit = unit;
    derived.value.value = value.value();
    const auto propagated = [&](const std::optional<Covariance12>& covariance) -> std::optional<double> {
      if (!covariance) return std::nullopt;
      const auto outputs = derived.gradient.head<12>();
      return std::max(0.0, outputs.dot(*covariance * outputs));
    };
    // Local gravity is known from elsewhere: not correlated with the outputs, and of type B.
    const double by_gravity = std::pow(derived.gradient[12] * result_.g_loc.standard_uncertainty, 2);
    if (const auto a = propagated(result_.covariance_type_a)) derived.value.type_a = std::sqrt(*a);
    if (const auto b = propagated(result_.covariance_type_b))
      derived.value.type_b = std::sqrt(*b + by_gravity);
    derived.value.standard_uncertainty = std::sqrt(*propagated(result_.covariance) + by_gravity);
    derived.value.degrees_of_freedom = least_degrees(derived);
    return derived;
  }

  /// One quantity for each axis or pair.
  DerivedGroup triple(const std::string& name, const Message& words, const std::string& unit,
                      const std::array<const char*, 3>& of,
                      const std::function<Real(std::size_t)>& value) const {
    DerivedGroup group{name, words, {}};
    for (std::size_t j = 0; j < 3; ++j)
      group.quantities.push_back(quantity(name + "_" + of[j], unit, value(j)));
    return group;
  }

 private:
  /// A derived quantity has the degrees of freedom of the least known output that it is made of, as the
  /// intrinsic properties have.
  double least_degrees(const DerivedQuantity& derived) const {
    constexpr double kShare = 0.05;
    double least = std::numeric_limits<double>::infinity();
    const Covariance12& measured = from_.measured ? *from_.measured : *result_.covariance;
    const auto outputs = derived.gradient.head<12>();
    const double variance = outputs.dot(measured * outputs) +
                            std::pow(derived.gradient[12] * result_.g_loc.standard_uncertainty, 2);
    for (Eigen::Index i = 0; i < 12; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const Quantity& output = i < 9 ? (*result_.sensitivity_matrix)[at / 3][at % 3] : result_.offset[at - 9];
      const double share = std::pow(derived.gradient[i], 2) * measured(i, i);
      if (share > kShare * variance) least = std::min(least, output.degrees_of_freedom);
    }
    return least;
  }

  const CalibrationResult& result_;
  const DeriveFrom& from_;
  Inputs inputs_;
};

/// Uncertainty of a component across the stated direction, relative to that along it.
double u_across(const Deriver& deriver, const CalibrationResult& result, std::size_t j, std::size_t k) {
  const Inputs& in = deriver.inputs();
  const Real ratio = in.along(j, k) / in.diagonal(j);
  const auto gradient = ratio.derivatives().head<12>();
  return std::sqrt(std::max(0.0, gradient.dot(*result.covariance * gradient)));
}

/// Whether a magnitude is so small that its direction is not known.
bool has_no_direction(const Quantity& magnitude) {
  return !(magnitude.value > kCoverageFactor * magnitude.standard_uncertainty);
}

/// A small magnitude has no direction, and a derivative that depends on chance: its uncertainty is that of
/// its two components.
/// @param scale  of the magnitude, relative to the sensitivity along the stated direction
void take_both_components(DerivedGroup& group, const Deriver& deriver, const CalibrationResult& result,
                          double scale) {
  for (std::size_t j = 0; j < 3; ++j) {
    DerivedQuantity& quantity = group.quantities[j];
    const double both = scale * std::hypot(u_across(deriver, result, j, j + 1),  //
                                           u_across(deriver, result, j, j + 2));
    if (quantity.value.value > kCoverageFactor * both) continue;
    quantity.value.standard_uncertainty = both;
    quantity.value.type_a = quantity.value.type_b = std::nullopt;
    quantity.gradient.setZero();
  }
}

DerivedGroup azimuth(const Deriver& deriver, const DerivedGroup& transverse) {
  const Inputs& in = deriver.inputs();
  DerivedGroup group = deriver.triple(
      "transverse_azimuth",
      Message("Direction of the transverse sensitivity about the stated direction, from that of the next "
              "output: of u from v towards w, of v from w towards u, of w from u towards v"),
      "degree", kOutputNames,
      [&](std::size_t j) { return Real(atan2(in.along(j, j + 2), in.along(j, j + 1)) / kDegree); });
  for (std::size_t j = 0; j < 3; ++j) {
    if (!has_no_direction(transverse.quantities[j].value)) continue;
    group.quantities[j].value = Quantity{};  // any direction is as likely as any other
    group.quantities[j].value.unit = "degree";
  }
  return group;
}

DerivedGroup sensitivity_rows(const Deriver& deriver, const std::string& name, const Message& words,
                              const std::string& unit, const Real& per) {
  DerivedGroup group{name, words, {}};
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      group.quantities.push_back(
          deriver.quantity(std::string("sensitivity_") + kOutputNames[j] + kPlatterAxes[k], unit,
                           Real(deriver.inputs().s[j][k] * per)));
    }
  }
  return group;
}

std::string per_si(const std::string& unit) {
  return TypedUnit{unit, PerAcceleration::kSi}.name();
}

}  // namespace

SensitivityUnit sensitivity_unit(const std::string& name, const std::string& response_unit) {
  const auto refuse = [&](const std::string& why) {
    throw std::invalid_argument("unit \"" + name + "\": " + why);
  };
  const TypedUnit unit = typed_unit(name);
  if (unit.per == PerAcceleration::kUnnamed)
    refuse("g may be standard or local gravity; required: \"" + readings_of(unit).front().name() +
           "\", which is per standard gravity, 9.80665 m/s2");
  if (unit.per != PerAcceleration::kSi && unit.per != PerAcceleration::kStandard)
    refuse("required: OUTPUT/g_n (standard gravity) or OUTPUT/(m/s2)");
  const auto ratio = unit_ratio(response_unit, unit.output);
  if (!ratio) refuse("the output is in " + response_unit + ", which cannot be given in it");
  return {name, *ratio, unit.per == PerAcceleration::kStandard};
}

std::vector<DerivedGroup> derive(const CalibrationResult& result, const DeriveFrom& from) {
  if (!result.sensitivity_matrix || !result.covariance)
    throw std::invalid_argument("nothing can be derived from a result without a sensitivity matrix");
  if (!std::isfinite(result.g_loc.value) || !std::isfinite(result.g_loc.standard_uncertainty))
    throw std::invalid_argument("local gravity is not known, so that nothing can be given per m/s2");
  const Deriver deriver(result, from);
  const Inputs& in = deriver.inputs();
  const std::string& unit = result.response_unit;
  const Real one_per_gravity = Real(1.0) / in.g_loc;

  std::vector<DerivedGroup> groups;
  groups.push_back(sensitivity_rows(deriver, "sensitivity", Message("Sensitivity matrix in SI units"),
                                    per_si(unit), one_per_gravity));
  groups.push_back(deriver.triple("intrinsic_sensitivity", Message("Intrinsic sensitivity in SI units"),
                                  per_si(unit), kOutputNames,
                                  [&](std::size_t j) { return Real(in.norm(j) * one_per_gravity); }));
  groups.push_back(deriver.triple(
      "transverse_sensitivity",
      Message("Transverse sensitivity (ISO 16063-31), relative to the sensitivity along the stated direction "
              "on the platter; it contains the mounting"),
      "%", kOutputNames, [&](std::size_t j) { return Real(100.0 * in.transverse(j) / in.diagonal(j)); }));
  take_both_components(groups.back(), deriver, result, 100.0);
  groups.push_back(azimuth(deriver, groups.back()));
  groups.push_back(deriver.triple(
      "misalignment", Message("Angle between the sensitive direction and the stated one on the platter"),
      "mrad", kOutputNames,
      [&](std::size_t j) { return Real(1e3 * atan2(in.transverse(j), in.diagonal(j))); }));
  take_both_components(groups.back(), deriver, result, 1e3);
  groups.push_back(deriver.triple("non_orthogonality", Message("Intrinsic angle minus 90 degrees"), "mrad",
                                  kOutputPairs, [&](std::size_t j) {
                                    const std::size_t k = (j + 1) % 3;
                                    // asin would lose digits near 90 degrees of angle; the angle from a right
                                    // one is a ratio of these two.
                                    const Real cosine = in.dot(j, k) / Real(in.norm(j) * in.norm(k));
                                    return Real(-1e3 * atan2(cosine, sqrt(Real(1.0 - cosine * cosine))));
                                  }));
  groups.push_back(deriver.triple(
      "bias", Message("Offset as an acceleration, in units of standard gravity g = 9.80665 m/s2"), "mg",
      kOutputNames,
      [&](std::size_t j) { return Real(in.offset[j] / in.norm(j) * in.g_loc * (1e3 / kStandardGravity)); }));
  for (const SensitivityUnit& wanted : from.units) {
    const double factor = wanted.output_factor * (wanted.per_standard_gravity ? kStandardGravity : 1.0);
    const Message words =
        wanted.per_standard_gravity
            ? Message("Sensitivity in {unit}, g_n = 9.80665 m/s2 (standard gravity)", wanted.name)
            : Message("Sensitivity in {unit}", wanted.name);
    DerivedGroup group =
        deriver.triple("intrinsic_sensitivity", words, wanted.name, kOutputNames,
                       [&](std::size_t j) { return Real(in.norm(j) * one_per_gravity * factor); });
    group.name = "sensitivity [" + wanted.name + "]";
    groups.push_back(std::move(group));
  }
  return groups;
}

DerivedQuantity derived_quantity(const CalibrationResult& result, const DeriveFrom& from,
                                 const std::string& name, const std::string& unit,
                                 const ValueWithGradient& value) {
  return Deriver(result, from).quantity(name, unit, Real(value.value, value.gradient));
}

double covariance_of(const CalibrationResult& result, const DerivedQuantity& a, const DerivedQuantity& b) {
  return a.gradient.head<12>().dot(*result.covariance * b.gradient.head<12>()) +
         a.gradient[12] * b.gradient[12] * std::pow(result.g_loc.standard_uncertainty, 2);
}

QuantityRange range_of_quantity(const std::string& name, const std::string& unit) {
  constexpr double kFar = std::numeric_limits<double>::infinity();
  const auto degrees = [&](double least, double most) {
    const auto ratio = unit_ratio("degree", unit);
    return ratio ? QuantityRange{least * *ratio, most * *ratio} : QuantityRange{};
  };
  if (name.starts_with("intrinsic_sensitivity_") || name.starts_with("transverse_sensitivity_"))
    return {0.0, kFar};
  if (name.starts_with("intrinsic_angle_")) return degrees(0.0, 180.0);
  if (name.starts_with("misalignment_")) return degrees(0.0, 90.0);
  if (name.starts_with("non_orthogonality_")) return degrees(-90.0, 90.0);
  return {};
}

std::string to_string(const QuantityRange& range, const std::string& unit) {
  if (std::isinf(range.least))
    return std::isinf(range.most) ? "any" : fmt::format("{:.4g} {} or less", range.most, unit);
  return std::isinf(range.most) ? fmt::format("{:.4g} {} or more", range.least, unit)
                                : fmt::format("{:.4g} to {:.4g} {}", range.least, range.most, unit);
}

std::vector<std::string> names_of_quantities() {
  std::vector<std::string> names;
  for (const char* axis : kOutputNames)
    for (const char* platter : kPlatterAxes) names.push_back(std::string("sensitivity_") + axis + platter);
  for (const std::string of_axis :
       {"intrinsic_sensitivity_", "offset_", "transverse_sensitivity_", "misalignment_", "bias_"}) {
    for (const char* axis : kOutputNames) names.push_back(of_axis + axis);
  }
  for (const std::string of_pair : {"intrinsic_angle_", "non_orthogonality_"})
    for (const char* pair : kOutputPairs) names.push_back(of_pair + pair);
  return names;
}

}  // namespace abcal
