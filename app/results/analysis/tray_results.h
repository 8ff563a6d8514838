#pragma once

#include <cstdio>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "app/results/analysis/analyses.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// "2: Analog Devices ADXL355, serial number 17".
std::string item_words(const RunItem& item);

/// All items as one JSON object, schema abcal.tray/1 (docs/several_items_results.md).
nlohmann::ordered_json tray_json(const AnalysedRun& run);

/// Verdict, a line for each item, the stage, and the differences between the items. Colours as `stream`
/// allows.
std::string tray_text(const AnalysedRun& run, std::FILE* stream);

/// JSON that a command prints for a run: abcal.result/1 with the first result of a single item; abcal.tray/1
/// for several.
nlohmann::ordered_json analysis_json(const AnalysedRun& run);

}  // namespace abcal
