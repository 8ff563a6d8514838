#include "drivers/pi_gcs/stage.h"
#include "drivers/registry.h"

namespace abcal {

void register_pi_gcs(DriverList& drivers) {
  drivers.stages.push_back(
      {.name = "pi_gcs",
       .description =
           "PI controllers that speak GCS 2.0 (C-884, C-863, E-861, ...), serial or TCP port 50000",
       .serial = {115200, false},
       .make = make_stage_of<pi_gcs::PiGcsStage>,
       .recognition = {"*IDN?\r\n",
                       [](std::string_view received) {
                         return received.find("Physik Instrumente") != std::string_view::npos;
                       }},
       .axes_on_line = pi_gcs::axes_on_line});
  drivers.traits["pi_gcs"] = {.last_chain_address = 16, .needs_chain_addresses = true};
}

}  // namespace abcal
