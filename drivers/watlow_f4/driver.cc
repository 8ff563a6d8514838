#include "drivers/registry.h"
#include "drivers/watlow_f4/chamber.h"

namespace abcal {

void register_watlow_f4(DriverList& drivers) {
  drivers.chambers.push_back({.name = "watlow_f4",
                              .description = "chambers with a Watlow F4 or F4T controller, Modbus RTU or TCP",
                              .serial = {19200, false},
                              .make = make_chamber_of<watlow_f4::WatlowChamber>});
}

}  // namespace abcal
