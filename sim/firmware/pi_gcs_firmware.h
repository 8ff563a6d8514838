#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct PiGcsSettings {
  /// The controller's names of X and Z; empty: that axis is not on this line. "2 1" is axis 1 of controller 2
  /// of a daisy chain, a lone "1" that of controller `address`. Thus {"1 1", "2 1"} is a chain of two
  /// controllers.
  std::array<std::string, 2> axis_names{"1", "2"};
  /// controller angle = zero + sign * protocol angle
  std::array<int, 2> sign{+1, +1};
  std::array<Angle, 2> zero{};
  std::string model = "C-884.4DC";
  std::string serial_number = "118001234";
  std::string z_serial_number = "118001235";  ///< Serial number of the controller of Z, if it is another one.
  std::string firmware_version = "1.2.3.4";
  std::array<std::string, 2> stage_names{"M-060.PD", "M-060.PD"};
  int address = 1;  ///< In a daisy chain; 1 answers without an address as well.
  double max_speed_deg_per_s = 720.0;
  double settle_s = 0.01;      ///< Parameter 0x3F: how long ONT? waits after the motion.
  bool has_enable = true;      ///< False: EAX is an unknown command, as on many controllers.
  bool has_unit_query = true;  ///< False: PUN? is unknown, as on E-861; parameter 0x7000601 gives the unit.
  /// "..., E-861 Version 7.2.0": model and firmware in one field and no serial number, as in older firmware.
  bool short_identity = false;
  unsigned baud = 115200;
  Clock::Duration reply_delay = std::chrono::microseconds(200);
};

/// One PI controller that speaks GCS 2.0 (docs/protocols/pi_gcs.md), or two of them in a daisy chain, each of
/// which receives every byte and answers messages with its address; turning the axes of a SimBench. Accepts
/// the differing styles of host programs: any case, CR LF, several blanks, with or without axes, with or
/// without address, parameters by decimal or hexadecimal number. An unknown command is answered as the
/// maker's controllers do, by error 2 and silence, and noted (unserved()).
class PiGcsFirmware final : public Firmware {
 public:
  explicit PiGcsFirmware(std::shared_ptr<SimBench> bench, PiGcsSettings settings = {});
  ~PiGcsFirmware() override;

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void session_starts() override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override;

 private:
  class Controller;
  std::vector<std::unique_ptr<Controller>> controllers_;
};

}  // namespace abcal::sim
