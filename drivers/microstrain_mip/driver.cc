#include "drivers/microstrain_mip/accelerometer.h"
#include "drivers/registry.h"

namespace abcal {

void register_microstrain_mip(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "microstrain_mip",
       .description = "MicroStrain 3DM, CV, CX, GX and GV sensors that speak MIP, output in g",
       .serial = {115200, false},
       .make = make_accelerometer_of<MipAccelerometer>,
       .output_unit = "g"});
}

}  // namespace abcal
