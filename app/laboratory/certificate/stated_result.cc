#include "app/laboratory/certificate/stated_result.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "app/laboratory/certificate/raised_covariance.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

/// A quantity of the result with its name as in a laboratory file and its derivatives by the twelve outputs.
struct NamedOutput {
  std::string name;
  Quantity* quantity;
  Eigen::Matrix<double, 12, 1> gradient;
  int output;  ///< As in study_output.h.
};

std::vector<NamedOutput> twelve_outputs(CalibrationResult& result) {
  std::vector<NamedOutput> all;
  const auto add = [&](const std::string& name, Quantity& quantity) {
    const auto i = static_cast<Eigen::Index>(all.size());
    all.push_back({name, &quantity, Eigen::Matrix<double, 12, 1>::Unit(i), static_cast<int>(i)});
  };
  for (std::size_t j = 0; j < 3; ++j)
    for (std::size_t k = 0; k < 3; ++k)
      add(std::string("sensitivity_") + kOutputNames[j] + kPlatterAxes[k],
          (*result.sensitivity_matrix)[j][k]);
  for (std::size_t j = 0; j < 3; ++j) add(std::string("offset_") + kOutputNames[j], result.offset[j]);
  return all;
}

std::vector<NamedOutput> intrinsic_outputs(CalibrationResult& result) {
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(result.sensitivity_values());
  std::vector<NamedOutput> all;
  for (std::size_t j = 0; j < 3; ++j)
    all.push_back({std::string("intrinsic_sensitivity_") + kOutputNames[j], &result.intrinsic_sensitivity[j],
                   jacobian.row(static_cast<Eigen::Index>(j)),
                   kFirstIntrinsicSensitivity + static_cast<int>(j)});
  for (std::size_t j = 0; j < 3; ++j)
    all.push_back({std::string("intrinsic_angle_") + kOutputPairs[j], &result.intrinsic_angle[j],
                   jacobian.row(static_cast<Eigen::Index>(3 + j)),
                   kFirstIntrinsicAngle + static_cast<int>(j)});
  return all;
}

void set_uncertainty(Quantity& quantity, double variance) {
  quantity.standard_uncertainty = std::sqrt(std::max(0.0, variance));
  if (quantity.type_a && quantity.type_b)
    quantity.type_b = std::sqrt(std::max(0.0, variance - *quantity.type_a * *quantity.type_a));
}

/// Gives the result another covariance of its outputs: what exceeds its type A is of type B.
void set_covariance(CalibrationResult& result, const Covariance12& covariance) {
  result.covariance = covariance;
  if (result.covariance_type_a) result.covariance_type_b = covariance - *result.covariance_type_a;
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(result.sensitivity_values());
  result.covariance_intrinsic = jacobian * covariance * jacobian.transpose();
  if (result.covariance_intrinsic_type_a)
    result.covariance_intrinsic_type_b = *result.covariance_intrinsic - *result.covariance_intrinsic_type_a;
  for (const auto& outputs : {twelve_outputs(result), intrinsic_outputs(result)})
    for (const NamedOutput& one : outputs)
      set_uncertainty(*one.quantity, one.gradient.dot(covariance * one.gradient));
}

/// Takes the U of the Monte Carlo where that is larger.
void take(const CertifiedUncertainty& monte_carlo, CalibrationResult& result) {
  if (!monte_carlo.any_larger()) return;
  std::vector<LeastVariance> least;
  for (const auto& outputs : {twelve_outputs(result), intrinsic_outputs(result)}) {
    for (const NamedOutput& one : outputs) {
      const double u = monte_carlo.standard_uncertainty(one.output, coverage_factor(*one.quantity));
      least.push_back({one.name, one.gradient, u * u});
    }
  }
  set_covariance(result, raised_covariance(monte_carlo.covariance(*result.covariance), least));
}

