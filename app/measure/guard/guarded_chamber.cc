#include "app/measure/guard/guarded_chamber.h"

#include <vector>

#include "app/measure/bench/instrument_leases.h"

namespace abcal {

ChamberInfo GuardedChamber::identify() {
  ChamberInfo info = chamber_->identify();
  guard_->lease(port_, resources_of_instrument(driver_, info.maker, info.model, info.serial_number));
  return info;
}

void GuardedChamber::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  if (!is_held_) {
    if (const auto recipe = chamber_->rest_recipe(policy_)) {
      guard_->hold(port_, {*recipe});
      guard_->drive_chamber();
    }
    is_held_ = true;
  }
  chamber_->set_temperature(degc, rate_k_per_min);
}

}  // namespace abcal
