#include "drivers/registry.h"
#include "drivers/vectornav/accelerometer.h"

namespace abcal {

void register_vectornav(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "vectornav",
       .description = "VectorNav VN-100, VN-200, VN-300 and their like, output in m/s2",
       .serial = {115200, false},
       .make = make_accelerometer_of<VectorNavAccelerometer>,
       .output_unit = "m/s2"});
}

}  // namespace abcal
