#pragma once

#include <string>

#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/certificate/schema_check.h"
#include "app/laboratory/pilot/pilot_analysis.h"

namespace abcal {

/// Facts of a comparison's certificate that its analysis does not contain.
struct PilotCertificate {
  LaboratoryFile laboratory;  ///< That of the pilot.
  std::string number;
  std::string approved_by;  ///< A person of the laboratory who may approve.
  Date date;
};

/// The result of a comparison as a digital calibration certificate (DCC 3.3.0): reference values,
/// differences and their uncertainties with all covariances, E_n, pairs, and the participants' statements.
/// Its refTypes begin with "comparison_" where others use these names (reference and equivalence values).
/// @param schema  null: checked by the business rules only
/// @throws KeyComparisonError with every violation, and with the facts that are missing
std::string pilot_dcc(const PilotAnalysis& analysis, const PilotCertificate& facts, const DccSchema* schema);

}  // namespace abcal
