#pragma once

#include <map>
#include <string>
#include <vector>

#include "app/laboratory/certificate/derived.h"
#include "app/laboratory/certificate/scope.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/uncertainty/certified_uncertainty.h"

namespace abcal {

/// A result as a certificate states it: no U is below the smallest of the laboratory's scope (CMC, ILAC-P14).
/// A raised uncertainty is raised everywhere: covariances become C' = D C D with d_i = max(1, u_CMC / u_i),
/// so that the correlations stay, and derived quantities follow from the raised covariances. Where the Monte
/// Carlo of the result gives a larger U, this U and its covariance take the place of those of the result.
struct StatedResult {
  CalibrationResult result;
  std::vector<DerivedGroup> derived;       ///< Empty without numbers.
  std::map<std::string, ScopeMark> marks;  ///< By the name of the quantity; empty: all are kNone.

  ScopeMark mark(const std::string& name) const;
};

/// @param accredited  the laboratory states an accreditation: without a scope, all results are outside of it
/// @param monte_carlo  of this result; null: none was made
/// @throws as derive()
StatedResult stated_result(const CalibrationResult& result, const std::vector<SensitivityUnit>& units,
                           const std::vector<ScopeLimit>& scope, bool accredited,
                           const CertifiedUncertainty* monte_carlo = nullptr);

/// The one statement of a quantity in a certificate: sensitivities per m/s2, angles, offsets, derived
/// quantities. Every other place cites it, also decisions. Absent: not determined, or no name of a quantity.
std::optional<Quantity> stated_quantity(const StatedResult& stated, const std::string& name);

/// Covariance of the sensitivities per m/s2 row by row and the offsets, uncertainty of local gravity
/// included.
/// @throws std::logic_error  for a result without numbers
Covariance12 covariance_of_outputs(const StatedResult& stated);

}  // namespace abcal
