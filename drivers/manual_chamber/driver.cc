#include <memory>
#include <utility>

#include "drivers/manual_chamber/manual_chamber.h"
#include "drivers/registry.h"

namespace abcal {

void register_manual_chamber(DriverList& drivers) {
  drivers.manual_chambers.push_back(
      {.name = "manual_chamber",
       .make = [](auto tell, auto answer,
                  const ChamberSettings& settings) -> std::unique_ptr<ThermalChamber> {
         return std::make_unique<manual_chamber::ManualChamber>(
             manual_chamber::ManualChamber::Person{std::move(tell), std::move(answer)}, settings);
       }});
}

}  // namespace abcal
