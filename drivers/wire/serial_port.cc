#include "drivers/wire/serial_port.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/serial_port.hpp>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <vector>

#include "drivers/wire/device_file.h"
#include "drivers/wire/lease.h"
#include "drivers/wire/port_link.h"
#include "drivers/wire/port_list.h"

namespace abcal::wire {
namespace {

constexpr std::chrono::milliseconds kDrainDeadline(500);  // 5760 bytes at 115200 baud.

std::string what_there_is() {
  std::vector<std::string> names;
  for (const PortInfo& port : list_ports()) names.push_back(port.by_id.empty() ? port.path : port.by_id);
  if (names.empty()) return "this machine has no serial port connected now";
  return fmt::format("connected are {}", fmt::join(names, ", "));
}

/// Unix 98 pseudo-terminals have the character majors 136 to 143 (Linux,
/// Documentation/admin-guide/devices.txt).
bool is_pseudo_terminal(const struct stat& status) {
  return major(status.st_rdev) >= 136 && major(status.st_rdev) <= 143;
}

/// Opens and locks, before any setting of the port is touched: another program may be using it.
Descriptor open_and_lock(const std::string& path) {
  Descriptor port = open_device(path, O_NONBLOCK | O_NOCTTY, {"a serial port", what_there_is});
  termios ignored{};
  if (::tcgetattr(port.get(), &ignored) != 0) {
    if (errno == EIO) cannot_open(path, "no working port is behind it (Input/output error)");
    cannot_open(path, "a device, but not a serial port");
  }
  lock_device(port, path);
  struct stat status {};
  if (::fstat(port.get(), &status) != 0) cannot_open(path, std::strerror(errno));
  if (!is_pseudo_terminal(status)) {
    // A program that took no lock may still read from it, and each would get part of the replies. (A
    // pseudo-terminal is rightly held open by the program that emulates the instrument.)
    if (!find_holder(path).empty()) held_by_another(path);
    if (::ioctl(port.get(), TIOCEXCL) != 0) {
      cannot_open(path, fmt::format("cannot be reserved for this program: {}", std::strerror(errno)));
    }
  }
  return port;
}

void make_raw(int fd, const std::string& path) {
  termios mode{};
  if (::tcgetattr(fd, &mode) != 0) cannot_open(path, std::strerror(errno));
  ::cfmakeraw(&mode);
  mode.c_cflag |= CREAD | CLOCAL;
  mode.c_cc[VMIN] = 1;
  mode.c_cc[VTIME] = 0;
  if (::tcsetattr(fd, TCSANOW, &mode) != 0) {
    cannot_open(path, fmt::format("does not accept raw mode: {}", std::strerror(errno)));
  }
}

template <class Option>
void set(boost::asio::serial_port& port, const Option& option, const std::string& path,
         const std::string& what) {
  boost::system::error_code error;
  port.set_option(option, error);
  if (error) cannot_open(path, fmt::format("does not accept {} ({})", what, error.message()));
}

}  // namespace

struct SerialPort::Impl {
  Impl(const SerialSettings& settings, Clock& clock, std::size_t queue_bytes, const std::string& holder)
      : lease(Lease::take_device(settings.path, holder)), port(io), link(settings.path, clock, queue_bytes) {
    using boost::asio::serial_port;
    const std::string& path = settings.path;
    Descriptor descriptor = open_and_lock(path);
    const int fd = descriptor.get();
    make_raw(fd, path);
    boost::system::error_code error;
    port.assign(fd, error);
    if (error) cannot_open(path, error.message());
    descriptor.release();
    set(port, serial_port::baud_rate(settings.baud), path, fmt::format("{} baud", settings.baud));
    set(port, serial_port::character_size(8), path, "8 data bits");
    set(port, serial_port::parity(serial_port::parity::none), path, "no parity");
    set(port, serial_port::stop_bits(serial_port::stop_bits::one), path, "1 stop bit");
    set(port,
        serial_port::flow_control(settings.rts_cts ? serial_port::flow_control::hardware
                                                   : serial_port::flow_control::none),
        path, settings.rts_cts ? "RTS/CTS flow control" : "no flow control");
    ::tcflush(fd, TCIFLUSH);  // Bytes waiting in the kernel were meant for the previous program.
    link.start(fd);
  }

  /// The last bytes (a stop command, say) are given time to leave; bytes that a blocked line still holds then
  /// are dropped, because the kernel would keep close() waiting for 30 s.
  ~Impl() {
    const int fd = port.native_handle();
    const auto deadline = std::chrono::steady_clock::now() + kDrainDeadline;
    for (int waiting = 0; ::ioctl(fd, TIOCOUTQ, &waiting) == 0 && waiting > 0;) {
      if (std::chrono::steady_clock::now() >= deadline) {
        ::tcflush(fd, TCOFLUSH);
        break;
      }
      ::poll(nullptr, 0, 1);
    }
  }

  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  const std::shared_ptr<Lease> lease;  ///< Before the port: released after that is closed.
  boost::asio::io_context io;          ///< Never runs: the port is opened and set by it only.
  boost::asio::serial_port port;
  PortLink link;
};

SerialPort::SerialPort(const SerialSettings& settings, Clock& clock, std::size_t queue_bytes,
                       const std::string& holder)
    : impl_(std::make_unique<Impl>(settings, clock, queue_bytes, holder)) {}

SerialPort::~SerialPort() = default;

void SerialPort::write(std::string_view bytes) {
  impl_->link.write(bytes);
}
ReceivedBytes SerialPort::read_until(Clock::Instant deadline) {
  return impl_->link.read_until(deadline);
}
void SerialPort::discard_input() {
  impl_->link.discard();
}
std::size_t SerialPort::dropped_bytes() const {
  return impl_->link.queue().dropped();
}
int SerialPort::descriptor() const {
  return impl_->port.native_handle();
}
std::string SerialPort::name() const {
  return impl_->link.queue().name();
}

}  // namespace abcal::wire
