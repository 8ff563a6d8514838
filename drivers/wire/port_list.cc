#include "drivers/wire/port_list.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <grp.h>
#include <libserialport.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <memory>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::wire {
namespace {

namespace fs = std::filesystem;

std::string text_or_empty(const char* text) {
  return text == nullptr ? std::string() : std::string(text);
}

std::string by_id_link(const std::string& path) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/dev/serial/by-id", error)) {
    if (fs::equivalent(entry.path(), path, error) && !error) return entry.path().string();
  }
  return {};
}

std::optional<int> latency_timer(const std::string& path) {
  std::ifstream file("/sys/class/tty/" + fs::path(path).filename().string() + "/device/latency_timer");
  int milliseconds = 0;
  if (file >> milliseconds) return milliseconds;
  return std::nullopt;
}

std::string describe(const PortInfo& port) {
  std::string text = port.path;
  if (port.usb_vendor && port.usb_product) {
    text += fmt::format(" (usb:{:04x}:{:04x}", *port.usb_vendor, *port.usb_product);
    if (!port.serial_number.empty()) text += ":" + port.serial_number;
    text += ")";
  }
  return text;
}

std::string describe(const std::vector<PortInfo>& ports) {
  std::vector<std::string> texts;
  for (const PortInfo& port : ports) texts.push_back(describe(port));
  return fmt::format("{}", fmt::join(texts, ", "));
}

[[noreturn]] void malformed(std::string_view port, std::string_view why) {
  throw std::invalid_argument(fmt::format(
      "port \"{}\": {}; required: a path such as /dev/ttyUSB0, usb:VID:PID[:SERIAL] with four hexadecimal "
      "digits each, tcp:HOST:PORT, TCPIP::HOST::PORT::SOCKET, or usbtmc:/dev/usbtmc0",
      port, why));
}

std::uint16_t usb_number(std::string_view port, std::string_view text) {
  std::string_view digits = text;
  if (digits.starts_with("0x") || digits.starts_with("0X")) digits.remove_prefix(2);
  const auto value = pieces::number<std::uint16_t>(digits, 16);
  if (!value) malformed(port, fmt::format("\"{}\" is not a USB vendor or product number", text));
  return *value;
}

PortName parse_usb(std::string_view port) {
  PortName name;
  name.kind = PortName::Kind::kUsb;
  std::string_view rest = port.substr(4);
  const std::size_t colon = rest.find(':');
  if (colon == std::string_view::npos) malformed(port, "the product number is missing");
  name.usb_vendor = usb_number(port, rest.substr(0, colon));
  rest.remove_prefix(colon + 1);
  const std::size_t second = rest.find(':');
  name.usb_product = usb_number(port, rest.substr(0, second));
  if (second != std::string_view::npos) {
    name.usb_serial_number = rest.substr(second + 1);  // May itself contain colons.
    if (name.usb_serial_number.empty()) malformed(port, "the serial number is empty");
  }
  return name;
}

PortName tcp_port(std::string_view port, std::string_view host, std::string_view number_text) {
  PortName name;
  name.kind = PortName::Kind::kTcp;
  if (host.size() >= 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  if (host.empty()) malformed(port, "the host is missing");
  name.host = host;
  const auto number = pieces::number<std::uint16_t>(number_text, 10);
  if (!number || *number == 0)
    malformed(port, fmt::format("\"{}\" is not a port number of 1 to 65535", number_text));
  name.tcp_port = *number;
  return name;
}

PortName parse_tcp(std::string_view port) {
  const std::string_view rest = port.substr(4);
  const std::size_t colon = rest.rfind(':');
  if (colon == std::string_view::npos) malformed(port, "the port number is missing");
  return tcp_port(port, rest.substr(0, colon), rest.substr(colon + 1));
}

/// "TCPIP::HOST::PORT::SOCKET", as VISA names a port that carries nothing but the instrument's own bytes.
PortName parse_visa(std::string_view port) {
  std::vector<std::string> words;
  for (std::size_t begin = 0; begin <= port.size();) {
    const std::size_t end = std::min(port.find("::", begin), port.size());
    words.push_back(pieces::lower(port.substr(begin, end - begin)));
    begin = end + 2;
  }
  const bool is_socket = words.size() == 4 && words[0].starts_with("tcpip") && words[3] == "socket" &&
                         words[0].find_first_not_of("0123456789", 5) == std::string::npos;
  if (!is_socket)
    malformed(
        port,
        "a VISA name, of which only TCPIP::HOST::PORT::SOCKET is supported: VXI-11 and HiSLIP (::INSTR) and "
        "GPIB are not, so use the instrument's raw SCPI socket, often 5025, its USB or its serial port");
  return tcp_port(port, words[1], words[2]);
}

}  // namespace

std::string owner_group(const std::string& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) return {};
  struct group entry {};
  struct group* found = nullptr;
  std::array<char, 16384> buffer{};
  if (::getgrgid_r(status.st_gid, &entry, buffer.data(), buffer.size(), &found) != 0 || found == nullptr) {
    return std::to_string(status.st_gid);
  }
  return found->gr_name;
}

