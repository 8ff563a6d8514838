#pragma once

#include <nlohmann/json_fwd.hpp>

#include "app/results/analysis/report_data.h"

namespace abcal {

/// The whole report as one JSON object, schema abcal.report/1 (docs/report.md). Results have the schema
/// abcal.result/1; unknown values are null.
nlohmann::ordered_json report_json(const ReportData& data);

}  // namespace abcal
