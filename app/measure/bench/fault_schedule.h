#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app/bench_file/fault_config.h"
#include "drivers/instrument/clock.h"
#include "sim/faults.h"

namespace abcal {

/// The fault as one of the wire or of the world, with times counted from `start`; nullopt if it is the other.
std::optional<sim::WireFault> wire_fault(const FaultConfig& fault, Clock::Instant start);
std::optional<sim::WorldFault> world_fault(const FaultConfig& fault, Clock::Instant start);

/// The faults of the wire of one instrument.
std::vector<sim::WireFault> wire_faults(const std::vector<FaultConfig>& faults, const std::string& instrument,
                                        Clock::Instant start);

}  // namespace abcal
