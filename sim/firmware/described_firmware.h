#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "drivers/instrument/stage_description.h"
#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct DescribedSettings {
  std::array<std::string, 2> axis_names{"1", "2"};  ///< X and Z; empty: not on this line.
  std::string address;                              ///< Empty: that of the description.
  /// Where the description leaves the units of a degree to the bench file.
  std::array<std::optional<double>, 2> units_per_degree{};
  /// controller angle = zero + sign * protocol angle
  std::array<int, 2> sign{+1, +1};
  std::array<Angle, 2> zero{};
  std::string serial_number = "EMULATED";
  Clock::Duration reply_delay = std::chrono::milliseconds(1);
};

/// The controller that a description describes, turning the axes of a SimBench. It answers what the
/// description has, and nothing else: it is no proof that the description is right. After power-on nothing is
/// prepared or homed; an axis reads its true angle all the same.
class DescribedFirmware final : public EncasedFirmware {
 public:
  /// @throws std::invalid_argument if a sign is invalid.
  DescribedFirmware(std::shared_ptr<SimBench> bench, std::shared_ptr<const StageDescription> description,
                    DescribedSettings settings = {});

 private:
  class Controller;
};

}  // namespace abcal::sim
