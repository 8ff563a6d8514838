#include "drivers/described/stage.h"
#include "drivers/registry.h"

namespace abcal {

void register_described(DriverList& drivers) {
  drivers.described_stages.push_back(
      {.name = "described",
       .description = "any stage that speaks lines of text, by its description",
       .serial = {9600, false},
       .make = make_stage_of<described::DescribedStage>});
}

}  // namespace abcal
