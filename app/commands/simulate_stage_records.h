#pragma once

#include "app/studies/stage_records/stage_record_study.h"

namespace abcal {

/// `abcal simulate stage-records`: runs the study and prints its table or JSON.
/// @return the exit code: 1 where a figure is missed or a group contradicts its uncertainties
int simulate_stage_records(const StageRecordOptions& options, bool json);

}  // namespace abcal