/// The variances that the scope asks of the outputs, for every quantity that the certificate states.
std::vector<LeastVariance> wanted_by(const std::vector<ScopeLimit>& scope, StatedResult& stated) {
  std::vector<LeastVariance> least;
  CalibrationResult& result = stated.result;
  const auto add = [&](const std::string& name, const Quantity& quantity,
                       const Eigen::Matrix<double, 12, 1>& gradient, double by_gravity) {
    const auto cmc = smallest_uncertainty(scope, result, name, quantity);
    if (!cmc) return;
    const double u = *cmc / coverage_factor(quantity);
    least.push_back({name, gradient, u * u - by_gravity * by_gravity});
  };
  for (const auto& outputs : {twelve_outputs(result), intrinsic_outputs(result)})
    for (const NamedOutput& one : outputs) add(one.name, *one.quantity, one.gradient, 0.0);
  for (const DerivedGroup& group : stated.derived)
    for (const DerivedQuantity& one : group.quantities)
      add(one.name, one.value, one.gradient.head<12>(), one.gradient[12] * result.g_loc.standard_uncertainty);
  return least;
}

void add_marks(StatedResult& stated, const StatedResult& as_measured, const std::vector<ScopeLimit>& scope) {
  std::vector<std::string> names = names_of_quantities();
  for (const char* axis : kOutputNames) names.push_back(std::string("transverse_azimuth_") + axis);
  constexpr double kRounding = 1e-9;
  for (const std::string& name : names) {
    const auto quantity = stated_quantity(stated, name), before = stated_quantity(as_measured, name);
    ScopeMark mark = ScopeMark::kOutside;
    if (quantity && smallest_uncertainty(scope, stated.result, name, *quantity))
      mark = quantity->standard_uncertainty > (1.0 + kRounding) * before->standard_uncertainty
                 ? ScopeMark::kRaised
                 : ScopeMark::kWithin;
    stated.marks.emplace(name, mark);
  }
}

}  // namespace

ScopeMark StatedResult::mark(const std::string& name) const {
  const auto found = marks.find(name);
  return found == marks.end() ? ScopeMark::kNone : found->second;
}

const std::vector<DerivedQuantity>& StatedResult::group(std::string_view name) const {
  const auto found =
      std::find_if(derived.begin(), derived.end(), [&](const DerivedGroup& one) { return one.name == name; });
  if (found == derived.end()) throw std::logic_error("nothing was derived as " + std::string(name));
  return found->quantities;
}

StatedResult stated_result(const CalibrationResult& result, const HowStated& how) {
  StatedResult stated;
  stated.result = result;
  if (const auto mounting = mounting_matrix(how.mounting)) stated.mounting = *mounting;
  if (how.monte_carlo != nullptr) take(*how.monte_carlo, stated.result);
  if (stated.result.covariance) stated.measured = *stated.result.covariance;
  stated.derived = derive(stated.result, stated.from(how.units));
  if (how.scope.empty() && !how.accredited) return stated;
  const StatedResult as_measured = stated;
  if (const std::vector<LeastVariance> least = wanted_by(how.scope, stated); !least.empty()) {
    const Covariance12 raised = raised_covariance(*stated.result.covariance, least);
    if (raised != *stated.result.covariance) {
      set_covariance(stated.result, raised);
      stated.derived = derive(stated.result, stated.from(how.units));
    }
  }
  add_marks(stated, as_measured, how.scope);
  return stated;
}

Covariance12 covariance_of_outputs(const StatedResult& stated, const Covariance12& outputs) {
  const std::vector<DerivedQuantity>& sensitivities = stated.group("sensitivity");
  Eigen::Matrix<double, 12, 13> in_si = Eigen::Matrix<double, 12, 13>::Zero();
  in_si.block<3, 3>(9, 9).setIdentity();
  for (Eigen::Index i = 0; i < 9; ++i)
    in_si.row(i) = sensitivities[static_cast<std::size_t>(i)].gradient.transpose();
  const auto by_outputs = in_si.leftCols<12>();
  const Eigen::Matrix<double, 12, 1> by_gravity = in_si.col(12) * stated.result.g_loc.standard_uncertainty;
  return by_outputs * outputs * by_outputs.transpose() + by_gravity * by_gravity.transpose();
}

std::optional<Quantity> stated_quantity(const StatedResult& stated, const std::string& name) {
  // The first of a name is the one in SI units.
  for (const DerivedGroup& group : stated.derived)
    for (const DerivedQuantity& quantity : group.quantities)
      if (quantity.name == name && std::isfinite(quantity.value.value)) return quantity.value;
  for (std::size_t j = 0; j < 3; ++j) {
    if (name == std::string("intrinsic_angle_") + kOutputPairs[j]) return stated.result.intrinsic_angle[j];
    if (name == std::string("offset_") + kOutputNames[j]) return stated.result.offset[j];
  }
  return std::nullopt;
}

}  // namespace abcal
