#pragma once

#include <memory>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/instrument_ports.h"
#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal {

/// The worlds of a simulated bench, one for each item in their order, all on one stage. Stage, chamber and
/// environment live in the first.
using SimWorlds = std::vector<std::shared_ptr<sim::SimBench>>;
/// With the faults and changes of the bench file.
SimWorlds make_worlds(const BenchConfig& config, Clock::Instant start);
/// The world in which the instrument behind a port lives; null where nothing is simulated.
std::shared_ptr<sim::SimBench> world_of(const SimWorlds& worlds, int item);

/// The simulated inside of the instrument behind a port of this bench.
/// @param world  world_of() the port's item
/// @throws std::invalid_argument for a driver that has none.
std::shared_ptr<sim::Firmware> make_firmware(const BenchConfig& config, const InstrumentPort& port,
                                             std::shared_ptr<sim::SimBench> world);

}  // namespace abcal
