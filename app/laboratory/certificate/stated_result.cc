#include "app/laboratory/certificate/stated_result.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "protocol/estimators/shared/intrinsic_properties.h"

namespace abcal {
namespace {

using Scope = std::vector<ScopeLimit>;
using NineFactors = Eigen::Matrix<double, 9, 1>;

/// A quantity of the result with its name as in a laboratory file.
struct NamedOutput {
  std::string name;
  Quantity* quantity;
  int output;  ///< As in study_output.h.
};

/// The uncertainties below which no statement goes.
struct Least {
  const Scope& scope;                       ///< That of the laboratory: CMC.
  const CertifiedUncertainty* monte_carlo;  ///< Null: none.
};

std::vector<NamedOutput> twelve_outputs(CalibrationResult& result) {
  std::vector<NamedOutput> all;
  for (std::size_t j = 0; j < 3; ++j)
    for (std::size_t k = 0; k < 3; ++k)
      all.push_back({std::string("sensitivity_") + kOutputNames[j] + kPlatterAxes[k],
                     &(*result.sensitivity_matrix)[j][k], static_cast<int>(3 * j + k)});
  for (std::size_t j = 0; j < 3; ++j)
    all.push_back(
        {std::string("offset_") + kOutputNames[j], &result.offset[j], kFirstOffset + static_cast<int>(j)});
  return all;
}

std::vector<NamedOutput> nine_outputs(CalibrationResult& result) {
  std::vector<NamedOutput> all;
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    all.push_back({std::string("intrinsic_sensitivity_") + kOutputNames[at],
                   &result.intrinsic_sensitivity[at], kFirstIntrinsicSensitivity + j});
  }
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    all.push_back({std::string("intrinsic_angle_") + kOutputPairs[at], &result.intrinsic_angle[at],
                   kFirstIntrinsicAngle + j});
  }
  for (int j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    all.push_back({std::string("offset_") + kOutputNames[at], &result.offset[at], kFirstOffset + j});
  }
  return all;
}

/// The standard uncertainty that the scope asks for; 0: any.
double least_uncertainty(const Scope& scope, const CalibrationResult& result, const std::string& name,
                         const Quantity& quantity) {
  const auto cmc = smallest_uncertainty(scope, result, name, quantity);
  return cmc ? *cmc / coverage_factor(quantity) : 0.0;
}

void set_uncertainty(Quantity& quantity, double u) {
  quantity.standard_uncertainty = u;
  if (quantity.type_a && quantity.type_b)
    quantity.type_b = std::sqrt(std::max(0.0, u * u - *quantity.type_a * *quantity.type_a));
}

/// Raises outputs and their covariance. @return d of each
template <class Matrix>
std::vector<double> raise(const Least& wanted, const CalibrationResult& result,
                          const std::vector<NamedOutput>& outputs, Matrix& covariance) {
  std::vector<double> factors;
  for (std::size_t n = 0; n < outputs.size(); ++n) {
    Quantity& quantity = *outputs[n].quantity;
    const double u = quantity.standard_uncertainty;
    double least = least_uncertainty(wanted.scope, result, outputs[n].name, quantity);
    if (wanted.monte_carlo != nullptr)
      least = std::max(
          least, wanted.monte_carlo->standard_uncertainty(outputs[n].output, coverage_factor(quantity)));
    factors.push_back(1.0);
    if (!(least > u)) continue;
    const auto i = static_cast<Eigen::Index>(n);
    set_uncertainty(quantity, least);
    if (!(u > 0.0)) {
      covariance(i, i) = least * least;
      continue;
    }
    factors.back() = least / u;
    covariance.row(i) *= least / u;
    covariance.col(i) *= least / u;
  }
  return factors;
}

bool any_raised(const std::vector<double>& factors) {
  return std::any_of(factors.begin(), factors.end(), [](double factor) { return factor > 1.0; });
}

