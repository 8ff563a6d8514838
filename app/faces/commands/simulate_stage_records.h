#pragma once

#include "app/studies/stage_records/stage_record_study.h"

namespace abcal {

/// `abcal simulate stage-records`: runs the study and prints its table or JSON.
/// @return the exit code
int simulate_stage_records(const StageRecordOptions& options, bool json);

}  // namespace abcal
