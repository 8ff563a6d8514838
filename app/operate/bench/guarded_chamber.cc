#include "app/operate/bench/guarded_chamber.h"

#include <fmt/format.h>

#include <exception>
#include <vector>

#include "app/ground/system/output.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {

void GuardedChamber::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  try {
    if (const auto recipe = chamber_->rest_recipe(policy_))
      handover_.ensure([&] { return std::vector{*recipe}; });
  } catch (const InstrumentError&) {  // set_temperature() below fails with the reason.
  } catch (const std::exception& error) {
    if (!std::exchange(told_missing_, true))
      print_warning(
          fmt::format("The chamber keeps its last set point if this program dies ({}): it may go on heating.",
                      error.what()));
  }
  chamber_->set_temperature(degc, rate_k_per_min);
}

}  // namespace abcal
