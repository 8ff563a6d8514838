#include "drivers/registry.h"
#include "drivers/text/text.h"
#include "drivers/weiss_simserv/chamber.h"
#include "drivers/weiss_simserv/codec.h"

namespace abcal {
namespace {

/// Whether there is a whole line of simserv with the type, or the state of an ASCII-2 chamber.
bool is_a_chamber(std::string_view received) {
  for (const std::string_view line : pieces::split(received, '\r')) {
    const std::string_view text = pieces::trimmed(line);
    const auto reply = weiss_simserv::parse_simserv(text);
    if (reply && reply->code == 1 && reply->values.size() == 1) return true;
    if (weiss_simserv::parse_state(text)) return true;
  }
  return false;
}

}  // namespace

void register_weiss_simserv(DriverList& drivers) {
  drivers.chambers.push_back(
      {.name = "weiss_simserv",
       .description = "Weiss and Voetsch chambers: S!MPAC simserv or ASCII-2, TCP 2049",
       .serial = {9600, false},
       .make = make_chamber_of<weiss_simserv::WeissChamber>,
       .recognition = {
           weiss_simserv::simserv_request(99997, {"1"}) + weiss_simserv::plain_command(1, 'I') + "\n",
           is_a_chamber}});
  drivers.traits["weiss_simserv"] = {.tells_humidity = true};
}

}  // namespace abcal
