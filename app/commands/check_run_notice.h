#pragma once

#include "app/session/run_session.h"

namespace abcal {

/// A run of a check standard ended: says that its chart waits for it, with the command, and tells the
/// register (environment variable ABCAL_REGISTER), so that `abcal lab chart show` lists it. Nothing without a
/// register or without a chart of this item on this bench. A register that cannot be reached now is a
/// warning: the run is whole without it.
void tell_charts(const RunOutcome& outcome);

}  // namespace abcal
