#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/firmware/reply_queue.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct MavlinkSettings {
  int version = 2;                                 ///< Version that it sends; it receives both.
  bool has_highres = true;                         ///< HIGHRES_IMU; else SCALED_IMU only.
  bool streams_at_power_on = false;                ///< HIGHRES_IMU, 50 a second.
  std::string serial_number = "0000000000000042";  ///< 16 hexadecimal digits.
  unsigned autopilot = 12;                         ///< PX4
  bool armed = false;
  bool has_parameters = true;  ///< Parameters of its first accelerometer.
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
};

/// A flight controller that speaks MAVLink (docs/protocols/mavlink.md), reading the world of a SimBench. Its
/// output unit R is m/s2. Sends a heartbeat once a second; HIGHRES_IMU and SCALED_IMU as often as
/// MAV_CMD_SET_MESSAGE_INTERVAL says, AUTOPILOT_VERSION when it is asked for. Parameters of
/// the first accelerometer (CAL_ACC0_* of PX4, INS_ACC* of ArduPilot) are read and set, are kept at once, and
/// are applied to the output: (raw - offset) scale. Other commands are answered
/// "not supported" and noted (unserved()). Gyroscope and magnetometer read 0.
class MavlinkFirmware final : public EncasedFirmware {
 public:
  explicit MavlinkFirmware(std::shared_ptr<SimBench> bench, MavlinkSettings settings = {});
  /// Switches off and on: everything is set from `bench` and `settings` again.
  void restart(std::shared_ptr<SimBench> bench, MavlinkSettings settings);

 private:
  class Device;
};

}  // namespace abcal::sim
