#include "drivers/registry.h"
#include "drivers/text_line/accelerometer.h"

namespace abcal {

void register_text_line(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "text_line",
       .description = "boards that print lines of numbers, output in the unit of the bench file",
       .serial = {115200, false},
       .make = make_accelerometer_of<TextLineAccelerometer>,
       .generic = true});
}

}  // namespace abcal
