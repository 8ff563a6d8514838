#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/bench/bench_config.h"
#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal {

/// One port of a bench: of an instrument, or of a part of one.
struct InstrumentPort {
  std::string
      name;  ///< "stage", "stage-z", "accelerometer-u", ...: for [[fault]], recordings, the emulator's links.
  std::string driver, port;
  std::optional<int> baud;
  std::string address{};
  std::size_t part = 0;             ///< Of several ports of one instrument: which.
  std::size_t connection = 0;       ///< Of several connections to one port: which.
  std::optional<StageAxis> axis{};  ///< Of a stage's controller that has one axis only: which.
  int item = 0;                     ///< Of one of several items: which; 0: of the bench, or of its only item.

  /// The controller's names of X and Z; empty: not on this controller.
  std::array<std::string, 2> axis_names(const StageConfig& stage) const;
};

/// The stage's controller, or one for each axis. Empty for a stage without bytes.
std::vector<InstrumentPort> stage_ports(const StageConfig& stage);
/// The connections to a stage's port: itself, and "NAME-2" and so on for the others.
std::vector<InstrumentPort> connections_of(const InstrumentPort& port, std::size_t count);
/// The accelerometer's port, or several of them ("PORT PORT PORT"). Empty for one without bytes.
std::vector<InstrumentPort> accelerometer_ports(const AccelerometerConfig& accelerometer);
/// The ports of one of several items: "item-3", or "item-3-u" and so on.
std::vector<InstrumentPort> item_ports(const BenchConfig& config, int item);
/// Those of all accelerometers of a bench that are to be opened.
std::vector<InstrumentPort> all_accelerometer_ports(const BenchConfig& config);
/// The port of the thermometer and hygrometer, if there is one.
std::vector<InstrumentPort> environment_ports(const EnvironmentConfig& environment);

/// The port of the thermal chamber, if it has one.
std::vector<InstrumentPort> chamber_ports(const ChamberConfig& chamber);
/// Whether the chamber on a port speaks Modbus TCP, not RTU.
bool has_tcp_frames(const std::string& port);

/// The worlds of a simulated bench: one, or one for each of several items, all on the stage of the first.
using SimWorlds = std::vector<std::shared_ptr<sim::SimBench>>;
/// With the faults and changes of the bench file.
SimWorlds make_worlds(const BenchConfig& config, Clock::Instant start);
/// The world in which the instrument behind a port lives; null where there is none.
std::shared_ptr<sim::SimBench> world_of(const SimWorlds& worlds, int item);

/// The simulated inside of the instrument behind a port of this bench.
/// @param world  world_of() the port's item
/// @throws std::invalid_argument for a driver that has none.
std::shared_ptr<sim::Firmware> make_firmware(const BenchConfig& config, const InstrumentPort& port,
                                             std::shared_ptr<sim::SimBench> world);

/// The serial numbers that simulated instruments of a driver report unless a bench file gives them another;
/// none where the instrument has no serial number.
std::vector<std::string> simulated_serial_numbers(const std::string& driver);

}  // namespace abcal
