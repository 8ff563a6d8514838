#pragma once

#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// Lets the joint estimator take the stage from the record that the run keeps, if it keeps one and none was
/// chosen.
/// @throws std::invalid_argument a record in the run that cannot be read
void use_stored_stage_record(StoredRun& run);

/// SHA-256 of the record of the stage on which the result of a run, or of a measurement whose first run it
/// is, rests; empty: on none.
std::string sha256_of_stage_record(const StoredRun& run);

/// Lets the joint estimator take the stage of these items of a run, or of the one of a CSV, from a record.
/// @param file  the run or the CSV
/// @throws std::invalid_argument the record of another stage; one that this run taught
void use_stage_record(std::span<StoredRun> items, const std::shared_ptr<const StageRecord>& record,
                      const std::filesystem::path& file);

}  // namespace abcal
