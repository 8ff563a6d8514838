#include "drivers/newport_xps/stage.h"
#include "drivers/registry.h"

namespace abcal {
namespace {

/// Whether there is the answer to FirmwareVersionGet among them.
bool has_a_version(std::string_view received) {
  const std::size_t at = received.find("0,XPS");
  return at != std::string_view::npos && received.find(newport_xps::kReplyEnd, at) != std::string_view::npos;
}

}  // namespace

void register_newport_xps(DriverList& drivers) {
  drivers.stages.push_back(
      {.name = "newport_xps",
       .description = "Newport XPS-C8, XPS-Q8, XPS-D controllers on the network, one group for each axis",
       .serial = {115200, false},
       .make = [](auto streams, Clock& clock,
                  const StageSettings& settings) -> std::unique_ptr<RotationStage> {
         return std::make_unique<newport_xps::NewportXpsStage>(std::move(streams), clock, settings);
       },
       .recognition = {"FirmwareVersionGet(char *)\r\n", has_a_version},
       .connections = 3});
}

}  // namespace abcal
