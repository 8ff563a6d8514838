#include "drivers/wire/socket_stream.h"

#include <utility>

#include "drivers/wire/device_file.h"
#include "drivers/wire/port_link.h"

namespace abcal::wire {

struct SocketStream::Impl {
  Impl(int descriptor, std::string name, Clock& clock, std::size_t queue_bytes)
      : socket(descriptor), link(std::move(name), clock, queue_bytes) {
    link.start(descriptor);
  }

  const Descriptor socket;
  PortLink link;
};

SocketStream::SocketStream(int descriptor, std::string name, Clock& clock, std::size_t queue_bytes)
    : impl_(std::make_unique<Impl>(descriptor, std::move(name), clock, queue_bytes)) {}

SocketStream::~SocketStream() = default;

void SocketStream::write(std::string_view bytes) {
  impl_->link.write(bytes);
}
ReceivedBytes SocketStream::read_until(Clock::Instant deadline) {
  return impl_->link.read_until(deadline);
}
void SocketStream::discard_input() {
  impl_->link.discard();
}
std::size_t SocketStream::dropped_bytes() const {
  return impl_->link.queue().dropped();
}
std::string SocketStream::name() const {
  return impl_->link.queue().name();
}

}  // namespace abcal::wire
