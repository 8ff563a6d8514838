#pragma once

#include <nlohmann/json.hpp>

#include "app/results/report_data.h"

namespace abcal {

/// The whole report as one JSON object, schema abcal.report/1 (docs/report.md). Results are as
/// abcal.result/1 has them; what is not known is null.
nlohmann::ordered_json report_json(const ReportData& data);

}  // namespace abcal
