#include "drivers/registry.h"
#include "drivers/xsens_mti/accelerometer.h"
#include "drivers/xsens_mti/codec.h"

namespace abcal {
namespace {

bool has_a_frame(std::string_view received) {
  xbus::MessageParser parser;
  parser.feed(received);
  return parser.next().has_value();
}

}  // namespace

void register_xsens_mti(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "xsens_mti",
       .description = "Xsens (Movella) MTi sensors that speak Xbus with MTData2, output in m/s2",
       .serial = {115200, false},
       .make = make_accelerometer_of<XsensMtiAccelerometer>,
       .output_unit = "m/s2",
       .recognition = {std::string("\xFA\xFF\x00\x00\x01\r\n", 7), has_a_frame}});
}

}  // namespace abcal
