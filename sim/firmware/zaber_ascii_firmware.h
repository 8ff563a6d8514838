#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct ZaberAsciiSettings {
  /// Where X and Z are on the line: "1 2" is axis 2 of device 1, a lone "2" axis 2 of `address`; empty: not
  /// on this line. Thus {"1 1", "1 2"} is a controller with two axes, and {"1 1", "2 1"} a daisy chain of two
  /// units with one axis each. A device has as many axes as its highest name needs.
  std::array<std::string, 2> axis_names{"1 1", "1 2"};
  int address = 1;  ///< Device of the names that name none.
  /// controller angle = zero + sign * protocol angle, once the axis has been homed
  std::array<int, 2> sign{+1, +1};
  std::array<Angle, 2> zero{};
  std::string serial_number = "54321";    ///< Serial number of the device of X.
  std::string z_serial_number = "54322";  ///< Serial number of the device of Z, if it is another one.
  std::string version = "7.38";  ///< Below 7: no "driver" and none of its flags, settings of firmware 6.
  std::string build = "16432";   ///< version.build
  /// deviceid of one with several axes, X-MCC2 [unverified against a device].
  unsigned controller_id = 30222;
  unsigned unit_id = 50009;  ///< deviceid of one with a single axis: X-RSW60A-E03.
  /// Models of the axes of a controller [unverified against a device].
  std::array<unsigned, 2> peripheral_ids{70009, 70009};
  std::array<double, 2> full_steps_per_turn{6000.0, 6000.0};
  int resolution = 64;  ///< Microsteps of a full step: 384000 of a turn.
  double max_speed_deg_per_s = 720.0;
  bool keeps_position_without_power = false;  ///< WH rather than WR until it is homed, and reads right.
  bool alerts = false;                        ///< comm.alert at power on.
  bool checksums = false;                     ///< comm.checksum at power on.
  bool detects_stalls = true;  ///< Its encoder shows a stall: flag FS; otherwise it stays busy.
  unsigned baud = 115200;
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
};

/// Zaber devices that speak ASCII on one line (docs/protocols/zaber_ascii.md), turning the axes of a
/// SimBench: a controller with two axes, or single-axis units in a daisy chain. All of them receive every
/// byte.
///
/// After power-on an axis reads 0 at any position until it is homed; the home sensor lies at the controller's
/// zero. An unknown command is rejected by BADCOMMAND, and noted (unserved()). comm.checksum, comm.alert and
/// the device number are kept without power, positions are not.
class ZaberAsciiFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument if a sign or the name of an axis is invalid.
  explicit ZaberAsciiFirmware(std::shared_ptr<SimBench> bench, ZaberAsciiSettings settings = {});

 private:
  class Chain;
};

}  // namespace abcal::sim
