#include "drivers/registry.h"
#include "drivers/thorlabs_apt/codec.h"
#include "drivers/thorlabs_apt/stage.h"

namespace abcal {
namespace {

/// Whether the messages include a controller's hardware information.
bool has_an_identity(std::string_view received) {
  while (!received.empty()) {
    const wire::FrameVerdict verdict = thorlabs_apt::check_message(received);
    if (verdict.check != wire::FrameCheck::kComplete) return false;
    const auto message = thorlabs_apt::parse_message(received.substr(0, verdict.length));
    if (message && thorlabs_apt::parse_info(*message)) return true;
    received.remove_prefix(verdict.length);
  }
  return false;
}

/// Asks both kinds of controller for their identity. The message at the end, addressed to no module, ends
/// with CR LF.
std::string question() {
  using namespace thorlabs_apt;
  std::string to_nobody = short_message(kNothing, 0, 0, '\r');
  to_nobody.back() = '\n';
  return short_message(kRequestInfo, 0, 0, kRack) + short_message(kRequestInfo, 0, 0, kUnit) + to_nobody;
}

}  // namespace

void register_thorlabs_apt(DriverList& drivers) {
  drivers.stages.push_back({.name = "thorlabs_apt",
                            .description =
                                "Thorlabs rotary stages on APT (Kinesis) controllers: K10CR1, HDR50, "
                                "DDR25, DDR100, PRM1-Z8",
                            .serial = {115200, true},
                            .make = make_stage_of<thorlabs_apt::ThorlabsAptStage>,
                            .recognition = {question(), has_an_identity}});
}

}  // namespace abcal
