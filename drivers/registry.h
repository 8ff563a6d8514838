#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/driver_catalogue.h"
#include "drivers/instrument/environment_sensor.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/instrument/thermal_chamber.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// Settings of a driver's serial port where the bench file states none.
struct SerialDefaults {
  unsigned baud = 115200;
  bool rts_cts = false;
};

/// Recognition of an instrument on an unknown port before its driver asks it: by its unrequested output, or
/// by its answer to a question that changes nothing.
struct Recognition {
  /// Sent once to a port; empty: unrequested output must suffice. Even a binary one ends with CR LF, so that
  /// no instrument is left with half a line.
  std::string question{};
  /// Whether these bytes, all received so far at this driver's serial settings, come from such an instrument.
  /// Empty: identify() is tried, with its own time limits, once nothing else has been recognised.
  std::function<bool(std::string_view received)> knows{};
};

/// A driver of stages. An instrument on an unknown port is recognised by identify(): that of another one
/// throws kWrongIdentity, kNoReply or kBadFrame.
struct StageDriver {
  std::string name;         ///< Name in bench files, e.g. "pi_gcs".
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
  /// The axes of all controllers of a daisy chain, in the form of `axis` in a bench file, once this driver's
  /// instrument has been recognised. Sends queries only. Empty: its controllers form no chains.
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
  /// Accepts any device that looks like its instrument, because the instrument does not identify itself:
  /// tried after all others.
  bool generic = false;
  /// Lines of [accelerometer], in addition to driver and port, with which its simulated instrument is used in
  /// tests.
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

/// A driver of thermometers, hygrometers or barometers. A probe does not look for them.
struct EnvironmentDriver {
  std::string name;
  SerialDefaults serial;
  std::function<std::unique_ptr<EnvironmentSensor>(std::unique_ptr<wire::ByteStream>, Clock&,
                                                   const EnvironmentSettings&)>
      make;
};

/// A stage that a person turns.
struct ManualStageDriver {
  std::string name;
  std::function<std::unique_ptr<RotationStage>(const StageSettings&,
                                               std::function<void(std::string_view)> tell)>
      make;
};

/// A thermal chamber that a person sets.
struct ManualChamberDriver {
  std::string name;
  std::function<std::unique_ptr<ThermalChamber>(std::function<void(std::string_view)> tell,
                                                std::function<std::optional<std::string>()> answer,
                                                const ChamberSettings&)>
      make;
};

/// The list that the drivers' own registrations fill.
struct DriverList {
  std::vector<StageDriver> stages;
  /// Stages whose settings must have a description; separate, because without one none can be made or asked.
  std::vector<StageDriver> described_stages;
  std::vector<AccelerometerDriver> accelerometers;
  std::vector<ChamberDriver> chambers;
  std::vector<EnvironmentDriver> environments;
  std::vector<ManualStageDriver> manual_stages;
  std::vector<ManualChamberDriver> manual_chambers;
  /// By the driver's name; absent: none of them. They are separate from the drivers because programs that use
  /// libabcal pass StageDriver and AccelerometerDriver to it: the layout of these must not change.
  std::map<std::string, DriverTraits> traits;
};

/// The drivers of all folders that have a driver.cc, in the order of the folders' names, generic ones last.
/// Each of these folders registers itself with `void register_<folder>(DriverList&)`; its CMakeLists.txt
/// calls abcal_add_driver().
const std::vector<StageDriver>& stage_drivers();
const std::vector<StageDriver>& described_stage_drivers();
const std::vector<AccelerometerDriver>& accelerometer_drivers();
const std::vector<ChamberDriver>& chamber_drivers();
const std::vector<EnvironmentDriver>& environment_drivers();
const std::vector<ManualStageDriver>& manual_stage_drivers();
const std::vector<ManualChamberDriver>& manual_chamber_drivers();

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
