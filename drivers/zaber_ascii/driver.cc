#include "drivers/registry.h"
#include "drivers/zaber_ascii/stage.h"

namespace abcal {

void register_zaber_ascii(DriverList& drivers) {
  drivers.stages.push_back(
      {.name = "zaber_ascii",
       .description = "Zaber rotary stages that speak ASCII, on one controller or in a daisy chain",
       .serial = {115200, false},
       .make = make_stage_of<zaber_ascii::ZaberAsciiStage>});
}

}  // namespace abcal
