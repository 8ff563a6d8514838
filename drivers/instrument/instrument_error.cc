#include "drivers/instrument/instrument_error.h"

namespace abcal {

std::string_view to_string(Fault fault) {
  switch (fault) {
    case Fault::kRefused:
      return "refused";
    case Fault::kNoReply:
      return "no reply";
    case Fault::kBadFrame:
      return "bad frame";
    case Fault::kLinkLost:
      return "link lost";
    case Fault::kCannotOpen:
      return "cannot open";
    case Fault::kWrongIdentity:
      return "wrong instrument";
    case Fault::kNotReady:
      return "not ready";
    case Fault::kOutOfTravel:
      return "out of travel";
    case Fault::kStalled:
      return "stalled";
    case Fault::kImplausible:
      return "implausible readings";
  }
  return "unknown fault";
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
