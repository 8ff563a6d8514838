#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

#include "drivers/text/message.h"

namespace abcal {

/// Kind of a failure of an instrument. Two families are never merged: it refused (kRefused), and its state is
/// unknown (all the others).
enum class Fault {
  kRefused,        ///< The instrument replied with its own error code.
  kNoReply,        ///< The deadline passed with no complete reply.
  kBadFrame,       ///< Bytes arrived, but failed framing, checksum or decoding.
  kLinkLost,       ///< The port closed or vanished.
  kCannotOpen,     ///< The port could not be opened: absent, not permitted, held by another program.
  kWrongIdentity,  ///< Something else answers on this port.
  kNotReady,       ///< Called before it was started, homed or configured.
  kOutOfTravel,    ///< Target outside the travel of the stage or of the bench file.
  kStalled,        ///< Answering, but still moving at the motion timeout, or stopped outside the window.
  kImplausible,    ///< Readings that cannot be true: stuck, not finite, out of range.
};

/// The fault in a few words ("no reply"), for messages and records.
std::string_view to_string(Fault fault);
/// @return nothing for any other word
std::optional<Fault> fault_named(std::string_view words);

/// The one exception of all instruments: who, what, found, required. what() reads "<instrument>: <fault>:
/// <detail>", e.g. "stage C-884 (SN 0412): refused: error 7 (position out of limits) to \"MOV 1 400\"".
class InstrumentError : public Telling<std::runtime_error> {
 public:
  InstrumentError(std::string_view instrument, Fault fault, Message detail);
  /// A detail in English only, e.g. of a driver.
  InstrumentError(std::string_view instrument, Fault fault, std::string_view detail);

  Fault fault() const { return fault_; }
  const std::string& instrument() const { return instrument_; }
  const Message& detail() const { return detail_; }

 private:
  std::string instrument_;
  Fault fault_;
  Message detail_;
};

}  // namespace abcal
