#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "app/faces/console/access.h"
#include "app/faces/console/session.h"
#include "app/faces/console/silent_connections.h"
#include "app/faces/console/tls.h"

namespace abcal::console {

struct ServerOptions {
  std::string address = "127.0.0.1";
  std::uint16_t port = 8474;  ///< 0: any free one.
  AccessRules access;
  /// Where the process that holds the bench listens, if another program starts it; empty: the console does.
  std::filesystem::path bench_socket;
  /// Where the register is whose persons use the console; empty: none.
  std::string register_location;
  std::filesystem::path laboratory_file;    ///< Of the certificates; empty: none are issued on the page.
  std::chrono::minutes login_time{8 * 60};  ///< A working day.
  std::optional<TlsIdentity> tls;           ///< Required where others than this computer can connect.
  /// Addresses of proxies: what they say of where a request comes from is taken as true.
  std::vector<std::string> trusted_proxies;
  SilentConnections::Limits silent;    ///< Connections that have not said who they are.
  std::size_t most_connections = 100;  ///< Of those that have,
  std::size_t most_of_address = 80;    ///< and of one address.
  /// Messages that wait for a slow page; beyond it they are dropped, and it gets a snapshot instead. Replies
  /// are never dropped: no more is read from a page that leaves as many of them waiting.
  std::size_t longest_queue = 64;
  std::chrono::seconds request_time{10};  ///< For a request to come in, and for its answer to be taken.
  std::chrono::seconds silent_time{20};   ///< A page that answers no ping for this time is gone.
};

/// The web console: one page over HTTP, and a WebSocket on the same port by which it watches and steers
/// (docs/console.md). All connections live in one thread, which never waits for any of them, nor for the
/// bench; what the bench tells is put into a bounded queue for each. The bench itself is held by a process of
/// its own (BenchService), which is found or started, and goes on if this one dies.
class Server {
 public:
  /// Listens from here on.
  /// @throws std::runtime_error if the port cannot be had
  /// @throws std::invalid_argument if others than this computer could use it without TLS, or without a person
  ///         or token
  Server(ServerOptions options, Session::Options bench);
  ~Server();

  std::uint16_t port() const;

  /// Serves until `stop`. What is in progress at the bench is stopped then and its stage halted, unless
  /// `leaves_bench` says that it goes on without a console; the process that holds the bench ends with it.
  /// @return whether something was stopped so.
  bool serve(const std::stop_token& stop, const std::function<bool()>& leaves_bench = {});

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::console
