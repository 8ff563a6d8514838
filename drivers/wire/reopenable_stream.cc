#include "drivers/wire/reopenable_stream.h"

#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal::wire {

ReopenableStream::ReopenableStream(Open open)
    : open_(std::move(open)), port_(open_()), lost_because_("the port is closed") {
  name_ = port_->name();
}

void ReopenableStream::reopen() {
  const std::lock_guard lock(mutex_);
  if (!port_) port_ = open_();
}

std::shared_ptr<ByteStream> ReopenableStream::port() const {
  const std::lock_guard lock(mutex_);
  if (!port_) throw InstrumentError(name_, Fault::kLinkLost, lost_because_);
  return port_;
}

template <class Call>
auto ReopenableStream::guarded(const Call& call) {
  const std::shared_ptr<ByteStream> used = port();
  try {
    return call(*used);
  } catch (const InstrumentError& error) {
    if (error.fault() == Fault::kLinkLost) {
      const std::lock_guard lock(mutex_);
      if (port_ == used) {  // Otherwise another thread has noticed it before.
        dropped_before_ += port_->dropped_bytes();
        port_.reset();
        lost_because_ = error.detail();
      }
    }
    throw;
  }
}

void ReopenableStream::write(std::string_view bytes) {
  guarded([&](ByteStream& port) { port.write(bytes); });
}

ReceivedBytes ReopenableStream::read_until(Clock::Instant deadline) {
  return guarded([&](ByteStream& port) { return port.read_until(deadline); });
}

void ReopenableStream::discard_input() {
  guarded([](ByteStream& port) { port.discard_input(); });
}

std::size_t ReopenableStream::dropped_bytes() const {
  const std::lock_guard lock(mutex_);
  return dropped_before_ + (port_ ? port_->dropped_bytes() : 0);
}

std::string ReopenableStream::name() const {
  return name_;
}

}  // namespace abcal::wire
