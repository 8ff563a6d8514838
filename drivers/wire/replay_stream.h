#pragma once

#include <cstddef>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/wire_event.h"

namespace abcal::wire {

/// A stream that repeats a recorded one: call by call the same bytes, silences and failures, at the same
/// times. The clock jumps to the time of each event; it is never moved back.
///
/// Writes must equal the recorded ones. A read returns the result of the read at this place of the recording,
/// regardless of its present deadline; if the recording continues with a write, it returns nothing at its
/// deadline, like an instrument that was not asked. A changed driver can thus be tried on an old recording,
/// as long as it sends the same bytes in the same order.
///
/// Any thread, one call at a time.
class ReplayStream final : public ByteStream {
 public:
  /// @param events Of one stream, in their order.
  /// @param clock Must jump in sleep_until(), and outlive the stream.
  /// @param on_end Called where the recording has nothing more to give, before kLinkLost is thrown.
  ReplayStream(std::vector<WireEvent> events, Clock& clock, std::function<void()> on_end = {});

  /// @throws InstrumentError kLinkLost "the replay leaves the recording" if `bytes` differ from the recorded
  /// ones: the instrument's answer to them is not known.
  void write(std::string_view bytes) override;
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override { return name_; }

 private:
  const WireEvent* next() const;
  [[noreturn]] void fail_as_recorded();
  [[noreturn]] void end() const;
  [[noreturn]] void leave(std::string_view found, const WireEvent& recorded) const;

  const std::vector<WireEvent> events_;
  Clock& clock_;
  std::function<void()> on_end_;
  std::string name_ = "recording";
  mutable std::mutex mutex_;
  mutable std::size_t cursor_ = 0;
  mutable std::size_t dropped_ = 0;
  ReceivedBytes waiting_;  ///< Read in the recording before the write that has just been made.
};

}  // namespace abcal::wire
