#include "app/commands/simulate_robustness.h"

#include "app/bench/real_clock.h"
#include "app/robustness/robustness_text.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/progress.h"

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
