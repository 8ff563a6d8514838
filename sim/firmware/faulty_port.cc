#include "sim/firmware/faulty_port.h"

#include <algorithm>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "sim/firmware/firmware_stream.h"

namespace abcal::sim {

FaultyPort::FaultyPort(std::shared_ptr<Firmware> inner, Clock& clock, std::vector<WireFault> faults,
                       std::uint64_t seed, LinkTiming timing)
    : inner_(inner),
      stream_(
          [&] {
            auto stream = std::make_unique<FirmwareStream>(std::move(inner), clock);
            power_ = [firmware = stream.get()](bool on) { firmware->power(on); };
            return stream;
          }(),
          clock, std::move(faults), seed, timing) {
  stream_.on_power(power_);
}

void FaultyPort::receive(std::string_view bytes, Clock::Instant) {
  try {
    stream_.write(bytes);
  } catch (const InstrumentError& error) {
    if (error.fault() != Fault::kLinkLost) throw;  // Unplugged: it receives nothing.
  }
}

std::string FaultyPort::transmit(Clock::Instant now) {
  std::string bytes;
  try {
    for (;;) {
      // With a deadline in the past, returns available bytes without waiting.
      const wire::ReceivedBytes received = stream_.read_until(now);
      if (received.bytes.empty()) return bytes;
      bytes += received.bytes;
    }
  } catch (const InstrumentError& error) {
    // Asked for beforehand, it might be unplugged by now.
    if (error.fault() != Fault::kLinkLost) throw;
    inner_->transmit(now);
    return {};
  }
}

std::optional<Clock::Instant> FaultyPort::next_due() const {
  std::optional<Clock::Instant> first;
  for (const auto& due : {inner_->next_due(), stream_.next_due(), stream_.next_change()})
    if (due) first = first ? std::min(*first, *due) : *due;
  return first;
}

}  // namespace abcal::sim
