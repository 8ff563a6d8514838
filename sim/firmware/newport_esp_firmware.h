#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct NewportEspSettings {
  /// The controller's numbers of X and Z, "1" to "6"; empty: that axis is not on this controller.
  std::array<std::string, 2> axis_names{"1", "2"};
  /// controller angle = zero + sign * protocol angle, once the axis has been homed
  std::array<int, 2> sign{+1, +1};
  std::array<Angle, 2> zero{};
  std::string version = "ESP301 Version 3.0.1 6/1/99";
  std::array<std::string, 2> stage_models{"URS100BCC", "URS100BCC"};
  /// Serial number of the stage that is X. The controller itself reports none.
  std::string serial_number = "12345";
  std::string z_serial_number = "12346";
  unsigned axes = 3;  ///< Axes of the controller; 6 for an ESP302. Axes with no stage report so.
  double max_speed_deg_per_s = 720.0;        ///< VU?
  double max_acceleration_deg_per_s2 = 1e5;  ///< AU?
  std::string line_end = "\r\n";             ///< Some units and emulators end replies with CR alone.
  bool unsolicited_errors = false;           ///< Sends "E37" and similar at once, for errors 35 to 42.
  Clock::Duration silence_after_limit = std::chrono::seconds(3);  ///< 2 to 5 s are seen.
  unsigned baud = 19200;
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
};

/// A Newport ESP300, ESP301 or ESP302 motion controller (docs/protocols/newport_esp.md), turning the axes of
/// a SimBench. Accepts the differing styles of host programs: any case, "01PA5.0", "1PA5" and "1 PA 5.0",
/// several commands joined by ';', CR or CR LF. An unknown command is error 6, and noted (unserved()).
///
/// Its encoders are incremental: wherever an axis is when the controller is switched on, it reads 0 until it
/// is homed (OR). The home switch lies at the controller's zero. The controller does not say whether an axis
/// was homed.
class NewportEspFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument if a sign or the name of an axis is invalid.
  explicit NewportEspFirmware(std::shared_ptr<SimBench> bench, NewportEspSettings settings = {});

 private:
  class Controller;
};

}  // namespace abcal::sim
