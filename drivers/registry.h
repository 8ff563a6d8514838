#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/instrument/thermal_chamber.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// How a driver's serial port is set where the bench file does not say.
struct SerialDefaults {
  unsigned baud = 115200;
  bool rts_cts = false;
};

/// How an instrument on an unknown port is recognised before its driver asks it: by what it sends of its own
/// accord, or by its answer to a question that changes nothing.
struct Recognition {
  /// Sent once to a port; empty: what it sends by itself must do. Ends with CR LF, also a binary one:
  /// whatever instrument is there, no half of a line is left in it.
  std::string question{};
  /// Whether these bytes, all that came so far at this driver's serial settings, are such an instrument's.
  /// None: identify() is tried, with its own patience, once nothing else has been recognised.
  std::function<bool(std::string_view received)> knows{};
};

/// A driver of stages. An instrument on an unknown port is recognised by identify(): that of another one
/// throws kWrongIdentity, kNoReply or kBadFrame.
struct StageDriver {
  std::string name;         ///< As in a bench file, e.g. "pi_gcs".
  std::string description;  ///< For lists and error messages.
  SerialDefaults serial;
  /// From as many streams as there are connections. identify() uses the first one only.
  std::function<std::unique_ptr<RotationStage>(std::vector<std::unique_ptr<wire::ByteStream>>, Clock&,
                                               const StageSettings&)>
      make;
  Recognition recognition{};
  /// To the same port: a controller on the network may need one for each motion that it carries out. The axes
  /// are halted by the first one.
  std::size_t connections = 1;
  /// The axes on the line, where this driver's instrument has been recognised, as `axis` names them in a
  /// bench file: of all controllers of a daisy chain. Asks only. None: its controllers make no chains.
  std::function<std::vector<std::string>(std::unique_ptr<wire::ByteStream>, Clock&)> axes_on_line{};
};

/// A driver of accelerometers, recognised in the same way.
struct AccelerometerDriver {
  std::string name;
  std::string description;
  SerialDefaults serial;
  /// From as many streams as there are ports, nearly always one.
  std::function<std::unique_ptr<Accelerometer>(std::vector<std::unique_ptr<wire::ByteStream>>, Clock&,
                                               const AccelerometerSettings&)>
      make;
  std::size_t ports = 1;
  std::string output_unit{};  ///< "g", "m/s2"; empty: that of the bench file.
  /// It takes whatever looks like its instrument, as nothing says what it is: tried after all others.
  bool generic = false;
  /// Lines of [accelerometer], beside driver and port, with which its simulated instrument is used in tests.
  std::string example = "rate_hz = 100.0\n";
  Recognition recognition{};
};

/// A driver of thermal chambers, recognised in the same way.
struct ChamberDriver {
  std::string name;
  std::string description;
  SerialDefaults serial;
  std::function<std::unique_ptr<ThermalChamber>(std::vector<std::unique_ptr<wire::ByteStream>>, Clock&,
                                                const ChamberSettings&)>
      make;
  Recognition recognition{};
};

/// What the drivers' own registrations fill in.
struct DriverList {
  std::vector<StageDriver> stages;
  std::vector<AccelerometerDriver> accelerometers;
  std::vector<ChamberDriver> chambers;
};

/// The drivers of all folders that have a driver.cc, in the order of the folders' names, generic ones
/// last. Such a folder
/// registers itself with `void register_<folder>(DriverList&)`; its CMakeLists.txt calls abcal_add_driver().
const std::vector<StageDriver>& stage_drivers();
const std::vector<AccelerometerDriver>& accelerometer_drivers();
const std::vector<ChamberDriver>& chamber_drivers();

// For registrations: a driver that is made of one stream, the clock and its settings.

template <class Driver>
std::unique_ptr<RotationStage> make_stage_of(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                             Clock& clock, const StageSettings& settings) {
  return std::make_unique<Driver>(std::move(streams.at(0)), clock, settings);
}

template <class Driver>
std::unique_ptr<Accelerometer> make_accelerometer_of(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                                     Clock& clock, const AccelerometerSettings& settings) {
  return std::make_unique<Driver>(std::move(streams.at(0)), clock, settings);
}

template <class Driver>
std::unique_ptr<ThermalChamber> make_chamber_of(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                                Clock& clock, const ChamberSettings& settings) {
  return std::make_unique<Driver>(std::move(streams.at(0)), clock, settings);
}

}  // namespace abcal
