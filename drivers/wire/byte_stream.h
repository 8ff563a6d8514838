#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"

namespace abcal::wire {

/// Received bytes, with their times of arrival.
struct ReceivedBytes {
  /// Bytes that arrived together.
  struct Group {
    std::size_t count = 0;
    Clock::Instant arrival;
  };

  std::string bytes;
  Clock::Instant arrival;       ///< When the last byte arrived.
  std::vector<Group> groups{};  ///< In their order, all bytes; empty: all bytes arrived together.

  /// Adds bytes that arrived later.
  void append(std::string_view more, Clock::Instant at) {
    if (more.empty()) return;
    if (bytes.empty()) {
      groups.clear();
    } else if (at != arrival || !groups.empty()) {
      if (groups.empty()) groups.push_back({bytes.size(), arrival});
      if (at == arrival) {
        groups.back().count += more.size();
      } else {
        groups.push_back({more.size(), at});
      }
    }
    bytes += more;
    arrival = at;
  }

  /// Drops the oldest bytes.
  void drop_front(std::size_t count) {
    bytes.erase(0, count);
    std::size_t gone = 0;
    for (; gone < groups.size() && count >= groups[gone].count; ++gone) count -= groups[gone].count;
    groups.erase(groups.begin(), groups.begin() + static_cast<std::ptrdiff_t>(gone));
    if (!groups.empty()) groups.front().count -= count;
  }

  /// Calls `take(bytes, arrival)` for each group; once, with no bytes, if nothing was received.
  template <class Take>
  void for_each_group(const Take& take) const {
    if (groups.empty()) {
      take(std::string_view(bytes), arrival);
      return;
    }
    std::string_view rest = bytes;
    for (const Group& group : groups) {
      take(rest.substr(0, group.count), group.arrival);
      rest.remove_prefix(group.count);
    }
  }
};

/// A two-way stream of bytes to an instrument: serial port, TCP, simulated firmware, recording.
///
/// One thread reads; any thread may write (one write is never torn by another).
/// All calls throw InstrumentError with Fault::kLinkLost once the port has closed or vanished.
class ByteStream {
 public:
  virtual ~ByteStream() = default;

  /// Writes all of `bytes`, or throws (kNoReply if the port takes none within its write deadline).
  virtual void write(std::string_view bytes) = 0;

  /// Waits until at least one byte has arrived and returns all bytes that have, oldest first; empty at the
  /// deadline. With a deadline in the past it returns the bytes that have already arrived.
  virtual ReceivedBytes read_until(Clock::Instant deadline) = 0;

  /// Discards all input that has arrived.
  virtual void discard_input() = 0;

  /// Bytes dropped because the bounded input queue was full; never decreases.
  virtual std::size_t dropped_bytes() const { return 0; }

  /// For messages: "/dev/ttyUSB0", "tcp:192.168.0.7:50000", "simulated".
  virtual std::string name() const = 0;
};

}  // namespace abcal::wire
