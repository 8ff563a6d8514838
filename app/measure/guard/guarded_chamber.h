#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "app/measure/guard/halt_guard.h"
#include "drivers/instrument/thermal_chamber.h"

namespace abcal {

/// A chamber on a port that a guard has opened. Before its first set point the guard receives the recipe that
/// leaves it as its policy states, if this program dies or gives no sign of life for a minute. The guard
/// holds the lease of the chamber once that has identified itself.
class GuardedChamber final : public ThermalChamber {
 public:
  /// @param port  InstrumentPort::name
  /// @param driver  InstrumentPort::driver
  GuardedChamber(std::unique_ptr<ThermalChamber> chamber, std::shared_ptr<HaltGuard> guard, std::string port,
                 std::string driver, ChamberPolicy policy)
      : chamber_(std::move(chamber)),
        guard_(std::move(guard)),
        port_(std::move(port)),
        driver_(std::move(driver)),
        policy_(policy) {}

  ChamberInfo identify() override;
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void run() override { chamber_->run(); }
  void stop() override { chamber_->stop(); }
  ChamberReading read() override { return chamber_->read(); }
  bool pause(bool paused) override { return chamber_->pause(paused); }
  std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) override {
    return chamber_->rest_recipe(policy);
  }

 private:
  std::unique_ptr<ThermalChamber> chamber_;
  std::shared_ptr<HaltGuard> guard_;
  const std::string port_, driver_;
  ChamberPolicy policy_;
  bool is_held_ = false;  ///< The guard has the recipe.
};

}  // namespace abcal
