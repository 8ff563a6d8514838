#pragma once

#include <memory>
#include <optional>
#include <utility>

#include "app/operate/bench/port_handover.h"
#include "drivers/instrument/thermal_chamber.h"

namespace abcal {

/// A chamber that hands its port to a guard before its first set point, so that it is left as its policy says
/// if this program dies. A missing guard is a warning, not an error.
class GuardedChamber final : public ThermalChamber {
 public:
  GuardedChamber(std::unique_ptr<ThermalChamber> chamber, PortHandover handover, ChamberPolicy policy)
      : chamber_(std::move(chamber)), handover_(std::move(handover)), policy_(policy) {}

  ChamberInfo identify() override { return chamber_->identify(); }
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
  PortHandover handover_;
  ChamberPolicy policy_;
  bool told_missing_ = false;
};

}  // namespace abcal