/// Raises the result itself. @return factors of the nine intrinsic outputs beyond the raise of the twelve
NineFactors raise_result(CalibrationResult& result, const Least& least) {
  const std::vector<NamedOutput> twelve = twelve_outputs(result);
  const bool by_monte_carlo = least.monte_carlo != nullptr && least.monte_carlo->any_larger();
  if (by_monte_carlo) {
    result.covariance = least.monte_carlo->covariance(*result.covariance);
    for (std::size_t n = 0; n < twelve.size(); ++n) {
      const auto i = static_cast<Eigen::Index>(n);
      set_uncertainty(*twelve[n].quantity, std::sqrt((*result.covariance)(i, i)));
    }
  }
  const bool changed = any_raised(raise(least, result, twelve, *result.covariance)) || by_monte_carlo;
  std::vector<NamedOutput> nine = nine_outputs(result);
  if (changed) {
    const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(result.sensitivity_values());
    result.covariance_intrinsic = jacobian * *result.covariance * jacobian.transpose();
    for (std::size_t n = 0; n < nine.size(); ++n) {
      const auto i = static_cast<Eigen::Index>(n);
      set_uncertainty(*nine[n].quantity, std::sqrt(std::max(0.0, (*result.covariance_intrinsic)(i, i))));
    }
  }
  const std::vector<double> factors = raise(least, result, nine, *result.covariance_intrinsic);
  return Eigen::Map<const NineFactors>(factors.data());
}

/// Factor of an output for a quantity that is one of the nine in another unit.
double factor_of_nine(const NineFactors& factors, const std::string& name) {
  const std::string last = name.substr(name.rfind('_') + 1);
  const auto place = [&](const auto& names) {
    return static_cast<Eigen::Index>(std::find(names.begin(), names.end(), last) - names.begin());
  };
  if (name.starts_with("intrinsic_sensitivity_")) return factors[place(kOutputNames)];
  if (name.starts_with("non_orthogonality_")) return factors[3 + place(kOutputPairs)];
  return 1.0;
}

/// Derived quantities have the uncertainty of the raised outputs, and never less than the scope's. Their
/// degrees of freedom stay those of the measurement.
void raise_derived(StatedResult& stated, const StatedResult& as_measured, const Scope& scope,
                   const NineFactors& factors) {
  for (std::size_t g = 0; g < stated.derived.size(); ++g) {
    for (std::size_t q = 0; q < stated.derived[g].quantities.size(); ++q) {
      DerivedQuantity& quantity = stated.derived[g].quantities[q];
      Quantity& value = quantity.value;
      value.degrees_of_freedom = as_measured.derived[g].quantities[q].value.degrees_of_freedom;
      if (const double factor = factor_of_nine(factors, quantity.name); factor > 1.0) {
        quantity.gradient.head<12>() *= factor;
        set_uncertainty(value, std::sqrt(covariance_of(stated.result, quantity, quantity)));
      }
      const double u = value.standard_uncertainty,
                   least = least_uncertainty(scope, stated.result, quantity.name, value);
      if (!(least > u)) continue;
      if (u > 0.0) quantity.gradient *= least / u;
      set_uncertainty(value, least);
    }
  }
}

void add_marks(StatedResult& stated, const StatedResult& as_measured, const Scope& scope) {
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

StatedResult stated_result(const CalibrationResult& result, const std::vector<SensitivityUnit>& units,
                           const std::vector<ScopeLimit>& scope, bool accredited,
                           const CertifiedUncertainty* monte_carlo) {
  const StatedResult as_computed{result, derive(result, units), {}};
  const auto raised = [&](const Scope& to) {
    StatedResult stated{result, {}, {}};
    const NineFactors factors = raise_result(stated.result, {to, monte_carlo});
    stated.derived = derive(stated.result, units);
    raise_derived(stated, as_computed, to, factors);
    return stated;
  };
  const StatedResult as_measured =
      monte_carlo != nullptr && monte_carlo->any_larger() ? raised({}) : as_computed;
  if (scope.empty() && !accredited) return as_measured;
  StatedResult stated = raised(scope);
  add_marks(stated, as_measured, scope);
  return stated;
}

Covariance12 covariance_of_outputs(const StatedResult& stated) {
  const auto group = std::find_if(stated.derived.begin(), stated.derived.end(),
                                  [](const DerivedGroup& one) { return one.name == "sensitivity"; });
  if (group == stated.derived.end()) throw std::logic_error("a result without numbers has no covariance");
  std::vector<DerivedQuantity> outputs = group->quantities;
  for (Eigen::Index j = 9; j < 12; ++j)
    outputs.emplace_back().gradient.head<12>() = Eigen::Matrix<double, 12, 1>::Unit(j);
  return Covariance12::NullaryExpr([&](Eigen::Index i, Eigen::Index j) {
    return covariance_of(stated.result, outputs[static_cast<std::size_t>(i)],
                         outputs[static_cast<std::size_t>(j)]);
  });
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
