#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "drivers/instrument/clock.h"

namespace abcal {

class CorrectionRegisters;

/// The three single-axis accelerometers inside the triaxial one (x, y, z are the LGCS's axes).
enum AccelerometerIndex : int { kU = 0, kV = 1, kW = 2 };

struct AccelerometerInfo {
  std::string maker;
  std::string model;
  std::string serial_number;
  std::string firmware;
  std::string output_unit;  ///< Unit of Reading::output, e.g. "g", "m/s2", "V", "LSB": the response unit R.
  std::optional<double> full_scale;  ///< Largest magnitude an output can show, in output_unit.
  std::optional<double> resolution;  ///< Smallest step of the output, in output_unit.
  double rate_hz = 0.0;              ///< Readings per second once started; 0: on demand.
};

/// One output triple.
struct Reading {
  Eigen::Vector3d output = Eigen::Vector3d::Zero();  ///< u, v, w in AccelerometerInfo::output_unit.
  /// Counts the readings that the instrument made, so a gap is a loss. From the instrument's own counter or
  /// time stamp where it has one; else the driver counts the received readings and the losses that it knows
  /// of.
  std::uint64_t sequence = 0;
  Clock::Instant arrival;  ///< Arrival of its last byte; sometimes late, never early.
  std::optional<double> temperature_degc;
  bool over_range = false;  ///< The instrument reports that it clipped.
};

/// Losses and errors of the stream since start(). The counts never decrease.
struct StreamHealth {
  std::uint64_t readings = 0;       ///< Delivered or waiting.
  std::uint64_t lost_readings = 0;  ///< Known to have been made and not received (gaps, full queue).
  std::uint64_t bad_frames = 0;     ///< Framed, but with a wrong checksum or length: skipped.
  std::uint64_t skipped_bytes = 0;  ///< Bytes that belong to no frame.
};

/// A triaxial accelerometer. One owner at a time.
class Accelerometer {
 public:
  virtual ~Accelerometer() = default;

  /// Queries the identity of the instrument (stopping its stream first if necessary). Changes no stored
  /// setting.
  /// @throws InstrumentError kWrongIdentity if it is not an instrument this driver knows.
  virtual AccelerometerInfo identify() = 0;

  /// Corrections that the instrument itself currently applies to its output, by name and in its own words:
  /// the item is calibrated with them. Empty if the instrument has none, or was not asked. Call it after
  /// identify() and before start().
  virtual std::map<std::string, std::string> correction_registers() { return {}; }

  /// The corrections that can be written; null: none. Valid until the instrument is opened again.
  virtual CorrectionRegisters* corrections() { return nullptr; }

  /// Configures the output and starts it.
  virtual void start() = 0;

  /// The next reading, or nullopt if none has arrived by `deadline` (that is not an error here: the caller
  /// knows how long is too long).
  /// @throws InstrumentError kLinkLost, kNotReady before start().
  virtual std::optional<Reading> next(Clock::Instant deadline) = 0;

  /// Discards readings that arrived before now. They do not count as lost.
  virtual void discard_pending() = 0;

  virtual StreamHealth health() const = 0;

  /// Stops the output; failure is not reported, as this is called on the way out.
  virtual void stop() noexcept = 0;
};

}  // namespace abcal
