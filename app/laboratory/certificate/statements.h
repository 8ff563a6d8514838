#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// A sentence that a certificate must or may contain, for the XML and for pages.
struct Statement {
  std::string ref_type;  ///< "abc_traceability"
  Wording title;
  Wording text;
  std::vector<std::string> norms, references;
  bool traceable = false;
  std::optional<Date> date;
  bool of_customer = false;  ///< The customer asked for it.
  std::string non_si_definition, non_si_unit;
};

/// All statements of a certificate: draft, simulation, the item concerned, traceability, uncertainty,
/// decision rule, deviations, data supplied by the customer, opinions, amendment, entry of the register,
/// units.
std::vector<Statement> statements_of(const Certificate& certificate);

}  // namespace abcal
