#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/thermal_chamber.h"

namespace abcal::manual_chamber {

/// A chamber that a person sets: the program says which temperature, the person sets it, and types what the
/// chamber shows, or presses Enter. It is not watched: nobody tells the program of an alarm or a door.
class ManualChamber final : public ThermalChamber {
 public:
  struct Person {
    std::function<void(std::string_view)> tell;
    /// A line that was typed; nothing: there is nobody any more.
    std::function<std::optional<std::string>()> answer;
  };

  /// @throws std::invalid_argument for settings that need a controller.
  ManualChamber(Person person, const ChamberSettings& settings);

  ChamberInfo identify() override;
  /// Returns once the person has confirmed. @throws InstrumentError kLinkLost if nobody answers any more.
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void run() override { running_ = true; }
  void stop() override;
  /// What was confirmed or typed last. @throws InstrumentError kNotReady before the first set point.
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
