#include "app/measure/guard/guarded_connection.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>

#include "app/measure/bench/probe_ports.h"
#include "app/system/channel.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/halt_recipe.h"
#include "drivers/wire/port_descriptor.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

/// Longest wait of a thread before it looks at its orders again.
constexpr Clock::Duration kSlice = 20ms;
/// Between two attempts to halt.
constexpr Clock::Duration kBetweenHalts = 1s;
/// The longest that bytes wait for an owner who does not read; then they are dropped.
constexpr int kOwnerWaitMs = 100;

/// The USB device behind a serial port that is open by `path`; nothing for another port.
std::optional<wire::PortInfo> usb_device_of(const std::string& path) {
  std::error_code error;
  const std::filesystem::path real = std::filesystem::canonical(path, error);
  if (error) return std::nullopt;
  for (wire::PortInfo& port : wire::list_ports())
    if (port.usb_vendor && std::filesystem::canonical(port.path, error) == real) return std::move(port);
  return std::nullopt;
}

/// The same device, wherever it is plugged in now.
std::optional<wire::PortInfo> find_again(const wire::PortInfo& device) {
  for (wire::PortInfo& port : wire::list_ports()) {
    const bool is_same = port.usb_vendor == device.usb_vendor && port.usb_product == device.usb_product &&
                         port.serial_number == device.serial_number;
    // Without a serial number only the place distinguishes two devices of one kind.
    if (is_same && (!device.serial_number.empty() || port.path == device.path)) return std::move(port);
  }
  return std::nullopt;
}

}  // namespace

GuardedConnection::GuardedConnection(Clock& clock, OpenPort open, Listener listener)
    : clock_(clock), open_(std::move(open)), listener_(std::move(listener)) {
  keeper_ = std::jthread([this](const std::stop_token& end) { keep(end); });
  passer_ = std::jthread([this](const std::stop_token& end) { pass_output(end); });
}

GuardedConnection::~GuardedConnection() {
  keeper_ = {};
  passer_ = {};
  close_owner_side();
}

void GuardedConnection::open(PortRequest request) {
  {
    const std::lock_guard lock(mutex_);
    wanted_ = std::move(request);
  }
  changed_.notify_all();
}

void GuardedConnection::take_over(PortRequest request) {
  {
    const std::lock_guard lock(mutex_);
    request_ = std::move(request);
    begin_halt_locked(State::kUnreachable);
  }
  changed_.notify_all();
}

/// The next attempt is due at once, and its result is news.
void GuardedConnection::begin_halt_locked(State state) {
  status_.state = state;
  status_.since = clock_.utc_now();
  is_reported_ = false;
  next_attempt_ = clock_.now();
}

void GuardedConnection::set_recipes(std::vector<HaltRecipe> recipes) {
  const std::lock_guard lock(mutex_);
  recipes_ = std::move(recipes);
  status_.axes = {};
  status_.chamber.clear();
  for (const HaltRecipe& recipe : recipes_) {
    for (std::size_t k = 0; k < 2; ++k) status_.axes[k] = status_.axes[k] || recipe.axes[k];
    if (!recipe.chamber.empty()) status_.chamber = recipe.chamber;
  }
}

std::vector<HaltRecipe> GuardedConnection::recipes() const {
  const std::lock_guard lock(mutex_);
  return recipes_;
}

void GuardedConnection::drop(bool halt) {
  close_owner_side();
  {
    const std::lock_guard lock(mutex_);
    // A port that was closed while the axes were at rest has nothing to halt.
    if (!halt || recipes_.empty() || !status_.is_done() || status_.state == State::kClosed) return;
    begin_halt_locked(State::kHalting);
  }
  changed_.notify_all();
}

GuardedConnection::Status GuardedConnection::status() const {
  const std::lock_guard lock(mutex_);
  return status_;
}

void GuardedConnection::set_state(State state, std::string detail) {
  const std::lock_guard lock(mutex_);
  if (status_.state != state) status_.since = clock_.utc_now();
  status_.state = state;
  status_.detail = std::move(detail);
}

/// After this no byte of the owner reaches the port.
void GuardedConnection::close_owner_side() {
  const std::lock_guard pass(pass_mutex_);
  const std::lock_guard lock(mutex_);
  owner_.close();
}

void GuardedConnection::keep(const std::stop_token& end) {
  while (!end.stop_requested()) {
    std::optional<PortRequest> request;
    State state = State::kClosed;
    {
      std::unique_lock lock(mutex_);
      const auto has_work = [this] {
        return wanted_ || status_.state == State::kPassing || status_.state == State::kAtRest ||
               (!status_.is_done() && clock_.now() >= next_attempt_);
      };
      changed_.wait_for(lock, end, kSlice, has_work);
      if (!has_work()) continue;
      request = std::exchange(wanted_, std::nullopt);
      state = status_.state;
    }
    if (request)
      serve(*request);
    else if (state == State::kPassing || state == State::kAtRest)
      pass_input();
    else
      halt_once();
  }
}

