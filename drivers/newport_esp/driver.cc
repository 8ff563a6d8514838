#include "drivers/newport_esp/stage.h"
#include "drivers/registry.h"

namespace abcal {

void register_newport_esp(DriverList& drivers) {
  drivers.stages.push_back({.name = "newport_esp",
                            .description = "Newport ESP301, ESP300 and ESP302 over RS-232",
                            .serial = {19200, true},
                            .make = make_stage_of<newport_esp::NewportEspStage>,
                            .recognition = {"VE?\r\n", [](std::string_view received) {
                                              return received.find("ESP30") != std::string_view::npos;
                                            }}});
}

}  // namespace abcal
