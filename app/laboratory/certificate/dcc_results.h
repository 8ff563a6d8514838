#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// Adds methods, software, equipment, conditions and results of each calibration (dcc:measurementResults).
/// @throws NumberNotFinite
void add_measurement_results(XmlElement& root, const Certificate& certificate);

}  // namespace abcal
