#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// The port and the driver of a simulated instrument, as a bench file writes it.
inline constexpr const char* kSimulated = "simulated";

/// One port of a bench: of an instrument, or of a part of one.
struct InstrumentPort {
  std::string
      name;  ///< "stage", "stage-z", "accelerometer-u", ...: for [[fault]], recordings, the emulator's links.
  std::string driver, port;
  std::optional<int> baud;
  std::string address{};
  std::size_t part = 0;             ///< Index among several ports of one instrument.
  std::size_t connection = 0;       ///< Index among several connections to one port.
  std::optional<StageAxis> axis{};  ///< The axis of a stage's controller that has one axis only.
  int item = 1;                     ///< Number of the item whose accelerometer it is.

  /// The controller's names of X and Z; empty: not on this controller.
  std::array<std::string, 2> axis_names(const StageConfig& stage) const;
};

/// The port of the stage's controller, or one for each axis. Empty for a stage without bytes.
std::vector<InstrumentPort> stage_ports(const StageConfig& stage);
/// The connections to a stage's port: itself, and "NAME-2" and so on for the others.
std::vector<InstrumentPort> connections_of(const InstrumentPort& port, std::size_t count);
/// The port of an item's accelerometer, or its several ports ("PORT PORT PORT"), as accelerometer_name()
/// calls them: "item-3", or "item-3-u" and so on. Empty for one without bytes.
std::vector<InstrumentPort> accelerometer_ports(const BenchConfig& config, int item);
/// The ports of all accelerometers of a bench, except those that are left out.
std::vector<InstrumentPort> all_accelerometer_ports(const BenchConfig& config);
/// The port of the thermometer and hygrometer; empty without one.
std::vector<InstrumentPort> environment_ports(const EnvironmentConfig& environment);

/// The port of the thermal chamber, if it has one.
std::vector<InstrumentPort> chamber_ports(const ChamberConfig& chamber);
/// Whether the chamber on a port speaks Modbus TCP, not RTU.
bool has_tcp_frames(const std::string& port);

}  // namespace abcal
