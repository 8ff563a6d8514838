#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/frame.h"
#include "drivers/wire/timed_lock.h"

namespace abcal::wire {

/// The line to a stage's controller: its owner sends and waits for replies, one exchange at a time, while any
/// thread may halt the stage at any moment.
///
/// A driver locks it (std::lock_guard) for each of its calls, and keeps its own state under the same lock.
class HaltableLine {
 public:
  /// How to halt.
  struct Halting {
    std::string stop;          ///< Stops all axes. Sent unchanged; no reply is awaited.
    Clock::Duration deadline;  ///< For all of halt(); a write that is stuck adds its own.
    /// Left to an exchange under way to end; longer than a driver waits for a reply.
    Clock::Duration exchange_patience;
    Clock::Duration retry_interval;
  };
  /// Checks the frame at the beginning of the received bytes. Invalid: all of them are given as one frame.
  using CheckFrame = FrameVerdict (*)(std::string_view);

  /// Sends nothing yet. Messages call it "<what> on <port>" until it is renamed.
  HaltableLine(std::string_view what, std::unique_ptr<ByteStream> stream, Clock& clock,
               CheckFrame check_frame, Halting halting)
      : instrument_(std::string(what) + " on " + stream->name()),
        stream_(std::move(stream)),
        clock_(clock),
        check_frame_(check_frame),
        halting_(std::move(halting)) {}

  void lock() { exchange_lock_.lock(); }
  void unlock() { exchange_lock_.unlock(); }

  /// Stops the stage without waiting for an exchange under way; then takes the line over and asks
  /// `has_stopped` until it returns true, stopping again each time: a move sent just before the first stop
  /// may have been accepted after it. `forget_motion` is called once before; the line is locked for both.
  /// Their own commands are sent, while send() of others throws.
  /// @return false: the stage did not report standstill in time.
  bool halt(const std::function<void()>& forget_motion, const std::function<bool()>& has_stopped) noexcept;

  /// Whether a halt is under way.
  bool halting() const;

  /// Number of halts so far, including one under way: a difference shows that one began in between.
  std::uint64_t halts() const;

  // All following functions require that the line is locked.

  void rename(std::string who) { instrument_ = std::move(who); }
  InstrumentError failure(Fault fault, std::string_view detail) const { return {instrument_, fault, detail}; }

  /// @throws InstrumentError kNotReady while another thread halts the stage.
  void send(std::string_view bytes);

  /// Discards all received bytes.
  void discard_input();

  /// The next frame; absent if none is complete by the deadline (its bytes are kept, see received()). After a
  /// deadline has passed, the stream is read at most once more for it, so a loop over frames ends even if
  /// they never cease.
  std::optional<std::string> take_frame(Clock::Instant deadline);

  /// Received bytes that have not been taken.
  const std::string& received() const { return received_; }

  /// The time `patience` from now, but not beyond the deadline of a halt.
  Clock::Instant deadline_after(Clock::Duration patience) const;

 private:
  void send_stop();
  bool stop_and_ask(Clock::Instant deadline, const std::function<bool()>& has_stopped);

  std::string instrument_;
  const std::unique_ptr<ByteStream> stream_;
  Clock& clock_;
  const CheckFrame check_frame_;
  const Halting halting_;

  TimedLock exchange_lock_;
  std::string received_;
  /// A deadline that had passed at the last read of the stream, with nothing sent since.
  std::optional<Clock::Instant> looked_after_;
  /// Set while the lock is held by halt(): its deadline.
  std::optional<Clock::Instant> halt_deadline_;

  mutable std::mutex send_mutex_;  ///< Held for one write; taken after the exchange lock where both are.
  int halts_under_way_ = 0;        ///< Guarded by send_mutex_, as is:
  std::uint64_t halts_ = 0;
};

}  // namespace abcal::wire
