#pragma once

#include <string>

#include "app/measure/session/session_events.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// How a run first ended: the text of that event, or that its program left none. A run that was resumed has
/// several ends; a recording covers it up to the first.
std::string end_of_run(const StoredRun& run);

/// Whether a replay agrees with the recorded run.
ReplayComparedEvent compare_replay(const StoredRun& recorded, const StoredRun& replayed);

}  // namespace abcal
