#pragma once

#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/console/run_choice.h"

namespace abcal::console {

/// A bench file in which a person's choices for one run replace its own values.
struct ChosenRun {
  BenchConfig config;
  std::vector<Message> warnings;  ///< To be shown to a person before the start.
};

/// Applies a person's choices. If they name another model, the range, filter, firmware, supply and nominal
/// sensitivity of the bench file are dropped.
ChosenRun choose_run(BenchConfig config, const RunChoice& choice);

}  // namespace abcal::console
