#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "app/bench_file/bench_config.h"
#include "protocol/record/run_file.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// A stage record as JSON, schema abcal.stage-record/1 (docs/stage_record.md), every number with all its
/// digits.
nlohmann::ordered_json stage_record_json(const StageRecord& record);

/// @param source  for messages
/// @throws std::invalid_argument naming the source and its problem
StageRecord parse_stage_record(const std::string& text, const std::string& source);
StageRecord read_stage_record(const std::filesystem::path& path);
/// Never in place of a file that exists. @throws std::runtime_error
void write_stage_record(const std::filesystem::path& path, const StageRecord& record);

/// The stage of a bench as a record identifies it.
StageIdentity stage_identity(const InstrumentIdentity& stage, const StageConfig& config);
/// That of a run. @throws std::invalid_argument a bench file in the run that cannot be read
StageIdentity stage_identity(const StoredRun& run);

/// Months of 30.44 days from one time (format_utc()) to a later one; 0 where it is not later.
double months_between(std::string_view earlier_utc, std::string_view later_utc);

}  // namespace abcal
