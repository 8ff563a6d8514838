#pragma once

#include "app/certificate/certificate.h"
#include "app/xml/xml_tree.h"

namespace abcal {

/// Adds methods, software, equipment, conditions and results of each calibration (dcc:measurementResults).
/// @throws NumberNotFinite
void add_measurement_results(XmlElement& root, const Certificate& certificate);

}  // namespace abcal
