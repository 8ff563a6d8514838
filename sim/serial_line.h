#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// One direction of a serial line, 8N1: a byte takes ten bits, and a byte read at another speed than it was
/// sent with becomes noise. Bytes are handed over in groups, as by a UART with a FIFO.
class SerialLine {
 public:
  /// Bytes at a time.
  static constexpr std::size_t kFifo = 16;

  /// Whether bytes sent at one speed can be read at the other.
  static bool fits(unsigned sent, unsigned read);

  /// `bytes` are sent from `at` on, behind bytes already under way, at `speed` Bd. `read_at`: the speed of
  /// the other end; absent: the same.
  void send(std::string_view bytes, unsigned speed, std::optional<unsigned> read_at, Clock::Instant at);

  /// Bytes that it carries from `at` to `now` behind those already under way.
  std::size_t room(unsigned speed, Clock::Instant at, Clock::Instant now) const;

  /// Bytes that have arrived since the last call.
  std::string arrived(Clock::Instant now);

  /// When the next bytes are handed over; absent: none are under way.
  std::optional<Clock::Instant> next_due() const;

  std::size_t under_way() const { return under_way_; }
  void clear();

 private:
  struct Piece {
    Clock::Instant start;
    double bytes_per_s;  ///< Speed of the receiver.
    std::string bytes;
    std::size_t taken = 0;

    Clock::Instant time_of(std::size_t count) const;
  };

  std::deque<Piece> pieces_;
  Clock::Instant free_at_ = Clock::Instant::min();
  std::size_t under_way_ = 0;
  std::uint64_t noise_ = 0;
};

}  // namespace abcal::sim