std::vector<PortHolder> find_holders(const std::string& path) {
  struct stat wanted {};
  if (::stat(path.c_str(), &wanted) != 0) return {};
  const std::string self = std::to_string(::getpid());
  std::vector<PortHolder> holders;
  std::error_code error;
  for (fs::directory_iterator process("/proc", error), end; !error && process != end;
       process.increment(error)) {
    const std::string pid = process->path().filename().string();
    if (pid == self || !std::all_of(pid.begin(), pid.end(), [](char c) { return c >= '0' && c <= '9'; }))
      continue;
    std::error_code unreadable;  // Another user's process, or one that has just ended.
    bool holds = false;
    for (fs::directory_iterator fd(process->path() / "fd", unreadable), last; !unreadable && fd != last;
         fd.increment(unreadable)) {
      struct stat status {};
      // It is the same device if these numbers agree, by any name.
      holds = ::stat(fd->path().c_str(), &status) == 0 &&
              (status.st_mode & S_IFMT) == (wanted.st_mode & S_IFMT) && status.st_dev == wanted.st_dev &&
              (S_ISCHR(wanted.st_mode) ? status.st_rdev == wanted.st_rdev : status.st_ino == wanted.st_ino);
      if (holds) break;
    }
    if (!holds) continue;
    std::ifstream comm(process->path() / "comm");
    std::string program;
    std::getline(comm, program);
    holders.push_back({pid, program});
  }
  return holders;
}

std::string in_words(const std::vector<PortHolder>& holders) {
  std::string words;
  for (const PortHolder& holder : holders) {
    words += fmt::format("{}pid {}", words.empty() ? "" : ", ", holder.pid);
    if (!holder.program.empty()) words += fmt::format(" ({})", holder.program);
  }
  return words;
}

std::string find_holder(const std::string& path) {
  return in_words(find_holders(path));
}

std::vector<PortInfo> list_ports() {
  struct sp_port** found = nullptr;
  if (sp_list_ports(&found) != SP_OK || found == nullptr) return {};
  const std::unique_ptr<struct sp_port*, void (*)(struct sp_port**)> owner(found, &sp_free_port_list);
  std::vector<PortInfo> ports;
  for (struct sp_port** port = found; *port != nullptr; ++port) {
    PortInfo info;
    info.path = text_or_empty(sp_get_port_name(*port));
    info.by_id = by_id_link(info.path);
    info.description = text_or_empty(sp_get_port_description(*port));
    int vendor = 0;
    int product = 0;
    if (sp_get_port_transport(*port) == SP_TRANSPORT_USB &&
        sp_get_port_usb_vid_pid(*port, &vendor, &product) == SP_OK) {
      info.usb_vendor = static_cast<std::uint16_t>(vendor);
      info.usb_product = static_cast<std::uint16_t>(product);
      info.usb_maker = text_or_empty(sp_get_port_usb_manufacturer(*port));
      info.serial_number = text_or_empty(sp_get_port_usb_serial(*port));
    }
    info.owner_group = owner_group(info.path);
    info.permitted = ::access(info.path.c_str(), R_OK | W_OK) == 0;
    info.holder = find_holder(info.path);
    info.latency_timer_ms = latency_timer(info.path);
    ports.push_back(std::move(info));
  }
  return ports;
}

PortName parse_port(std::string_view port) {
  if (port.starts_with("usb:")) return parse_usb(port);
  if (port.starts_with("tcp:")) return parse_tcp(port);
  if (port.find('/') == std::string_view::npos && port.find("::") != std::string_view::npos)
    return parse_visa(port);
  if (port.find('/') == std::string_view::npos) malformed(port, "not the name of a port");
  PortName name;
  constexpr std::string_view kUsbtmc = "usbtmc:";
  if (port.starts_with(kUsbtmc) || port.starts_with("/dev/usbtmc")) name.kind = PortName::Kind::kUsbtmc;
  name.path = port.starts_with(kUsbtmc) ? port.substr(kUsbtmc.size()) : port;
  return name;
}

std::string resolve_port(std::string_view port) {
  if (parse_port(port).kind != PortName::Kind::kUsb) return std::string(port);
  return resolve_port(port, list_ports());
}

std::string resolve_port(std::string_view port, const std::vector<PortInfo>& ports) {
  const PortName name = parse_port(port);
  if (name.kind != PortName::Kind::kUsb) return std::string(port);
  std::vector<PortInfo> matching;
  std::vector<PortInfo> usb;
  for (const PortInfo& candidate : ports) {
    if (!candidate.usb_vendor || !candidate.usb_product) continue;
    usb.push_back(candidate);
    if (candidate.usb_vendor == name.usb_vendor && candidate.usb_product == name.usb_product &&
        (name.usb_serial_number.empty() || candidate.serial_number == name.usb_serial_number)) {
      matching.push_back(candidate);
    }
  }
  if (matching.size() == 1) return matching.front().path;
  if (matching.empty()) {
    throw InstrumentError(port, Fault::kCannotOpen,
                          usb.empty() ? "not connected; this machine has no USB serial port connected now"
                                      : fmt::format("not connected; connected are {}", describe(usb)));
  }
  throw InstrumentError(
      port, Fault::kCannotOpen,
      fmt::format("matches several ports: {}; add the serial number, or name the path", describe(matching)));
}

}  // namespace abcal::wire
