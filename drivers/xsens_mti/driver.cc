#include "drivers/registry.h"
#include "drivers/xsens_mti/accelerometer.h"

namespace abcal {

void register_xsens_mti(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "xsens_mti",
       .description = "Xsens (Movella) MTi sensors that speak Xbus with MTData2, output in m/s2",
       .serial = {115200, false},
       .make = make_accelerometer_of<XsensMtiAccelerometer>,
       .output_unit = "m/s2"});
}

}  // namespace abcal
