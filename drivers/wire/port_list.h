#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::wire {

/// One serial port of this machine, with the facts that a person needs to use it.
struct PortInfo {
  std::string path;         ///< "/dev/ttyUSB0"
  std::string by_id;        ///< "/dev/serial/by-id/...", stable across replugging; empty if none.
  std::string description;  ///< Description by the system.
  std::optional<std::uint16_t> usb_vendor;  ///< Absent: not a USB port.
  std::optional<std::uint16_t> usb_product;
  std::string usb_maker;
  std::string serial_number;
  std::string owner_group;  ///< The group that may open it, e.g. "dialout".
  bool permitted = false;   ///< This user may read and write it.
  std::string holder;  ///< "pid 123 (screen)" of a program that has it open; empty: none that we may see.
  std::optional<int> latency_timer_ms;  ///< FTDI adapters wait this long before they pass a short reply on.
};

/// The serial ports that the machine knows (pseudo-terminals are not among them).
std::vector<PortInfo> list_ports();

/// A program that has a file open.
struct PortHolder {
  std::string pid;
  std::string program;  ///< Empty: unknown.
};

/// The other programs that have the file at `path` open, as far as they are visible.
std::vector<PortHolder> find_holders(const std::string& path);

/// find_holders() in words: "pid 123 (screen)", several joined by ", "; empty: none.
std::string find_holder(const std::string& path);
std::string in_words(const std::vector<PortHolder>& holders);

/// The name of the group that owns the file at `path`; empty if there is no such file.
std::string owner_group(const std::string& path);

/// A `port` of a bench file, taken apart.
struct PortName {
  enum class Kind { kPath, kUsb, kTcp, kUsbtmc };
  Kind kind = Kind::kPath;
  std::string path;  ///< kPath, kUsbtmc
  std::uint16_t usb_vendor = 0;
  std::uint16_t usb_product = 0;
  std::string usb_serial_number;  ///< kUsb; empty: any
  std::string host;
  std::uint16_t tcp_port = 0;
};

/// Parses "/path", "usb:VID:PID[:SERIAL]" (VID and PID hexadecimal), "tcp:HOST:PORT" ("tcp:[::1]:50000" for
/// IPv6), which VISA calls "TCPIP::HOST::PORT::SOCKET", or "usbtmc:/path"; a path that begins with
/// /dev/usbtmc counts as the last form. Neither opens a port nor searches for one.
/// @throws std::invalid_argument that states what was found and what is required.
PortName parse_port(std::string_view port);

/// The path of a "usb:..." port; any other name is returned unchanged.
/// @throws InstrumentError kCannotOpen if no port matches (listing those that exist) or several do (listing
/// them);
///   std::invalid_argument as parse_port.
std::string resolve_port(std::string_view port);

/// Like resolve_port(port), among the given ports.
std::string resolve_port(std::string_view port, const std::vector<PortInfo>& ports);

}  // namespace abcal::wire
