#pragma once

#include <string>
#include <vector>

#include "app/formats/xml_tree.h"

namespace abcal {

/// One problem of a certificate, with its place in the XML.
struct DccProblem {
  std::string
      where;  ///< "/dcc:digitalCalibrationCertificate/dcc:administrativeData/...", with the line if known
  std::string what;
};

/// Rules for a DCC 3.3.0 that its schema cannot express: the errors of the PTB's Schematron in its compiled
/// form, which are more than those of its source (unreferenced ids, empty elements). All problems at once.
std::vector<DccProblem> check_business_rules(const XmlDocument& document);

/// "WHERE: WHAT", a line each.
std::string to_string(const std::vector<DccProblem>& problems);

}  // namespace abcal
