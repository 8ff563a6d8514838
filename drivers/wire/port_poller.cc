#include "drivers/wire/port_poller.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <system_error>

namespace abcal::wire {

std::shared_ptr<PortPoller> PortPoller::shared() {
  static std::mutex mutex;
  static std::weak_ptr<PortPoller> running;
  const std::lock_guard lock(mutex);
  std::shared_ptr<PortPoller> poller = running.lock();
  if (!poller) running = poller = std::make_shared<PortPoller>();
  return poller;
}

PortPoller::PortPoller() : wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  if (wake_ < 0) throw std::system_error(errno, std::generic_category(), "the thread that reads ports");
  thread_ = std::thread([this] { run(); });
}

PortPoller::~PortPoller() {
  {
    std::unique_lock lock(mutex_);
    stop_ = true;
    change(lock);
  }
  thread_.join();
  ::close(wake_);
}

/// Wakes the thread, so that it polls the changed ports.
void PortPoller::change(const std::unique_lock<std::mutex>& /*lock*/) {
  ++version_;
  const std::uint64_t one = 1;
  // It can only fail if a wake-up is pending already.
  [[maybe_unused]] const ssize_t written = ::write(wake_, &one, sizeof one);
}

void PortPoller::add(PolledPort& port) {
  std::unique_lock lock(mutex_);
  ports_.push_back(&port);
  change(lock);
}

void PortPoller::remove(PolledPort& port) {
  std::unique_lock lock(mutex_);
  std::erase(ports_, &port);
  change(lock);
  const std::uint64_t wanted = version_;
  seen_changed_.wait(lock, [&] { return seen_ >= wanted; });
}

void PortPoller::run() {
  std::vector<pollfd> polled;
  std::vector<PolledPort*> ports;
  auto last_pass = std::chrono::steady_clock::time_point{};
  for (;;) {
    {
      const std::lock_guard lock(mutex_);
      if (seen_ != version_) {
        ports = ports_;
        polled.assign(1, pollfd{.fd = wake_, .events = POLLIN, .revents = 0});
        for (const PolledPort* port : ports)
          polled.push_back({.fd = port->descriptor(), .events = POLLIN, .revents = 0});
        seen_ = version_;
        seen_changed_.notify_all();
      }
      if (stop_) return;
    }
    if (::poll(polled.data(), polled.size(), -1) < 0) continue;  // Interrupted by a signal.
    {
      const std::lock_guard lock(mutex_);
      if (polled.front().revents != 0) {
        std::uint64_t count = 0;
        [[maybe_unused]] const ssize_t drained = ::read(wake_, &count, sizeof count);
      }
      if (seen_ != version_) continue;  // A port that is ready may have been removed.
      for (std::size_t i = 0; i < ports.size(); ++i)
        if (polled[i + 1].revents != 0 && !ports[i]->fetch()) polled[i + 1].fd = -1;
    }
    const auto now = std::chrono::steady_clock::now();
    if (last_pass + kInterval > now) {
      std::this_thread::sleep_until(last_pass + kInterval);
      last_pass += kInterval;
    } else {
      last_pass = now;
    }
  }
}

}  // namespace abcal::wire
