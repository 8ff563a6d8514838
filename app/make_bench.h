#pragma once

#include <memory>

#include "app/bench_config.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal {

/// The instruments of a bench file, and the time they live in. Members are destroyed from the last to the
/// first.
struct Bench {
  std::unique_ptr<Clock> clock;
  std::shared_ptr<sim::SimBench> world;  ///< The simulated world; null where everything is real.
  std::unique_ptr<RotationStage> stage;  ///< In protocol angles, inside the bench's travel.
  std::unique_ptr<Accelerometer> accelerometer;
  bool simulated_time = false;  ///< Nothing real takes part: the clock jumps.
};

/// Opens the instruments of a bench file. The only place where real and simulated differ.
/// @throws InstrumentError kCannotOpen; std::invalid_argument for settings a driver refuses.
Bench make_bench(const BenchConfig& config);

/// One controller of the stage: of both axes, or of the one that has a controller of its own.
struct StagePort {
  std::string
      name;  ///< "stage", "stage-x", "stage-z": as [[fault]] and the links of `abcal emulate` call it.
  std::string driver, port;
  std::optional<int> baud;
  std::string address;
};
std::vector<StagePort> stage_ports(const StageConfig& stage);

/// The stage of a bench file alone, in protocol angles. `world` may be null if no part of it is simulated.
std::unique_ptr<RotationStage> make_stage(const BenchConfig& config,
                                          const std::shared_ptr<sim::SimBench>& world, Clock& clock);

/// The firmware behind one simulated instrument, as `abcal emulate` serves it. @throws std::invalid_argument
/// for a driver that has none.
std::shared_ptr<sim::Firmware> make_stage_firmware(const BenchConfig& config, const StagePort& port,
                                                   std::shared_ptr<sim::SimBench> world);
std::shared_ptr<sim::Firmware> make_accelerometer_firmware(const BenchConfig& config,
                                                           std::shared_ptr<sim::SimBench> world);

}  // namespace abcal
