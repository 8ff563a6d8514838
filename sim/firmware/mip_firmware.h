#pragma once

#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct MipSettings {
  std::string model_name = "3DM-GV7-AR";
  std::string model_number = "6284-9999";
  std::string serial_number = "6284.123456";
  std::string lot_number = "I042Z";
  std::string options = "8g, 300dps";
  unsigned firmware_version = 1103;  ///< 1.1.03
  unsigned base_rate_hz = 1000;
  unsigned baud = 115200;
  bool magnetometer = true;            ///< An AR has none.
  bool legacy_commands = true;         ///< 0C,50; 0C,64; 0D,10 to 0D,41: as a GX5.
  bool modern_commands = true;         ///< 0C,0E and 0C,0F; 01,09; 0C,2A to 0C,2F; 0D,50: as a 7 series.
  bool streaming_at_power_on = false;  ///< The instrument's settings were saved with the stream on.
  Clock::Duration reply_delay = std::chrono::microseconds(200);
};

/// A MicroStrain accelerometer that speaks MIP (docs/protocols/mip.md), reading the world of a SimBench. Its
/// output unit R is g (field 80,04). Samples lie on the grid of its base rate, from the start of the world's
/// time. Its biases of accelerometer and gyro (0C,37 and 0C,38) are subtracted. Gyro, magnetometer and the
/// filter (data set 82), which comes up a second after it is reset, show the motion of the platter
/// (SimBench::body_motion); events can be set and are not carried out. Commands that it does not know are
/// refused by code 1, and noted (unserved()), as are commands with a field that the model does not have. A
/// new baud rate holds from the end of its answer on.
class MipFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument if the base rate or a text does not fit its field.
  explicit MipFirmware(std::shared_ptr<SimBench> bench, MipSettings settings = {});

 private:
  class Device;
};

}  // namespace abcal::sim
