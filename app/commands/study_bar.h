#pragma once

#include <utility>

#include "app/system/interrupt.h"
#include "app/system/progress.h"
#include "app/system/real_clock.h"

namespace abcal {

/// Runs a study that can be interrupted, with a bar from the third second on.
/// @param run  takes the options, with their `stop` and `progress`
template <class Options, class Study>
Study with_bar(Options options, Study (*run)(const Options&)) {
  const RealClock clock;
  ProgressBar bar("simulating", clock);
  const Clock::Instant start = clock.now();
  options.stop = interrupt_token();
  options.progress = [&](int done, int planned) {
    if (to_seconds(clock.now() - start) > 2.0) bar.show(done, planned);
  };
  Study study = run(options);
  bar.clear();
  return study;
}

}  // namespace abcal
