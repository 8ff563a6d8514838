#pragma once

#include "protocol/record/run_file.h"

namespace abcal {

/// The clocks of this computer now: its start, the time since, and the time service's estimate of
/// the system clock's error. Values that it does not give stay unknown.
HostClock read_host_clock();

}  // namespace abcal
