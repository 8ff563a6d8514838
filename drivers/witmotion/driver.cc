#include "drivers/registry.h"
#include "drivers/witmotion/accelerometer.h"

namespace abcal {

void register_witmotion(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "witmotion",
       .description = "WitMotion sensors (WT61, WT901, HWT901, ...), output in g",
       .serial = {9600, false},
       .make = make_accelerometer_of<WitMotionAccelerometer>,
       .output_unit = "g",
       .example = "rate_hz = 100.0\nbaud = 115200\n"});
}

}  // namespace abcal
