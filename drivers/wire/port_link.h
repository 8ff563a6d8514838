#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "drivers/wire/port_poller.h"
#include "drivers/wire/receive_queue.h"

namespace abcal::wire {

/// The bytes of an open descriptor (a serial port or a socket): fetched into a queue as they arrive, with the
/// time, by the thread that all ports share. Used inside this folder only.
class PortLink final : private PolledPort {
 public:
  static constexpr Clock::Duration kWriteDeadline = std::chrono::seconds(2);

  /// @param clock  stamps the arrivals, in several threads
  PortLink(std::string name, Clock& clock, std::size_t queue_bytes)
      : clock_(clock), queue_(std::move(name), queue_bytes) {}
  ~PortLink();
  PortLink(const PortLink&) = delete;
  PortLink& operator=(const PortLink&) = delete;

  /// An open and configured descriptor, which must stay open as long as this lives. From here on it does not
  /// block.
  void start(int descriptor);

  ReceiveQueue& queue() { return queue_; }
  const ReceiveQueue& queue() const { return queue_; }

  /// Bytes that have arrived by the deadline; empty: none. Bytes that the system holds have arrived: on a
  /// busy machine the thread that fetches them is late, not the instrument.
  /// @throws InstrumentError kLinkLost
  ReceivedBytes read_until(Clock::Instant deadline);

  /// Discards all bytes that have arrived. @throws InstrumentError kLinkLost
  void discard();

  /// @throws InstrumentError kNoReply after kWriteDeadline, kLinkLost
  void write(std::string_view bytes);

 private:
  int descriptor() const override { return descriptor_; }
  bool fetch() noexcept override;
  long write_some(std::string_view bytes) const;

  Clock& clock_;
  ReceiveQueue queue_;
  int descriptor_ = -1;
  bool is_socket_ = false;
  std::mutex fetch_mutex_;  ///< Guards chunk_, and the order of the bytes.
  std::array<char, 65536> chunk_{};
  std::mutex write_mutex_;
  std::shared_ptr<PortPoller> poller_;  ///< Null before start().
};

}  // namespace abcal::wire
