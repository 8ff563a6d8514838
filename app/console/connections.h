#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <optional>

#include "app/console/answers.h"
#include "app/console/control.h"
#include "app/console/logins.h"
#include "app/console/server_common.h"

namespace abcal::console {

/// The parts of a Server that a connection needs.
struct ServerParts {
  ServerCommon& common;
  Logins& logins;
  Control& control;
  Answers& answers;
};

/// Accepts connections, with TLS where there is a certificate, reads their requests and has them answered; a
/// request for the WebSocket makes a Page of its connection. For the thread of the connections.
class Connections {
 public:
  /// Listens; uses no part of the server but `common` before accept().
  /// @throws std::runtime_error if the console cannot listen on the port of the options
  explicit Connections(const ServerParts& parts);

  /// Accepts connections from now on.
  void accept();
  std::uint16_t port() const { return acceptor_.local_endpoint().port(); }

 private:
  const ServerParts parts_;
  boost::asio::ip::tcp::acceptor acceptor_;
  boost::asio::steady_timer accept_again_;
  std::optional<boost::asio::ssl::context> tls_;
};

}  // namespace abcal::console
