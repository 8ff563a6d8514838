#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// The version of the schema that is written.
inline constexpr const char* kDccVersion = "3.3.0";

/// The root of a new certificate, with its namespaces and version.
XmlElement dcc_root(const XmlDocument& document);

/// The certificate as a digital calibration certificate (DCC 3.3.0 with D-SI 2.2.1). Every number is written
/// with all its digits and does not depend on the locale. docs/certificate.md lists the elements.
/// @throws NumberNotFinite  if a number of the result is not finite
XmlDocument dcc_document(const Certificate& certificate);

/// A release as the business rules require it ("v1.0.0") from the version of the program.
std::string release_of(const std::string& program_version);

}  // namespace abcal
