#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <stop_token>
#include <string>
#include <variant>
#include <vector>

#include "drivers/instrument/clock.h"
#include "sim/firmware/firmware.h"

namespace abcal::sim {

/// How the serial line of a pseudo-terminal behaves.
enum class LineModel {
  kIdeal,  ///< Bytes arrive at once at any speed that the host has set.
  /// Bytes are carried at Firmware::line_speed(). A host whose terminal has another speed receives noise, and
  /// so does the device from that host. Output that exceeds the capacity of the line is lost. RTS, CTS and
  /// the other lines do not exist on a pseudo-terminal.
  kReal,
};

/// A pseudo-terminal, found by a symbolic link at `link`.
struct PtyLink {
  std::filesystem::path link;
  LineModel line = LineModel::kIdeal;
};

/// A listening TCP port; port 0: any free one. One client at a time, unless the instrument serves several
/// (Firmware::another_session). The half command of a client ends with its connection.
struct TcpPort {
  std::string host = "127.0.0.1";
  std::uint16_t port = 0;
};

struct Endpoint {
  std::shared_ptr<Firmware> firmware;
  std::variant<PtyLink, TcpPort> where;
};

/// Serves simulated instruments to other programs in real time. All in the one thread that calls run(), so
/// that firmwares may share a world. Never blocks on a client: if a client does not read, the oldest output
/// is lost, as on a UART. An instrument outlives its clients, which may connect and disconnect. The port of
/// one that is not plugged in (Firmware::plugged_in) vanishes and returns as a USB port does. Linux.
class Emulator {
 public:
  /// Opens the ports; they answer once run() is called.
  /// `clock` passes `clock_rate` seconds in one second of real time.
  /// @throws std::runtime_error naming the endpoint: link path taken by something that is not a symbolic
  /// link,
  ///         port in use.
  Emulator(std::vector<Endpoint> endpoints, Clock& clock, double clock_rate = 1.0);
  ~Emulator();  ///< Closes the ports and removes the links.
  Emulator(const Emulator&) = delete;
  Emulator& operator=(const Emulator&) = delete;

  /// Serves until a stop is requested.
  void run(std::stop_token stop);

  /// Addresses to connect to, in the order of the endpoints: the link's path, or "tcp:HOST:PORT".
  std::vector<std::string> addresses() const;

  /// Bytes of output that no client took in time, or that were more than their line carries; only grows.
  std::uint64_t dropped_bytes() const;

 private:
  struct Port;
  struct Loop;
  std::unique_ptr<Loop> loop_;
};

}  // namespace abcal::sim
