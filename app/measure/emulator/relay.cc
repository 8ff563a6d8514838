#include "app/measure/emulator/relay.h"

#include <utility>

namespace abcal {
namespace {

/// Interval between reads of the instrument's bytes: below a character time of 9600 Bd, far below what a host
/// notices.
constexpr std::chrono::milliseconds kLookEvery{1};

}  // namespace

Relay::Relay(std::unique_ptr<wire::ByteStream> instrument, WireLogWriter& log, Clock::Instant start)
    : instrument_(std::move(instrument)), log_(log), start_(start), next_look_(start) {}

void Relay::receive(std::string_view bytes, Clock::Instant now) {
  log_.add({LoggedBytes::From::kHost, to_seconds(now - start_), std::string(bytes)});
  instrument_->write(bytes);
}

std::string Relay::transmit(Clock::Instant now) {
  next_look_ = now + kLookEvery;
  // With a deadline in the past, returns available bytes without waiting.
  wire::ReceivedBytes received = instrument_->read_until(now);
  if (!received.bytes.empty())
    log_.add({LoggedBytes::From::kInstrument, to_seconds(received.arrival - start_), received.bytes});
  return std::move(received.bytes);
}

}  // namespace abcal
