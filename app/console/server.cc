#include "app/console/server.h"

#include <fmt/format.h>

#include <boost/asio/ip/address.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <future>
#include <stdexcept>
#include <thread>
#include <utility>

#include "app/console/answers.h"
#include "app/console/connections.h"
#include "app/console/control.h"
#include "app/console/logins.h"
#include "app/console/server_common.h"

namespace abcal::console {
namespace {

namespace asio = boost::asio;

constexpr std::chrono::seconds kBeat{1};

/// Beyond this computer a console requires TLS, and a token or a register.
void require_protection(const ServerOptions& options, const asio::ip::address& address) {
  const bool open = options.access.token.empty() && options.register_location.empty();
  if (!address.is_loopback() && !options.tls)
    throw std::invalid_argument(fmt::format(
        "the console does not listen on {} without TLS: whoever listens on the network could read passwords "
        "and steer; required: a TLS certificate, or an address of this computer alone (127.0.0.1)",
        options.address));
  if (!address.is_loopback() && open)
    throw std::invalid_argument(fmt::format(
        "the console does not listen on {} for everybody; required: a token or a register", options.address));
  if (open && (!options.access.hosts.empty() || !options.trusted_proxies.empty()))
    throw std::invalid_argument(
        "the console is not opened to everybody who reaches a proxy; required: a token or a register");
}

ServerOptions protected_options(ServerOptions options) {
  options.access.persons = !options.register_location.empty();
  require_protection(options, asio::ip::make_address(options.address));
  return options;
}

}  // namespace

/// The parts of the server, each after those that it needs first, and their thread.
struct Server::Impl {
  Impl(ServerOptions options, Session::Options bench)
      : common(protected_options(std::move(options))),
        connections({common, logins, control, answers}),
        logins(common, connections.port(),
               [this](const std::vector<std::string>& ended) { control.close_pages(ended); }),
        answers(common, logins, bench),
        control(common, std::move(bench)) {
    connections.accept();
    watch();
    control.begin();
    thread = std::jthread([this] { common.io.run(); });
  }
  ~Impl() {
    common.io.stop();
    thread = {};
  }

  /// Checks each second whether the page that steers still answers, and which logins have ended.
  void watch() {
    next_watch.expires_after(kBeat);
    next_watch.async_wait([this](boost::system::error_code cancelled) {
      if (cancelled) return;
      control.check_beats();
      logins.check(control.logins());
      watch();
    });
  }

  ServerCommon common;
  Connections connections;
  Logins logins;
  Answers answers;
  Control control;
  asio::steady_timer next_watch{common.io};
  std::jthread thread;
};

Server::Server(ServerOptions options, Session::Options bench)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(bench))) {}

Server::~Server() = default;

std::uint16_t Server::port() const {
  return impl_->connections.port();
}

bool Server::serve(const std::stop_token& stop, const std::function<bool()>& leaves_bench) {
  std::promise<void> stopped;
  {
    const std::stop_callback on_stop(stop, [&stopped] { stopped.set_value(); });
    stopped.get_future().wait();
  }
  // The pages still see the end.
  return impl_->control.end(!impl_->common.options.bench_socket.empty() || (leaves_bench && leaves_bench()));
}

}  // namespace abcal::console
