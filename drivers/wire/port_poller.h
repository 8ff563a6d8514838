#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace abcal::wire {

/// A port whose bytes are fetched as they arrive. Used inside this folder only.
class PolledPort {
 public:
  virtual int descriptor() const = 0;
  /// Takes the bytes that the system holds. @return false: the port has ended
  virtual bool fetch() noexcept = 0;

 protected:
  ~PolledPort() = default;
};

/// The one thread of this program that waits for the bytes of all ports at once. While ports stream it wakes
/// at most every kInterval and takes what all of them have, so that its cost does not grow with the number of
/// readings. Used inside this folder only.
class PortPoller {
 public:
  /// Least time between two wake-ups while ports stream. It is not a multiple or part of usual sampling
  /// periods, so that some of many readings are fetched right after their arrival.
  static constexpr std::chrono::microseconds kInterval{1310};

  /// The poller that all ports of this program share; it ends with the last of them.
  static std::shared_ptr<PortPoller> shared();

  PortPoller();
  ~PortPoller();
  PortPoller(const PortPoller&) = delete;
  PortPoller& operator=(const PortPoller&) = delete;

  /// From now on `port` is asked to fetch; it must outlive its removal.
  void add(PolledPort& port);
  /// Returns when the thread neither calls `port` nor waits for its descriptor any more.
  void remove(PolledPort& port);

 private:
  void run();
  void change(const std::unique_lock<std::mutex>& lock);

  const int wake_;
  std::mutex mutex_;
  std::condition_variable seen_changed_;
  std::vector<PolledPort*> ports_;
  std::uint64_t version_ = 1;  ///< Changes with ports_; the thread has seen none yet.
  std::uint64_t seen_ = 0;     ///< Version for which the thread waits.
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace abcal::wire
