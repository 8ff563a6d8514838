#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/thermal_chamber.h"

namespace abcal::manual_chamber {

/// A chamber that a person sets: the program shows the temperature, the person sets it, and types the value
/// that the chamber shows, or presses Enter. The chamber is not monitored: alarms and an open door remain
/// unknown to the program.
class ManualChamber final : public ThermalChamber {
 public:
  struct Person {
    std::function<void(std::string_view)> tell;
    /// A line that was typed; absent: no person answers any more.
    std::function<std::optional<std::string>()> answer;
  };

  /// @throws std::invalid_argument for settings that need a controller.
  ManualChamber(Person person, const ChamberSettings& settings);

  ChamberInfo identify() override;
  /// Returns once the person has confirmed. @throws InstrumentError kLinkLost if no person answers any more.
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void run() override { running_ = true; }
  void stop() override;
  /// The value that was confirmed or typed last. @throws InstrumentError kNotReady before the first set
  /// point.
  ChamberReading read() override;
  bool pause(bool) override { return false; }

 private:
  double confirmed(const std::string& question, double expected);

  Person person_;
  std::optional<double> set_degc_;
  double air_degc_ = 0.0;
  bool running_ = false;
};

}  // namespace abcal::manual_chamber
