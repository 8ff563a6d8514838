#pragma once

#include "protocol/record/run_file.h"

namespace abcal {

/// What this computer says of its clocks now: its start, the time since, and the time service's estimate of
/// the system clock's error. What it does not say stays unknown.
HostClock read_host_clock();

}  // namespace abcal
