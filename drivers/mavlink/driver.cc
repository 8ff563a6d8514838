#include "drivers/mavlink/accelerometer.h"
#include "drivers/mavlink/codec.h"
#include "drivers/registry.h"

namespace abcal {
namespace {

/// An autopilot's heartbeat, which is sent once a second without a request.
bool has_a_heartbeat(std::string_view received) {
  mavlink::FrameParser parser;
  parser.feed(received);
  for (auto frame = parser.next(); frame || parser.has_partial(); frame = parser.next_behind_partial()) {
    if (!frame) continue;
    const auto heartbeat = mavlink::decode_heartbeat(*frame);
    if (heartbeat && heartbeat->is_vehicle()) return true;
  }
  return false;
}

}  // namespace

void register_mavlink(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "mavlink",
       .description = "flight controllers that speak MAVLink (PX4, ArduPilot, ...), output in m/s2",
       .serial = {115200, false},
       .make = make_accelerometer_of<MavlinkAccelerometer>,
       .output_unit = "m/s2",
       .recognition = {"", has_a_heartbeat}});
  // "MAVLink" is a protocol, "PX4" a firmware.
  drivers.traits["mavlink"] = {.reports_maker = false, .reports_model = false};
}

}  // namespace abcal
