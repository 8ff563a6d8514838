#include "drivers/registry.h"
#include "drivers/text/text.h"
#include "drivers/zaber_ascii/stage.h"

namespace abcal {
namespace {

/// Whether there is a whole line "@01 0 OK IDLE -- 2" among them.
bool is_a_reply(std::string_view received) {
  for (const std::string_view line : pieces::split(received, '\n')) {
    const std::size_t at = line.find('@');
    if (at == std::string_view::npos || !line.ends_with('\r')) continue;
    const std::vector<std::string_view> words = pieces::words(line.substr(at + 1));
    if (words.size() >= 6 && words[0].size() == 2 && (words[2] == "OK" || words[2] == "RJ")) return true;
  }
  return false;
}

}  // namespace

void register_zaber_ascii(DriverList& drivers) {
  drivers.stages.push_back(
      {.name = "zaber_ascii",
       .description = "Zaber rotary stages that speak ASCII, on one controller or in a daisy chain",
       .serial = {115200, false},
       .make = make_stage_of<zaber_ascii::ZaberAsciiStage>,
       .recognition = {"/get system.axiscount\r\n", is_a_reply},
       .axes_on_line = zaber_ascii::axes_on_line});
  drivers.traits["zaber_ascii"] = {.last_chain_address = 99};
}

}  // namespace abcal
