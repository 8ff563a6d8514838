#include "drivers/instrument/instrument_error.h"

#include "drivers/text/names.h"

namespace abcal {

constexpr auto kFaults = names<Fault>({{Fault::kRefused, "refused"},
                                       {Fault::kNoReply, "no reply"},
                                       {Fault::kBadFrame, "bad frame"},
                                       {Fault::kLinkLost, "link lost"},
                                       {Fault::kCannotOpen, "cannot open"},
                                       {Fault::kWrongIdentity, "wrong instrument"},
                                       {Fault::kNotReady, "not ready"},
                                       {Fault::kOutOfTravel, "out of travel"},
                                       {Fault::kStalled, "stalled"},
                                       {Fault::kImplausible, "implausible readings"}});

std::string_view to_string(Fault fault) {
  return kFaults.of(fault, "unknown fault");
}

std::optional<Fault> fault_named(std::string_view words) {
  return kFaults.value(words);
}

namespace {
std::string message(std::string_view instrument, Fault fault, std::string_view detail) {
  std::string text(instrument);
  text.append(": ").append(to_string(fault));
  if (!detail.empty()) text.append(": ").append(detail);
  return text;
}
}  // namespace

InstrumentError::InstrumentError(std::string_view instrument, Fault fault, std::string_view detail)
    : std::runtime_error(message(instrument, fault, detail)),
      instrument_(instrument),
      fault_(fault),
      detail_(detail) {}

}  // namespace abcal
