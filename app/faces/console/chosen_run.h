#pragma once

#include <string>
#include <vector>

#include "app/faces/console/run_choice.h"
#include "app/ground/bench_file/bench_config.h"

namespace abcal::console {

/// A bench file with what a person chose for one run in the place of what it says.
struct ChosenRun {
  BenchConfig config;
  std::vector<std::string> warnings;  ///< What a person should look at before the start.
};

/// What the bench file says of an item of another model (range, filter, firmware, supply, nominal
/// sensitivity) is not taken for this one.
ChosenRun choose_run(BenchConfig config, const RunChoice& choice);

}  // namespace abcal::console
