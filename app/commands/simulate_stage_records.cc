#include "app/commands/simulate_stage_records.h"

#include <nlohmann/json.hpp>

#include "app/commands/study_bar.h"
#include "app/studies/stage_records/stage_record_text.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {

int simulate_stage_records(const StageRecordOptions& options, bool json) {
  const StageRecordStudy study = with_bar(options, run_stage_record_study);
  if (json) {
    print_result("{}\n", stage_record_json(study).dump(2));
  } else {
    print_result("{}", stage_record_text(study));
  }
  if (study.interrupted) return kExitInterrupted;
  return study.missed().empty() && study.contradictions().empty() ? kExitDone : kExitFailed;
}

}  // namespace abcal
