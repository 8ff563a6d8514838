#include "sim/emulator.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/inotify.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <list>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "sim/serial_line.h"

namespace abcal::sim {
namespace {

// Output that a client may leave unread before the oldest is lost, in addition to the system's own buffer.
constexpr std::size_t kOutputCapacity = 65536;
constexpr std::size_t kReadSize = 4096;
// Output that a device holds until its serial line has carried it.
constexpr std::size_t kDeviceBuffer = 4096;
constexpr int kWaitingClients = 16;
constexpr int kMostSessions = 100;
// The loop looks up this often even if nothing is due.
constexpr Clock::Duration kLongestWait = std::chrono::milliseconds(50);

class FileDescriptor {
 public:
  FileDescriptor() = default;
  explicit FileDescriptor(int fd) : fd_(fd) {}
  FileDescriptor(FileDescriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FileDescriptor& operator=(FileDescriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~FileDescriptor() { close(); }
  void close() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  int get() const { return fd_; }
  bool open() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

[[noreturn]] void fail(const std::string& who, const std::string& what) {
  throw std::runtime_error(
      fmt::format("emulator: {}: {}: {}", who, what, std::generic_category().message(errno)));
}

void make_raw(int fd, const std::string& who) {
  termios settings{};
  if (::tcgetattr(fd, &settings) != 0) fail(who, "cannot read the terminal's settings");
  ::cfmakeraw(&settings);
  if (::tcsetattr(fd, TCSANOW, &settings) != 0) fail(who, "cannot make the terminal raw");
}

/// The speed that a host has set; absent: a speed without a name.
std::optional<unsigned> terminal_speed(int fd) {
  struct Speed {
    speed_t code;
    unsigned baud;
  };
  constexpr std::array kSpeeds{Speed{B1200, 1200},      Speed{B2400, 2400},     Speed{B4800, 4800},
                               Speed{B9600, 9600},      Speed{B19200, 19200},   Speed{B38400, 38400},
                               Speed{B57600, 57600},    Speed{B115200, 115200}, Speed{B230400, 230400},
                               Speed{B460800, 460800},  Speed{B921600, 921600}, Speed{B1000000, 1000000},
                               Speed{B2000000, 2000000}};
  termios settings{};
  if (::tcgetattr(fd, &settings) != 0) return std::nullopt;
  for (const Speed& speed : kSpeeds)
    if (speed.code == ::cfgetospeed(&settings)) return speed.baud;
  return std::nullopt;
}

/// A link that appears atomically, and replaces an old link.
void link_atomically(const std::filesystem::path& target, const std::filesystem::path& link) {
  const auto status = std::filesystem::symlink_status(link);
  if (std::filesystem::exists(status) && !std::filesystem::is_symlink(status))
    throw std::runtime_error(fmt::format(
        "emulator: {}: found something that is not a symbolic link, required: a free path", link.string()));
  std::filesystem::path temporary = link;
  temporary += fmt::format(".{}", ::getpid());
  std::error_code error;
  std::filesystem::remove(temporary, error);
  std::filesystem::create_symlink(target, temporary, error);
  if (!error) std::filesystem::rename(temporary, link, error);
  if (error)
    throw std::runtime_error(fmt::format("emulator: {}: cannot link it: {}", link.string(), error.message()));
}

}  // namespace

struct Emulator::Port {
  std::shared_ptr<Firmware> firmware;
  std::string address;
  std::string output;  ///< Not yet taken.
  /// False while no client is connected: output is then lost at once, as on a line with nothing at its end.
  bool client = true;
  std::variant<PtyLink, TcpPort> where;
  bool plugged_in = true;

  // Pseudo-terminal. We also hold its other end open: its settings are kept between clients, and reading does
  // not fail without a client.
  std::filesystem::path link;
  std::filesystem::path terminal;
  FileDescriptor master;
  FileDescriptor slave;
  FileDescriptor watch;
  int clients = 0;
  LineModel line = LineModel::kIdeal;
  SerialLine to_device;
  SerialLine to_host;

  // TCP.
  FileDescriptor listener;
  FileDescriptor connection;
  bool session = false;  ///< One more client of a port that serves several; goes with its connection.

  /// The speed of its line, if that matters.
  std::optional<unsigned> line_speed() const {
    return line == LineModel::kReal && slave.open() ? firmware->line_speed() : std::nullopt;
  }
  int io() const { return master.open() ? master.get() : connection.get(); }
};

struct Emulator::Loop {
  Clock& clock;
  double clock_rate;
  std::list<Port> ports;
  FileDescriptor wake;
  std::vector<std::string> addresses{};  ///< Addresses of the endpoints; they do not change.
  std::atomic<std::uint64_t> dropped{0};

  ~Loop();

  void open_pty(Port& port, const PtyLink& where);
  void open_tcp(Port& port, const TcpPort& where);
  void follow_clients(Port& port);
  void accept_client(Port& port);
  void read_from(Port& port);
  void take(Port& port, std::string_view bytes);
  void deliver(Port& port);
  void write_to(Port& port);
  void hang_up(Port& port);
  void put_on_line(Port& port, Clock::Instant now);
  void pump(Port& port);
  void open(Port& port);
  static void remove_link(const Port& port);
  void follow_plug(Port& port);
};

void Emulator::Loop::remove_link(const Port& port) {
  if (port.link.empty()) return;
  std::error_code error;  // the error is ignored: the link was removed, or belongs to another program
  if (std::filesystem::read_symlink(port.link, error) == port.terminal && !error)
    std::filesystem::remove(port.link, error);
}

Emulator::Loop::~Loop() {
  for (const Port& port : ports) remove_link(port);
}

void Emulator::Loop::open(Port& port) {
  if (const auto* pty = std::get_if<PtyLink>(&port.where)) open_pty(port, *pty);
  if (const auto* tcp = std::get_if<TcpPort>(&port.where)) open_tcp(port, *tcp);
}

/// The port of an unplugged instrument vanishes, as a USB port does; a new one appears when it is plugged in.
void Emulator::Loop::follow_plug(Port& port) {
  if (port.firmware->plugged_in() == port.plugged_in) return;
  port.plugged_in = !port.plugged_in;
  if (port.plugged_in) {
    open(port);
    return;
  }
  remove_link(port);
  port.output.clear();
  port.to_device.clear();
  port.to_host.clear();
  port.client = false;
  port.clients = 0;
  port.master.close();
  port.slave.close();
  port.watch.close();
  port.listener.close();
  port.connection.close();
}

void Emulator::Loop::open_pty(Port& port, const PtyLink& where) {
  const std::string who = where.link.string();
  port.master = FileDescriptor(::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (!port.master.open()) fail(who, "cannot open a pseudo-terminal");
  if (::grantpt(port.master.get()) != 0 || ::unlockpt(port.master.get()) != 0)
    fail(who, "cannot unlock the pseudo-terminal");
  std::array<char, 128> name{};
  if (::ptsname_r(port.master.get(), name.data(), name.size()) != 0)
    fail(who, "the pseudo-terminal has no name");
  port.terminal = name.data();
  port.slave = FileDescriptor(::open(name.data(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (!port.slave.open()) fail(who, "cannot open the pseudo-terminal's other end");
  make_raw(port.slave.get(), who);
  // inotify reports who opens and closes the terminal. Without inotify a client is assumed to be connected.
  port.watch = FileDescriptor(::inotify_init1(IN_NONBLOCK | IN_CLOEXEC));
  if (port.watch.open() && ::inotify_add_watch(port.watch.get(), name.data(), IN_OPEN | IN_CLOSE) < 0)
    port.watch.close();
  port.client = !port.watch.open();
  link_atomically(port.terminal, where.link);
  port.link = where.link;
  port.line = where.line;
  port.address = who;
}

void Emulator::Loop::open_tcp(Port& port, const TcpPort& where) {
  const std::string who = fmt::format("tcp:{}:{}", where.host, where.port);
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (const int error = ::getaddrinfo(where.host.c_str(), std::to_string(where.port).c_str(), &hints, &found);
      error != 0)
    throw std::runtime_error(fmt::format("emulator: {}: no such host: {}", who, ::gai_strerror(error)));
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner(found, &::freeaddrinfo);
  port.listener = FileDescriptor(::socket(found->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!port.listener.open()) fail(who, "cannot make a socket");
  const int on = 1;
  ::setsockopt(port.listener.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (::bind(port.listener.get(), found->ai_addr, found->ai_addrlen) != 0) fail(who, "cannot take the port");
  if (::listen(port.listener.get(), kWaitingClients) != 0) fail(who, "cannot listen");
  sockaddr_storage bound{};
  socklen_t size = sizeof bound;
  void* const generic = &bound;
  if (::getsockname(port.listener.get(), static_cast<sockaddr*>(generic), &size) != 0)
    fail(who, "has no address");
  std::array<char, NI_MAXSERV> service{};
  if (::getnameinfo(static_cast<sockaddr*>(generic), size, nullptr, 0, service.data(), service.size(),
                    NI_NUMERICSERV) != 0)
    throw std::runtime_error(fmt::format("emulator: {}: its port has no number", who));
  port.address = fmt::format("tcp:{}:{}", where.host, service.data());
  port.client = false;
}

/// Counts the programs that have the terminal open.
void Emulator::Loop::follow_clients(Port& port) {
  alignas(inotify_event) std::array<char, kReadSize> buffer{};
  for (;;) {
    const ssize_t size = ::read(port.watch.get(), buffer.data(), buffer.size());
    if (size <= 0) break;
    for (ssize_t at = 0; at < size;) {
      inotify_event event{};
      std::memcpy(&event, buffer.data() + at, sizeof event);
      if ((event.mask & IN_OPEN) != 0U) ++port.clients;
      if ((event.mask & IN_CLOSE) != 0U) port.clients = std::max(0, port.clients - 1);
      at += static_cast<ssize_t>(sizeof event + event.len);
    }
  }
  const bool was = std::exchange(port.client, port.clients > 0);
  if (was && !port.client) hang_up(port);
}

void Emulator::Loop::hang_up(Port& port) {
  port.output.clear();
  port.to_host.clear();
  port.client = false;
  if (port.slave.open()) {
    // The next client must find neither the unread bytes of this one nor its lock.
    ::tcflush(port.slave.get(), TCIFLUSH);
    ::ioctl(port.slave.get(), TIOCNXCL);
  }
  port.connection.close();
}

void Emulator::Loop::accept_client(Port& port) {
  FileDescriptor fresh(::accept4(port.listener.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
  // The previous client may have disconnected without having been noticed so far.
  if (port.connection.open()) read_from(port);
  if (!fresh.open()) return;
  const int on = 1;
  ::setsockopt(fresh.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  Port* taken = &port;
  if (port.connection.open()) {
    auto session = port.firmware->another_session();
    const auto sessions =
        std::count_if(ports.begin(), ports.end(), [](const Port& each) { return each.session; });
    if (!session || sessions >= kMostSessions) return;  // one client at a time: the second is hung up on
    taken = &ports.emplace_back();
    taken->firmware = std::move(session);
    taken->session = true;
  } else {
    port.firmware->session_starts();
  }
  taken->connection = std::move(fresh);
  taken->client = true;
}

/// Reads everything that is available: the last bytes of a disconnected client, and the end of its
/// connection.
void Emulator::Loop::read_from(Port& port) {
  std::array<char, kReadSize> buffer{};
  for (;;) {
    const ssize_t size = ::read(port.io(), buffer.data(), buffer.size());
    if (size > 0) {
      take(port, {buffer.data(), static_cast<std::size_t>(size)});
      if (port.connection.open() || static_cast<std::size_t>(size) == buffer.size()) continue;
      return;
    }
    if (size < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (port.connection.open()) hang_up(port);
    return;
  }
}

/// Takes bytes that a client has sent.
void Emulator::Loop::take(Port& port, std::string_view bytes) {
  pump(port);  // output from before these bytes arrived
  if (const auto speed = port.line_speed()) {
    const unsigned sent = terminal_speed(port.slave.get()).value_or(*speed);
    // Framing errors: the device's UART drops such bytes, so that a host that tries several speeds does not
    // leave noise before its first command [unverified against a device].
    if (SerialLine::fits(sent, *speed)) port.to_device.send(bytes, sent, speed, clock.now());
  } else {
    port.firmware->receive(bytes, clock.now());
  }
}

/// Passes the bytes that have arrived over the line to the device.
void Emulator::Loop::deliver(Port& port) {
  const std::string bytes = port.to_device.arrived(clock.now());
  if (bytes.empty()) return;
  pump(port);
  port.firmware->receive(bytes, clock.now());
}

/// Puts on its line what the device has output, each part at the time it was due: on a busy machine that may
/// have been some time ago, and this must not advance a part that was due later.
void Emulator::Loop::put_on_line(Port& port, Clock::Instant now) {
  std::optional<Clock::Instant> before;
  while (true) {
    // Asked before: an answer to a change of the speed goes at the old one.
    const auto speed = port.line_speed();
    const std::optional<Clock::Instant> due = port.firmware->next_due();
    const bool is_last = !due || *due >= now || due == before;
    const Clock::Instant put_out = std::min(now, due.value_or(now));
    std::string bytes = port.firmware->transmit(is_last ? now : put_out);
    if (!speed) {
      port.output += bytes;
    } else {
      port.output += port.to_host.arrived(now);
      if (!port.client) bytes.clear();
      if (port.to_host.under_way() + bytes.size() > kDeviceBuffer + port.to_host.room(*speed, put_out, now)) {
        dropped += bytes.size();  // Whole messages, as the device itself loses them.
        bytes.clear();
      }
      port.to_host.send(bytes, *speed, terminal_speed(port.slave.get()), put_out);
      port.output += port.to_host.arrived(now);
    }
    if (is_last) return;
    before = due;
  }
}

/// Takes the output of the firmware up to now; if there is too much, the oldest is lost.
void Emulator::Loop::pump(Port& port) {
  put_on_line(port, clock.now());
  const std::size_t capacity = port.client ? kOutputCapacity : 0;
  if (port.output.size() <= capacity) return;
  const std::size_t surplus = port.output.size() - capacity;
  port.output.erase(0, surplus);
  if (port.client) dropped += surplus;
}

void Emulator::Loop::write_to(Port& port) {
  while (!port.output.empty() && port.client) {
    const ssize_t size =
        port.connection.open()
            ? ::send(port.connection.get(), port.output.data(), port.output.size(), MSG_NOSIGNAL)
            : ::write(port.master.get(), port.output.data(), port.output.size());
    if (size > 0) {
      port.output.erase(0, static_cast<std::size_t>(size));
      continue;
    }
    if (size < 0 && errno == EINTR) continue;
    if (size < 0 && errno != EAGAIN && port.connection.open()) hang_up(port);
    return;
  }
}

Emulator::Emulator(std::vector<Endpoint> endpoints, Clock& clock, double clock_rate)
    : loop_(new Loop{.clock = clock, .clock_rate = clock_rate, .ports = {}, .wake = {}}) {
  if (!(clock_rate > 0.0))
    throw std::invalid_argument(fmt::format("emulator: clock_rate is {}, required: above 0", clock_rate));
  loop_->wake = FileDescriptor(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC));
  if (!loop_->wake.open()) fail("its event", "cannot be made");
  for (Endpoint& endpoint : endpoints) {
    if (!endpoint.firmware) throw std::invalid_argument("emulator: an endpoint has no firmware");
    Port& port = loop_->ports.emplace_back();
    port.firmware = std::move(endpoint.firmware);
    port.where = endpoint.where;
    loop_->open(port);
    // A free port was asked for: the one that was given stays the instrument's.
    if (auto* tcp = std::get_if<TcpPort>(&port.where))
      tcp->port = static_cast<std::uint16_t>(std::stoi(port.address.substr(port.address.rfind(':') + 1)));
    loop_->addresses.push_back(port.address);
  }
}

Emulator::~Emulator() = default;

void Emulator::run(std::stop_token stop) {
  std::uint64_t stale = 0;  // the wake-up of a run before
  [[maybe_unused]] const ssize_t drained = ::read(loop_->wake.get(), &stale, sizeof stale);
  const std::stop_callback wake(stop, [this] {
    const std::uint64_t one = 1;
    // It can only fail if a wake-up is pending already.
    [[maybe_unused]] const ssize_t written = ::write(loop_->wake.get(), &one, sizeof one);
  });
  std::vector<pollfd> polled;
  while (!stop.stop_requested()) {
    for (Port& port : loop_->ports) {
      loop_->follow_plug(port);
      loop_->deliver(port);
      loop_->pump(port);
      loop_->write_to(port);
    }

    polled.assign(1, pollfd{.fd = loop_->wake.get(), .events = POLLIN, .revents = 0});
    Clock::Duration wait = kLongestWait;
    for (const Port& port : loop_->ports) {
      const bool waiting = port.client && !port.output.empty();
      const auto events = static_cast<short>(waiting ? POLLIN | POLLOUT : POLLIN);
      polled.push_back({.fd = port.io(), .events = events, .revents = 0});  // poll() ignores a negative one
      polled.push_back({.fd = port.watch.get(), .events = POLLIN, .revents = 0});
      polled.push_back({.fd = port.listener.get(), .events = POLLIN, .revents = 0});
      for (const auto& due :
           {port.firmware->next_due(), port.to_device.next_due(), port.to_host.next_due()}) {
        if (!due) continue;
        const double seconds = to_seconds(*due - loop_->clock.now()) / loop_->clock_rate;
        wait = std::min(wait, from_seconds(std::clamp(seconds, 0.0, to_seconds(kLongestWait))));
      }
    }
    const timespec timeout{.tv_sec = 0, .tv_nsec = static_cast<long>(wait.count())};
    if (::ppoll(polled.data(), polled.size(), &timeout, nullptr) < 0 && errno != EINTR)
      fail("its ports", "cannot wait");

    std::size_t first = 1;
    for (Port& port : loop_->ports) {
      if (first >= polled.size()) break;  // a client that has just connected
      const auto ready = [&](std::size_t which) { return polled[first + which].revents != 0; };
      if (ready(1)) loop_->follow_clients(port);
      if (ready(0) && port.io() == polled[first].fd) loop_->read_from(port);
      if (ready(2)) loop_->accept_client(port);
      first += 3;
    }
    loop_->ports.remove_if([](const Port& port) { return port.session && !port.connection.open(); });
  }
}

std::vector<std::string> Emulator::addresses() const {
  return loop_->addresses;
}

std::uint64_t Emulator::dropped_bytes() const {
  return loop_->dropped;
}

}  // namespace abcal::sim