void GuardedConnection::serve(const PortRequest& request) {
  if (const Status now = status(); !now.is_done()) {
    listener_.failed(
        InstrumentError(request.port, Fault::kCannotOpen,
                        "its guard is halting the instrument behind it, which is not confirmed yet" +
                            (now.detail.empty() ? "" : " (" + now.detail + ")")));
    return;
  }
  close_owner_side();
  try {
    {
      const std::lock_guard lock(mutex_);
      request_ = request;
      if (status_.state != State::kAtRest) stream_.reset();
      if (!stream_) status_.state = State::kClosed;
    }
    std::shared_ptr<wire::ByteStream> stream = stream_;
    if (!stream) stream = open_(request);
    const auto* port = dynamic_cast<const wire::PortDescriptor*>(stream.get());
    Descriptor duplicate(port == nullptr ? -1 : ::fcntl(port->descriptor(), F_DUPFD_CLOEXEC, 0));
    auto [ours, theirs] = channel_pair(ChannelKind::kBytes, request.port);
    const std::string name = stream->name();
    {
      const std::lock_guard lock(mutex_);
      stream_ = std::move(stream);
      leases_ = port == nullptr ? std::vector<std::shared_ptr<wire::Lease>>{} : port->leases();
      owner_ = std::move(ours);
    }
    usb_ = usb_device_of(name);
    set_state(State::kPassing);
    std::vector<Descriptor> for_owner;
    for_owner.push_back(std::move(theirs));
    if (duplicate.number() >= 0) for_owner.push_back(std::move(duplicate));
    const bool is_unmistakable = usb_ && !usb_->serial_number.empty();
    listener_.opened(name, is_unmistakable ? usb_name(*usb_) : request.port, for_owner);
  } catch (const std::system_error& error) {
    listener_.failed(InstrumentError(request.port, Fault::kCannotOpen, error.code().message()));
  } catch (const std::exception& error) {
    listener_.failed(error);
  }
}

void GuardedConnection::pass_input() {
  try {
    const wire::ReceivedBytes received = stream_->read_until(clock_.now() + kSlice);
    if (!received.bytes.empty()) pass_to_owner(received.bytes);
  } catch (const InstrumentError& error) {
    lose(error.detail());
  }
}

void GuardedConnection::pass_to_owner(std::string_view bytes) {
  while (!bytes.empty()) {
    pollfd ready{.fd = -1, .events = POLLOUT, .revents = 0};
    {
      const std::lock_guard lock(mutex_);
      if (owner_.number() < 0 || !status_.is_done())
        return;  // The owner's side is closed: the halt has priority.
      ready.fd = owner_.number();
      const ssize_t written = ::send(ready.fd, bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
      if (written > 0) {
        bytes.remove_prefix(static_cast<std::size_t>(written));
        continue;
      }
      if (errno != EAGAIN && errno != EINTR) return;
    }
    if (::poll(&ready, 1, kOwnerWaitMs) != 1) return;
  }
}

/// The port has failed: it is closed for the owner, and the axes are halted when it is back.
void GuardedConnection::lose(const std::string& why) {
  close_owner_side();
  {
    const std::lock_guard lock(mutex_);
    stream_.reset();
  }
  const bool may_move = listener_.lost(why);
  const std::lock_guard lock(mutex_);
  const bool is_halting = !status_.is_done();  // Asked for while the port was being lost.
  status_.detail = why;
  if ((may_move || is_halting) && !recipes_.empty()) return begin_halt_locked(State::kUnreachable);
  status_.state = State::kClosed;
  status_.since = clock_.utc_now();
}

bool GuardedConnection::reopen() {
  PortRequest request = request_;
  try {
    if (usb_) {
      const auto again = find_again(*usb_);
      if (!again)
        throw InstrumentError(request.port, Fault::kCannotOpen, "the same USB device is not connected");
      request.port = again->path;
    }
    std::shared_ptr<wire::ByteStream> stream = open_(request);
    const std::lock_guard lock(mutex_);
    stream_ = std::move(stream);
    return true;
  } catch (const std::exception& error) {
    set_state(State::kUnreachable, error.what());
    return false;
  }
}

void GuardedConnection::halt_once() {
  const Clock::Instant begun = clock_.now();
  bool is_confirmed = stream_ != nullptr || reopen();
  if (is_confirmed) {
    for (const HaltRecipe& recipe : recipes()) {
      const Clock::Instant deadline = clock_.now() + wire::longest_halt(recipe);
      is_confirmed = wire::carry_out(recipe, *stream_, clock_, deadline) && is_confirmed;
    }
    if (is_confirmed) {
      set_state(State::kAtRest);
    } else {
      set_state(State::kUnreachable, "the controller does not confirm the halt");
      try {
        stream_->read_until(clock_.now());
      } catch (const InstrumentError& error) {  // Unplugged: opened again for the next attempt.
        const std::lock_guard lock(mutex_);
        stream_.reset();
        status_.detail = error.detail();
      }
    }
  }
  bool is_news = false;
  {
    const std::lock_guard lock(mutex_);
    next_attempt_ = begun + kBetweenHalts;
    is_news = !std::exchange(is_reported_, true) || is_confirmed;
  }
  if (is_news) listener_.halted(status());
}

void GuardedConnection::pass_output(const std::stop_token& end) {
  std::array<char, 4096> chunk{};
  while (!end.stop_requested()) {
    int owner = -1;
    {
      const std::lock_guard lock(mutex_);
      owner = owner_.number();
    }
    if (!wait_until_readable(owner, kSlice)) continue;  // Without an owner only the time passes.
    if (!listener_.may_pass()) {
      clock_.sleep_until(clock_.now() + kSlice);
      continue;
    }
    const std::lock_guard pass(pass_mutex_);
    std::shared_ptr<wire::ByteStream> stream;
    ssize_t count = 0;
    {
      const std::lock_guard lock(mutex_);
      if (owner_.number() != owner || status_.state != State::kPassing) continue;
      count = ::recv(owner, chunk.data(), chunk.size(), MSG_DONTWAIT);
      if (count == 0) owner_.close();  // The owner has closed the port.
      stream = stream_;
    }
    if (count <= 0 || !stream) continue;
    try {
      stream->write({chunk.data(), static_cast<std::size_t>(count)});
    } catch (
        const InstrumentError&) {  // The keeper finds the port gone as well; a full one blocks the owner.
    }
  }
}

}  // namespace abcal
