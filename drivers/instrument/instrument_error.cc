#include "drivers/instrument/instrument_error.h"

#include <array>
#include <utility>

#include "drivers/text/names.h"

namespace abcal {
namespace {

constexpr auto kFaults = names<Fault, Term>({{Fault::kRefused, "refused"},
                                             {Fault::kNoReply, "no reply"},
                                             {Fault::kBadFrame, "bad frame"},
                                             {Fault::kLinkLost, "link lost"},
                                             {Fault::kCannotOpen, "cannot open"},
                                             {Fault::kWrongIdentity, "wrong instrument"},
                                             {Fault::kNotReady, "not ready"},
                                             {Fault::kOutOfTravel, "out of travel"},
                                             {Fault::kStalled, "stalled"},
                                             {Fault::kImplausible, "implausible readings"}});

Term words_of(Fault fault) {
  return kFaults.of(fault, "unknown fault");
}

/// Instruments that messages name by their role alone.
constexpr std::array<Term, 4> kRoles{"stage", "accelerometer", "chamber", "items"};

Message sentence(std::string_view instrument, Fault fault, const Message& detail) {
  const Message name = word_of(kRoles, instrument);
  if (detail.empty()) return {"{instrument}: {fault}", name, words_of(fault)};
  return {"{instrument}: {fault}: {detail}", name, words_of(fault), detail};
}

}  // namespace

std::string_view to_string(Fault fault) {
  return words_of(fault);
}

std::optional<Fault> fault_named(std::string_view words) {
  return kFaults.value(words);
}

InstrumentError::InstrumentError(std::string_view instrument, Fault fault, Message detail)
    : Telling(sentence(instrument, fault, detail)),
      instrument_(instrument),
      fault_(fault),
      detail_(std::move(detail)) {}

// In this file, as drivers outside of the shared library link to it: of Message it exports nothing.
InstrumentError::InstrumentError(std::string_view instrument, Fault fault, std::string_view detail)
    : InstrumentError(instrument, fault, Message::bare(std::string(detail))) {}

}  // namespace abcal
