#pragma once

#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"

namespace abcal {

/// State in which a chamber is left when a series ends.
enum class ChamberPolicy {
  kHold,     ///< It continues at its last set point.
  kAmbient,  ///< It is driven to 23 degC, and continues.
  kOff,      ///< It is driven to 23 degC first, then switched off: an item that is cold would be iced.
};

/// Where kAmbient and kOff drive a chamber, degC.
inline constexpr double kAmbientDegc = 23.0;

/// Settings of a thermal chamber in a bench file, as far as a driver needs them. Each driver reads only those
/// that concern it.
struct ChamberSettings {
  std::string model;         ///< "F4", "F4T", "simserv", "ascii2"; empty: the driver asks.
  int address = 1;           ///< Modbus unit, or ASCII-2 address.
  bool tcp_framing = false;  ///< Modbus TCP frames; else RTU.
  bool humidity = false;     ///< Its second channel measures the relative humidity.
  int run_output = 1;        ///< The event output or digital channel that starts and stops it.
  int pause_output = 0;      ///< The one that pauses compressor or fan while it is on; 0: none.
  int door_input = 0;        ///< The digital input that is on while the door is open; 0: none.
  std::string serial_number{};

  bool operator==(const ChamberSettings&) const = default;
};

struct ChamberInfo {
  std::string maker;
  std::string model;
  std::string serial_number;  ///< Empty: not reported.
  std::string firmware;
  double least_set_degc = 0.0;  ///< Set points that its own hardware accepts.
  double most_set_degc = 0.0;
  bool can_ramp = false;   ///< It has a rate of its own; else it goes as fast as it can.
  bool can_pause = false;  ///< pause() pauses its compressor or fan.
  bool has_humidity = false;
};

/// Present state of a chamber, as it reports it.
struct ChamberReading {
  double air_degc = 0.0;
  std::optional<double> humidity_percent;  ///< Relative.
  double set_degc = 0.0;  ///< During a ramp: the moving set point, if the chamber reports it.
  bool running = false;
  bool door_open = false;
  std::vector<std::string> alarms;  ///< In words; empty: none.
};

/// A thermal chamber. Every call either succeeds or throws InstrumentError within the driver's own reply
/// deadline. All temperatures in degC: a driver verifies the unit of the chamber. One owner at a time.
class ThermalChamber {
 public:
  virtual ~ThermalChamber() = default;

  /// Queries the identity and reads the limits of its hardware. Changes nothing.
  /// @throws InstrumentError kWrongIdentity if it is not a chamber that this driver knows, or if its unit is
  /// not degC.
  virtual ChamberInfo identify() = 0;

  /// Sets the temperature, verifies the unit before and reads the set point back. Does not start the chamber.
  /// @param rate_k_per_min  the chamber's own ramp; absent, or if the chamber has none: as fast as it can
  /// @throws InstrumentError kOutOfTravel outside the limits of its hardware; kRefused; kNotReady before
  /// identify()
  virtual void set_temperature(double degc, std::optional<double> rate_k_per_min) = 0;

  virtual void run() = 0;
  virtual void stop() = 0;

  virtual ChamberReading read() = 0;

  /// Pauses compressor or fan, so that nothing vibrates during a dwell, or lets them continue.
  /// @return false if it cannot, and nothing was done
  virtual bool pause(bool paused) = 0;

  /// Recipe that leaves the chamber according to `policy` without this driver, valid from now until the
  /// driver's end: compressor or fan go on, and by kAmbient and kOff it is driven to 23 degC as fast as it
  /// can. It is not switched off once it is warm. Bytes hold the temperature in the unit that identify() has
  /// verified.
  /// @return nullopt if no action is needed, or if none is possible
  /// @throws InstrumentError kNotReady before identify()
  virtual std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) {
    (void)policy;
    return std::nullopt;
  }
};

}  // namespace abcal
