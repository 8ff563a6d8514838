#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::wire {

/// One serial port of this machine, and what a person needs to know to use it.
struct PortInfo {
  std::string path;         ///< "/dev/ttyUSB0"
  std::string by_id;        ///< "/dev/serial/by-id/...", stable across replugging; empty if none.
  std::string description;  ///< As the system describes it.
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

/// The programs that have the file behind `path` open, this one left out: "pid 123 (screen)", several joined
/// by
/// ", "; empty if there is none or we may not see it.
std::string find_holder(const std::string& path);

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

/// Takes "/path", "usb:VID:PID[:SERIAL]" (VID and PID hexadecimal), "tcp:HOST:PORT" ("tcp:[::1]:50000" for
/// IPv6) or "usbtmc:/path" apart; a path that begins with /dev/usbtmc is of that last kind. Opens and looks
/// for nothing.
/// @throws std::invalid_argument saying what was found and what is required.
PortName parse_port(std::string_view port);

/// The path of a "usb:..." port; any other name is returned as it is.
/// @throws InstrumentError kCannotOpen if no port matches (listing what there is) or several do (listing
/// them);
///   std::invalid_argument as parse_port.
std::string resolve_port(std::string_view port);

/// The same among given ports.
std::string resolve_port(std::string_view port, const std::vector<PortInfo>& ports);

}  // namespace abcal::wire
