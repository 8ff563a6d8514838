#include "app/commands/simulate_robustness.h"

#include <nlohmann/json.hpp>

#include "app/commands/study_bar.h"
#include "app/studies/robustness/robustness_text.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {

int simulate_robustness(const RobustnessOptions& options, bool json) {
  const RobustnessStudy study = with_bar(options, run_robustness_study);
  if (json) {
    print_result("{}\n", robustness_json(study).dump(2));
  } else {
    print_result("{}", robustness_text(study));
  }
  return study.interrupted ? kExitInterrupted : kExitDone;
}

}  // namespace abcal
