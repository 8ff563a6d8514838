#include "app/operate/bench/guarded_chamber.h"

#include <vector>

namespace abcal {

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
