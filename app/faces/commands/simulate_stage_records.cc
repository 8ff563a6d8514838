#include "app/faces/commands/simulate_stage_records.h"

#include <nlohmann/json.hpp>

#include "app/ground/system/exit_code.h"
#include "app/ground/system/interrupt.h"
#include "app/ground/system/output.h"
#include "app/ground/system/progress.h"
#include "app/ground/system/real_clock.h"
#include "app/studies/stage_records/stage_record_text.h"

namespace abcal {

int simulate_stage_records(const StageRecordOptions& given, bool json) {
  StageRecordOptions options = given;
  const RealClock clock;
  ProgressBar bar("simulating", clock);
  const Clock::Instant start = clock.now();
  options.stop = interrupt_token();
  options.progress = [&](int done, int planned) {
    if (to_seconds(clock.now() - start) > 2.0) bar.show(done, planned);
  };
  const StageRecordStudy study = run_stage_record_study(options);
  bar.clear();
  if (json) {
    print_result("{}\n", stage_record_json(study).dump(2));
  } else {
    print_result("{}", stage_record_text(study));
  }
  if (study.interrupted) return kExitInterrupted;
  return study.missed().empty() && study.contradictions().empty() ? kExitDone : kExitFailed;
}

}  // namespace abcal
