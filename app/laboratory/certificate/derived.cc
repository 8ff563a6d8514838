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

  explicit Inputs(const CalibrationResult& result) {
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
  /// Root of the sum of squares of the off-diagonal elements of a row.
  Real transverse(std::size_t j) const {
    const Real &a = s[j][(j + 1) % 3], &b = s[j][(j + 2) % 3];
    return sqrt(Real(a * a + b * b));
  }
  Real diagonal(std::size_t j) const { return s[j][j].value() < 0.0 ? Real(-s[j][j]) : s[j][j]; }
};

class Deriver {
 public:
  explicit Deriver(const CalibrationResult& result) : result_(result), inputs_(result) {}

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
    const double variance = std::pow(derived.value.standard_uncertainty, 2);
    for (Eigen::Index i = 0; i < 12; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const Quantity& output = i < 9 ? (*result_.sensitivity_matrix)[at / 3][at % 3] : result_.offset[at - 9];
      const double share = std::pow(derived.gradient[i], 2) * (*result_.covariance)(i, i);
      if (share > kShare * variance) least = std::min(least, output.degrees_of_freedom);
    }
    return least;
  }

  const CalibrationResult& result_;
  Inputs inputs_;
};

/// A value of zero has no direction, and so no derivative: its uncertainty is that of its two components.
void mend_zero(DerivedGroup& group, const CalibrationResult& result, double scale) {
  for (std::size_t j = 0; j < 3; ++j) {
    Quantity& value = group.quantities[j].value;
    if (value.value != 0.0) continue;
    const double diagonal = std::abs((*result.sensitivity_matrix)[j][j].value);
    double variance = 0.0;
    for (const std::size_t k : {(j + 1) % 3, (j + 2) % 3})
      variance += std::pow((*result.sensitivity_matrix)[j][k].standard_uncertainty, 2);
    value.standard_uncertainty = scale * std::sqrt(variance) / diagonal;
    value.type_a = value.type_b = std::nullopt;
    group.quantities[j].gradient.setZero();
  }
}

DerivedGroup azimuth(const Deriver& deriver, const DerivedGroup& transverse) {
  const Inputs& in = deriver.inputs();
  DerivedGroup group = deriver.triple(
      "transverse_azimuth",
      Message("Direction of the transverse sensitivity about the axis itself: of u from y towards z, of v "
              "from z towards x, of w from x towards y"),
      "degree", kOutputNames,
      [&](std::size_t j) { return Real(atan2(in.s[j][(j + 2) % 3], in.s[j][(j + 1) % 3]) / kDegree); });
  for (std::size_t j = 0; j < 3; ++j) {
    const Quantity& size = transverse.quantities[j].value;
    if (size.value > kCoverageFactor * size.standard_uncertainty) continue;
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

std::vector<DerivedGroup> derive(const CalibrationResult& result, const std::vector<SensitivityUnit>& units) {
  if (!result.sensitivity_matrix || !result.covariance)
    throw std::invalid_argument("nothing can be derived from a result without a sensitivity matrix");
  if (!std::isfinite(result.g_loc.value) || !std::isfinite(result.g_loc.standard_uncertainty))
    throw std::invalid_argument("local gravity is not known, so that nothing can be given per m/s2");
  const Deriver deriver(result);
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
      Message("Transverse sensitivity (ISO 16063-31), relative to the sensitivity along the platter axis; it "
              "contains the mounting"),
      "%", kOutputNames, [&](std::size_t j) { return Real(100.0 * in.transverse(j) / in.diagonal(j)); }));
  mend_zero(groups.back(), result, 100.0);
  groups.push_back(azimuth(deriver, groups.back()));
  groups.push_back(deriver.triple(
      "misalignment", Message("Angle between the sensitive direction and its platter axis"), "mrad",
      kOutputNames, [&](std::size_t j) { return Real(1e3 * atan2(in.transverse(j), in.diagonal(j))); }));
  mend_zero(groups.back(), result, 1e3);
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
  for (const SensitivityUnit& wanted : units) {
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

DerivedQuantity derived_quantity(const CalibrationResult& result, const std::string& name,
                                 const std::string& unit, const ValueWithGradient& value) {
  return Deriver(result).quantity(name, unit, Real(value.value, value.gradient));
}

double covariance_of(const CalibrationResult& result, const DerivedQuantity& a, const DerivedQuantity& b) {
  return a.gradient.head<12>().dot(*result.covariance * b.gradient.head<12>()) +
         a.gradient[12] * b.gradient[12] * std::pow(result.g_loc.standard_uncertainty, 2);
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
