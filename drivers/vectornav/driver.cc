#include "drivers/registry.h"
#include "drivers/vectornav/accelerometer.h"
#include "drivers/vectornav/codec.h"

namespace abcal {
namespace {

bool has_a_frame(std::string_view received) {
  vectornav::MessageParser parser;
  parser.feed(received);
  return parser.next().has_value();
}

}  // namespace

void register_vectornav(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "vectornav",
       .description = "VectorNav VN-100, VN-200, VN-300 and similar, output in m/s2",
       .serial = {115200, false},
       .make = make_accelerometer_of<VectorNavAccelerometer>,
       .output_unit = "m/s2",
       .recognition = {"$VNRRG,01*72\r\n", has_a_frame}});
}

}  // namespace abcal
