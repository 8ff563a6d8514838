#include "drivers/wire/wire_event.h"

#include <fmt/format.h>

#include <stdexcept>

#include "drivers/text/names.h"

namespace abcal::wire {
namespace {

constexpr auto kCalls = names<WireCall>(
    {{WireCall::kWrite, "write"}, {WireCall::kRead, "read"}, {WireCall::kDiscard, "discard"}});

/// The text up to the next line end, which is taken off together with it.
std::string_view take_line(std::string_view& text) {
  const std::size_t end = text.find('\n');
  const std::string_view line = text.substr(0, end);
  text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
  return line;
}

}  // namespace

std::string failure_text(WireCall call, const InstrumentError& error) {
  return fmt::format("{}\n{}\n{}\n{}", kCalls.of(call), to_string(error.fault()), error.instrument(),
                     error.detail());
}

WireFailure parse_failure(std::string_view text) {
  const std::string_view whole = text;
  const auto call = kCalls.value(take_line(text));
  const auto fault = fault_named(take_line(text));
  const std::string_view who = take_line(text);
  if (!call || !fault) {
    throw std::invalid_argument(
        fmt::format("\"{}\" in a recording is not a failure of a stream; required: call, fault, instrument "
                    "and detail, one line each",
                    whole));
  }
  return {*call, InstrumentError(who, *fault, text)};
}

}  // namespace abcal::wire
