#include "drivers/wire/socket_stream.h"

#include <unistd.h>

#include <boost/asio/local/stream_protocol.hpp>
#include <utility>

#include "drivers/wire/asio_link.h"

namespace abcal::wire {

using boost::asio::local::stream_protocol;

struct SocketStream::Impl {
  Impl(int descriptor, std::string name, Clock& clock, std::size_t queue_bytes)
      : link(std::move(name), clock, queue_bytes) {
    boost::system::error_code error;
    link.port().assign(stream_protocol(), descriptor, error);
    if (error) {
      ::close(descriptor);
      throw InstrumentError(link.queue().name(), Fault::kCannotOpen, error.message());
    }
    link.start();
  }

  AsioLink<stream_protocol::socket> link;
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
  impl_->link.queue().discard();
}
std::size_t SocketStream::dropped_bytes() const {
  return impl_->link.queue().dropped();
}
std::string SocketStream::name() const {
  return impl_->link.queue().name();
}

}  // namespace abcal::wire
