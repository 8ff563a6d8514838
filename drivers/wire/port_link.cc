#include "drivers/wire/port_link.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <exception>
#include <system_error>

namespace abcal::wire {
namespace {

std::string lost_because(std::string_view why) {
  return "unplugged, switched off, or closed by the other side (" + std::string(why) + ")";
}

std::string lost_because(int error) {
  return lost_because(std::generic_category().message(error));
}

}  // namespace

PortLink::~PortLink() {
  if (poller_) poller_->remove(*this);
}

void PortLink::start(int descriptor) {
  descriptor_ = descriptor;
  struct stat status {};
  is_socket_ = ::fstat(descriptor, &status) == 0 && S_ISSOCK(status.st_mode);
  ::fcntl(descriptor, F_SETFL, ::fcntl(descriptor, F_GETFL) | O_NONBLOCK);
  poller_ = PortPoller::shared();
  poller_->add(*this);
}

bool PortLink::fetch() noexcept {
  try {
    const std::lock_guard lock(fetch_mutex_);
    while (!queue_.closed()) {
      const ssize_t count = ::read(descriptor_, chunk_.data(), chunk_.size());
      const int error = errno;
      if (count > 0) {
        queue_.push({chunk_.data(), static_cast<std::size_t>(count)}, clock_.now());
        if (static_cast<std::size_t>(count) < chunk_.size()) return true;
      } else if (count == 0) {
        queue_.close(lost_because("End of file"));
      } else if (error == EAGAIN) {
        return true;
      } else if (error != EINTR) {  // A terminal whose other side closed reads as EIO.
        queue_.close(lost_because(error));
      }
    }
  } catch (const std::exception& error) {
    queue_.close(std::string("its bytes cannot be kept: ") + error.what());
  }
  return false;
}

ReceivedBytes PortLink::read_until(Clock::Instant deadline) {
  ReceivedBytes received = queue_.pop_until(deadline);
  if (!received.bytes.empty()) return received;
  fetch();
  return queue_.pop_until(Clock::Instant{});
}

void PortLink::discard() {
  fetch();
  queue_.discard();
}

long PortLink::write_some(std::string_view bytes) const {
  return is_socket_ ? ::send(descriptor_, bytes.data(), bytes.size(), MSG_NOSIGNAL)
                    : ::write(descriptor_, bytes.data(), bytes.size());
}

void PortLink::write(std::string_view bytes) {
  const std::lock_guard lock(write_mutex_);  // One write is never torn by another.
  queue_.throw_if_closed();
  const auto deadline = std::chrono::steady_clock::now() + kWriteDeadline;
  for (std::size_t written = 0; written < bytes.size();) {
    const ssize_t count = write_some(bytes.substr(written));
    const int error = errno;
    if (count >= 0) {
      written += static_cast<std::size_t>(count);
    } else if (error == EAGAIN) {
      const auto left =
          std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
      if (left.count() <= 0)
        throw InstrumentError(queue_.name(), Fault::kNoReply,
                              "took " + std::to_string(written) + " of " + std::to_string(bytes.size()) +
                                  " bytes within 2 s; is flow control (RTS/CTS) set as in the instrument?");
      pollfd room{.fd = descriptor_, .events = POLLOUT, .revents = 0};
      ::poll(&room, 1, static_cast<int>(left.count()));  // Any outcome: the next write reports it.
    } else if (error != EINTR) {
      queue_.close(lost_because(error));
      queue_.throw_if_closed();
    }
  }
}

}  // namespace abcal::wire
