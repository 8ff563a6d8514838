#pragma once

#include "app/ground/xml/xml_tree.h"
#include "app/laboratory/certificate/words.h"
#include "app/results/estimates/report_data.h"

namespace abcal {

/// Adds the uncertainty budget as a result: each input with its standard uncertainty, and its contribution to
/// the standard uncertainty of every output.
void add_budget(XmlElement& results, const Words& words, const ReportData& data);

}  // namespace abcal
