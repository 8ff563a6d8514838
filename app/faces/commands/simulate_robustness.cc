#include "app/faces/commands/simulate_robustness.h"

#include <nlohmann/json.hpp>

#include "app/ground/system/exit_code.h"
#include "app/ground/system/interrupt.h"
#include "app/ground/system/output.h"
#include "app/ground/system/progress.h"
#include "app/ground/system/real_clock.h"
#include "app/studies/robustness/robustness_text.h"

namespace abcal {

int simulate_robustness(const RobustnessOptions& given, bool json) {
  RobustnessOptions options = given;
  const RealClock clock;
  ProgressBar bar("simulating", clock);
  const Clock::Instant start = clock.now();
  options.stop = interrupt_token();
  options.progress = [&](int done, int planned) {
    if (to_seconds(clock.now() - start) > 2.0) bar.show(done, planned);
  };
  const RobustnessStudy study = run_robustness_study(options);
  bar.clear();
  if (json) {
    print_result("{}\n", robustness_json(study).dump(2));
  } else {
    print_result("{}", robustness_text(study));
  }
  return study.interrupted ? kExitInterrupted : kExitDone;
}

}  // namespace abcal
