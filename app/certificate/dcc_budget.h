#pragma once

#include "app/certificate/words.h"
#include "app/results/report_data.h"
#include "app/xml/xml_tree.h"

namespace abcal {

/// Adds the uncertainty budget as a result: each input with its standard uncertainty, and what it contributes
/// to the standard uncertainty of every output.
void add_budget(XmlElement& results, const Words& words, const ReportData& data);

}  // namespace abcal
