#pragma once

#include <string>

#include "drivers/instrument/clock.h"

namespace abcal {

/// Time since boot with the time in suspension (CLOCK_BOOTTIME).
Clock::Duration uptime();

/// Names the start of the computer; empty: not known.
std::string boot_id();

}  // namespace abcal
