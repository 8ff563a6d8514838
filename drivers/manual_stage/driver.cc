#include "drivers/manual_stage/manual_stage.h"
#include "drivers/registry.h"

namespace abcal {

void register_manual_stage(DriverList& drivers) {
  drivers.manual_stages.push_back({.name = "manual_stage", .make = manual_stage::at_terminal});
}

}  // namespace abcal
