#include "drivers/wire/wire_event.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

namespace abcal::wire {
namespace {

constexpr std::array kFaults{Fault::kRefused,    Fault::kNoReply,       Fault::kBadFrame, Fault::kLinkLost,
                             Fault::kCannotOpen, Fault::kWrongIdentity, Fault::kNotReady, Fault::kOutOfTravel,
                             Fault::kStalled,    Fault::kImplausible};

constexpr std::array<std::pair<WireCall, std::string_view>, 3> kCalls{
    {{WireCall::kWrite, "write"}, {WireCall::kRead, "read"}, {WireCall::kDiscard, "discard"}}};

/// The text up to the next line end, which is taken off together with it.
std::string_view take_line(std::string_view& text) {
  const std::size_t end = text.find('\n');
  const std::string_view line = text.substr(0, end);
  text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
  return line;
}

}  // namespace

std::string failure_text(WireCall call, const InstrumentError& error) {
  const auto name =
      std::find_if(kCalls.begin(), kCalls.end(), [&](const auto& c) { return c.first == call; });
  return fmt::format("{}\n{}\n{}\n{}", name->second, to_string(error.fault()), error.instrument(),
                     error.detail());
}

WireFailure parse_failure(std::string_view text) {
  const std::string_view whole = text;
  const std::string_view call_name = take_line(text);
  const std::string_view fault_name = take_line(text);
  const std::string_view who = take_line(text);
  const auto call =
      std::find_if(kCalls.begin(), kCalls.end(), [&](const auto& c) { return c.second == call_name; });
  const auto fault =
      std::find_if(kFaults.begin(), kFaults.end(), [&](Fault f) { return to_string(f) == fault_name; });
  if (call == kCalls.end() || fault == kFaults.end()) {
    throw std::invalid_argument(
        fmt::format("\"{}\" in a recording is not a failure of a stream; required: call, fault, instrument "
                    "and detail, one line each",
                    whole));
  }
  return {call->first, InstrumentError(who, *fault, text)};
}

}  // namespace abcal::wire
