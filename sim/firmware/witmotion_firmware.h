#pragma once

#include <memory>
#include <optional>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct WitMotionSettings {
  unsigned baud = 115200;       ///< Speed in register 04; 9600 from the factory on most models.
  unsigned version = 17202;     ///< Register 2E, and fourth word of the angle frames.
  unsigned output_mask = 0x1E;  ///< Register 02: acceleration, gyro, angle, magnetic field.
  unsigned rate_code = 0x06;    ///< Register 03: 10 Hz.
  bool needs_unlock = true;     ///< False: as older modules, which write without FF AA 69 88 B5.
  Clock::Duration reply_delay = std::chrono::microseconds(500);
};

/// A WitMotion sensor (docs/protocols/witmotion.md), reading the world of a SimBench. Its output unit R is g,
/// in steps of 16/32768 g, clipped at +-16 g without a word. Gyro, magnetometer and angles show the motion of
/// the platter (SimBench::body_motion). Streams from power on, as they all do.
class WitMotionFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument for a baud rate or a rate code that it does not have.
  explicit WitMotionFirmware(std::shared_ptr<SimBench> bench, WitMotionSettings settings = {});

 private:
  class Device;
};

}  // namespace abcal::sim
