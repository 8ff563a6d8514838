#pragma once

#include <string>
#include <vector>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// Whether the item was adjusted before or after; empty where it was not adjusted.
struct ItemState {
  Message words;       ///< "as found"
  std::string status;  ///< Name in the schema: "beforeAdjustment".
};

// The parts of one measurement result around its numbers, in the order of the schema.

/// @return dcc:usedMethods
XmlElement add_methods(XmlElement& measurement, const Certificate& certificate, const ReportData& data);
void add_used_software(XmlElement& measurement, const Certificate& certificate, const ReportData& data);
/// The laboratory's equipment with its certificates, and the instruments as they identified themselves.
void add_equipment(XmlElement& measurement, const Certificate& certificate, const ReportData& data);
/// Room, temperature of the item, local gravity, state of the item, of one run or of several.
void add_conditions(XmlElement& measurement, const Certificate& certificate,
                    const std::vector<const ReportData*>& runs, const ItemState& state);
/// Hash of the raw data, when it was measured, verdict of the analysis.
void add_metadata(XmlElement& measurement, const Certificate& certificate, const CertifiedRun& run);

}  // namespace abcal
