#include "drivers/microstrain_mip/accelerometer.h"
#include "drivers/microstrain_mip/codec.h"
#include "drivers/registry.h"

namespace abcal {
namespace {

bool has_a_frame(std::string_view received) {
  mip::PacketParser parser;
  parser.feed(received);
  return parser.next().has_value();
}

}  // namespace

void register_microstrain_mip(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "microstrain_mip",
       .description = "MicroStrain 3DM, CV, CX, GX and GV sensors with the MIP protocol, output in g",
       .serial = {115200, false},
       .make = make_accelerometer_of<MipAccelerometer>,
       .output_unit = "g",
       .recognition = {std::string("\x75\x65\x01\x02\x02\x01\xE0\xC6\r\n", 10), has_a_frame}});
}

}  // namespace abcal
