#include "drivers/registry.h"
#include "drivers/witmotion/accelerometer.h"
#include "drivers/witmotion/codec.h"

namespace abcal {
namespace {

/// A frame has one byte of sum: several of them are not accidental. It streams without a question.
bool streams_frames(std::string_view received) {
  constexpr int kEnough = 3;
  witmotion::FrameParser parser;
  parser.feed(received);
  int frames = 0;
  while (frames < kEnough && parser.next()) ++frames;
  return frames == kEnough;
}

}  // namespace

void register_witmotion(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "witmotion",
       .description = "WitMotion sensors (WT61, WT901, HWT901, ...), output in g",
       .serial = {9600, false},
       .make = make_accelerometer_of<WitMotionAccelerometer>,
       .output_unit = "g",
       .example = "rate_hz = 100.0\nbaud = 115200\n",
       .recognition = {"", streams_frames}});
  // The frames name neither; others make sensors with the same frames.
  drivers.traits["witmotion"] = {.reports_maker = false, .reports_model = false};
}

}  // namespace abcal
