#include "drivers/wire/tcp_stream.h"

#include <fmt/format.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <memory>
#include <string>
#include <vector>

#include "drivers/wire/lease.h"
#include "drivers/wire/port_link.h"

namespace abcal::wire {

using boost::asio::ip::tcp;

struct TcpStream::Impl {
  struct Address {
    std::string host;
    std::uint16_t port = 0;
  };

  Impl(const Address& address, Clock& clock, Clock::Duration connect_timeout, std::size_t queue_bytes,
       const std::string& holder)
      : socket(io), link(fmt::format("tcp:{}:{}", address.host, address.port), clock, queue_bytes) {
    const auto& [host, port] = address;
    boost::system::error_code outcome = boost::asio::error::timed_out;  // Until something better is known.
    bool host_found = false;
    tcp::resolver resolver(io);
    resolver.async_resolve(
        host, std::to_string(port), tcp::resolver::numeric_service,
        [&](const boost::system::error_code& error, const tcp::resolver::results_type& found) {
          if (error) {
            outcome = error;
            return;
          }
          host_found = true;
          // Before the connection: many controllers end that of the program before when another one connects.
          for (const auto& entry : found)
            leases.push_back(Lease::take(
                fmt::format("tcp:{}:{}", entry.endpoint().address().to_string(), entry.endpoint().port()),
                holder));
          boost::asio::async_connect(
              socket, found,
              [&](const boost::system::error_code& result, const tcp::endpoint&) { outcome = result; });
        });
    io.run_for(connect_timeout);
    if (outcome) cannot_connect(address, host_found, outcome, connect_timeout);
    socket.set_option(tcp::no_delay(true));
    // A controller that lost its power leaves no trace on an idle connection otherwise.
    socket.set_option(boost::asio::socket_base::keep_alive(true));
    link.start(socket.native_handle());
  }

  [[noreturn]] void cannot_connect(const Address& address, bool host_found, boost::system::error_code error,
                                   Clock::Duration connect_timeout) {
    // The pending connect refers to the constructor's locals: let it end before they do.
    boost::system::error_code ignored;
    socket.close(ignored);
    io.restart();
    io.poll();
    std::string why;
    if (error == boost::asio::error::timed_out) {
      why = fmt::format("no answer within {} s; is the controller on, and connected to this network?",
                        to_seconds(connect_timeout));
    } else if (!host_found) {
      why = fmt::format("host \"{}\" is unknown ({})", address.host, error.message());
    } else if (error == boost::asio::error::connection_refused) {
      why = fmt::format("the host answers, but nothing listens on port {}", address.port);
    } else {
      why = error.message();
    }
    throw InstrumentError(link.queue().name(), Fault::kCannotOpen, why);
  }

  std::vector<std::shared_ptr<Lease>> leases;  ///< One for each address of the host; before the socket.
  boost::asio::io_context io;                  ///< Runs until the connection is established.
  tcp::socket socket;
  PortLink link;
};

TcpStream::TcpStream(const std::string& host, std::uint16_t port, Clock& clock,
                     Clock::Duration connect_timeout, std::size_t queue_bytes, const std::string& holder)
    : impl_(std::make_unique<Impl>(Impl::Address{host, port}, clock, connect_timeout, queue_bytes, holder)) {}

TcpStream::~TcpStream() = default;

void TcpStream::write(std::string_view bytes) {
  impl_->link.write(bytes);
}
ReceivedBytes TcpStream::read_until(Clock::Instant deadline) {
  return impl_->link.read_until(deadline);
}
void TcpStream::discard_input() {
  impl_->link.discard();
}
std::size_t TcpStream::dropped_bytes() const {
  return impl_->link.queue().dropped();
}
int TcpStream::descriptor() const {
  return impl_->socket.native_handle();
}
std::vector<std::shared_ptr<Lease>> TcpStream::leases() const {
  return impl_->leases;
}
std::string TcpStream::name() const {
  return impl_->link.queue().name();
}

}  // namespace abcal::wire
