#pragma once

#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct VectorNavSettings {
  std::string user_tag;
  std::string model = "VN-100T-CR";  ///< "VN-200..." and "VN-300...": with the registers of GNSS receivers.
  unsigned hardware_revision = 7;
  std::string serial_number = "0100012345";
  std::string firmware_version = "2.1.0.0";
  unsigned baud = 115200;       ///< One of the maker's; messages that it cannot carry are refused (error 0C).
  unsigned async_type = 14;     ///< Register 6 from the factory: YMR; 0: nothing.
  unsigned async_rate_hz = 40;  ///< Register 7 from the factory.
  unsigned serial_port = 1;     ///< The one that is wired, 1 or 2; registers 5 to 7 exist for both.
  Clock::Duration reply_delay = std::chrono::microseconds(500);
  /// Silence after VNRST [unverified against a device].
  Clock::Duration reset_time = std::chrono::milliseconds(300);
};

/// A VectorNav VN-100 (docs/protocols/vectornav.md), reading the world of a SimBench. Its output unit R is
/// m/s2: a truth of about 9.8 R per g_loc makes an ideal one. ASCII, asynchronous ASCII and binary outputs;
/// both checksums. Samples lie on the grid of its 800 Hz IMU, from the start of the world's time. One of its
/// two serial ports is wired; outputs on the other are noted (unserved()). Registers that tune the maker's
/// filter are kept and change nothing. Register 25 is applied. Attitude, gyro and magnetometer show the
/// motion of the platter (SimBench::body_motion), from the start on. Commands that are refused by VNERR are
/// noted too. A new baud rate holds from the end of its answer on.
class VectorNavFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument for a baud rate, type or output rate that a VN-100 does not have.
  explicit VectorNavFirmware(std::shared_ptr<SimBench> bench, VectorNavSettings settings = {});

 private:
  class Device;
};

}  // namespace abcal::sim
