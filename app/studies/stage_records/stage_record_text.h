#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "app/studies/stage_records/stage_record_study.h"

namespace abcal {

std::string stage_record_text(const StageRecordStudy& study);

/// One JSON object, schema abcal.stage-records/1.
nlohmann::ordered_json stage_record_json(const StageRecordStudy& study);

}  // namespace abcal
