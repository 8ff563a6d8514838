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

#include "app/console/access.h"
#include "app/console/console_session.h"
#include "app/console/silent_connections.h"
#include "app/console/tls.h"

namespace abcal::console {

struct ServerOptions {
  std::string address = "127.0.0.1";
  std::uint16_t port = 8474;  ///< 0: any free one.
  AccessRules access;
  /// Socket of the process that holds the bench, if another program starts it; empty: the console does.
  std::filesystem::path bench_socket;
  /// Location of the register whose persons use the console; empty: none.
  std::string register_location;
  std::filesystem::path laboratory_file;  ///< For certificates; empty: the page issues none.
  /// Folders whose benches are shown as tiles, besides that of the own runs; empty: no tiles.
  std::vector<std::filesystem::path> tile_folders;
  std::vector<std::string> tile_links;      ///< Addresses of other consoles, shown next to the tiles.
  std::chrono::minutes login_time{8 * 60};  ///< A working day.
  std::optional<TlsIdentity> tls;           ///< Required where others than this computer can connect.
  /// Addresses of proxies that are trusted to state where a request comes from.
  std::vector<std::string> trusted_proxies;
  SilentConnections::Limits silent;    ///< Limits of connections with unidentified visitors.
  std::size_t most_connections = 100;  ///< Limit of connections with identified visitors,
  std::size_t most_of_address = 80;    ///< and of those from one address.
  /// Limit of messages that wait for a slow page. Beyond it they are dropped, and it gets a snapshot instead.
  /// Replies are never dropped: no more is read from a page while that number of them waits.
  std::size_t longest_queue = 64;
  std::chrono::seconds request_time{10};  ///< Limit for the arrival of a request, and for the transmission of
                                          ///< its answer.
  std::chrono::seconds silent_time{20};   ///< A page that answers no ping for this time is gone.
};

/// The web console: one page over HTTP, and a WebSocket on the same port by which it watches and steers
/// (docs/console_programs.md). All connections live in one thread, which never waits for any of them, nor for
/// the bench; messages of the bench go into a bounded queue for each page. The bench itself is held by a
/// process of its own (BenchService), which is found or started, and continues if this one dies.
class Server {
 public:
  /// Listens from here on.
  /// @throws std::runtime_error if it cannot listen on the port
  /// @throws std::invalid_argument if others than this computer could use it without TLS, or without a person
  ///         or token
  Server(ServerOptions options, Session::Options bench);
  ~Server();

  std::uint16_t port() const;

  /// Serves until `stop`. The activity of the bench is then stopped, its stage halted and its process ended,
  /// unless `leaves_bench` returns true or another program starts that process.
  /// @return whether an activity was stopped
  bool serve(const std::stop_token& stop, const std::function<bool()>& leaves_bench = {});

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::console
