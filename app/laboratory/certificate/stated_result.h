#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "app/laboratory/certificate/derived.h"
#include "app/laboratory/certificate/scope.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/uncertainty/certified_uncertainty.h"

namespace abcal {

/// A result as a certificate states it: one state of twelve outputs with one covariance, from which every
/// number, limit, angle and probability follows. No U is below the smallest of the laboratory's scope (CMC,
/// ILAC-P14): raised_covariance() raises the covariance once, so that each quantity of the scope reaches it.
/// Where the Monte Carlo of the result gives a larger U, this U and its covariance are those of the result.
struct StatedResult {
  CalibrationResult result;
  Covariance12 measured = Covariance12::Zero();  ///< Covariance of the outputs before the scope.
  /// Directions of u, v, w as the run states them, as rows.
  Eigen::Matrix3d mounting = Eigen::Matrix3d::Identity();
  std::vector<DerivedGroup> derived;       ///< Empty without numbers.
  std::map<std::string, ScopeMark> marks;  ///< By the name of the quantity; empty: all are kNone.

  ScopeMark mark(const std::string& name) const;
  /// The quantities of a derived group: "sensitivity" (row by row), "intrinsic_sensitivity".
  /// @throws std::logic_error  where it was not derived
  const std::vector<DerivedQuantity>& group(std::string_view name) const;
  /// From what its quantities are derived. @param units  further units of the sensitivities
  DeriveFrom from(const std::vector<SensitivityUnit>& units = {}) const {
    return {units, mounting, measured};
  }
};

/// The statement of a result depends on these, beside the result.
struct HowStated {
  std::vector<SensitivityUnit> units = {};  ///< Further units of the sensitivities.
  std::vector<ScopeLimit> scope = {};       ///< The laboratory's.
  bool accredited = false;  ///< It states an accreditation: without a scope, all results are outside of it.
  std::string mounting = "x y z";  ///< Axes of the platter along which u, v, w point, as the run states them.
  const CertifiedUncertainty* monte_carlo = nullptr;  ///< That of the result; null: none was made.
};

/// @throws as derive() and raised_covariance()
StatedResult stated_result(const CalibrationResult& result, const HowStated& how = {});

/// The one statement of a quantity in a certificate: sensitivities per m/s2, angles, offsets, derived
/// quantities. Every other place cites it, also decisions. Absent: not determined, or no name of a quantity.
std::optional<Quantity> stated_quantity(const StatedResult& stated, const std::string& name);

/// Covariance of the sensitivities per m/s2 row by row and the offsets, uncertainty of local gravity
/// included.
/// @param outputs  covariance of the twelve outputs: stated.result.covariance or stated.measured
/// @throws std::logic_error  for a result without numbers
Covariance12 covariance_of_outputs(const StatedResult& stated, const Covariance12& outputs);

}  // namespace abcal
