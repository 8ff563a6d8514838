#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct ThorlabsAptSettings {
  /// Bays of X and Z, or "1" for a unit with one channel; text after the number is ignored. Empty: not on
  /// this controller.
  std::array<std::string, 2> axis_names{"1", "2"};
  /// controller angle = zero + sign * protocol angle, once the axis has been homed
  std::array<int, 2> sign{+1, +1};
  std::array<Angle, 2> zero{};
  std::string serial_number = "73123456";
  std::string model = "BBD202";  ///< K10CR1: a unit with one channel, else a controller with bays.
  std::string stage = "DDR100";  ///< In every bay.
  double counts_per_degree = 3276800.0 / 360.0;
  double velocity_per_count_s = 102.4e-6 * 65536.0;
  bool servo = true;  ///< Reports the servo's kind of status, and the stage that it drives.
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
};

/// A Thorlabs controller that speaks APT (docs/protocols/thorlabs_apt.md; [unverified against a device]),
/// turning the axes of a SimBench. Messages for other modules are skipped, and so are unknown ones, which are
/// noted (unserved()). A message that is not complete 50 ms after its last byte is dropped.
class ThorlabsAptFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument if a sign or the name of an axis is invalid.
  explicit ThorlabsAptFirmware(std::shared_ptr<SimBench> bench, ThorlabsAptSettings settings = {});

 private:
  class Controller;
};

}  // namespace abcal::sim
