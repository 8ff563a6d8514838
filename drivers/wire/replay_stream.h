#pragma once

#include <cstddef>
#include <mutex>
#include <string>
#include <vector>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/wire_event.h"

namespace abcal::wire {

/// A stream that behaves as a recorded one did: call by call the same bytes, silences and failures, at the
/// same times. The clock jumps to the time of each event; it is never moved back.
///
/// What is written must be what was recorded. A read gives what the read at this place of the recording
/// gave, whatever its deadline is now; where the recording has a write next it gives nothing at its deadline,
/// as an instrument that was asked nothing. A driver that has been changed may so be tried on an old
/// recording, as long as it says the same things in the same order.
///
/// Any thread, one call at a time.
class ReplayStream final : public ByteStream {
 public:
  /// In the detail of the kLinkLost that is thrown behind the last event.
  static constexpr std::string_view kEndsHere = "the recording ends here";

  /// @param events Of one stream, in their order.
  /// @param clock Must jump in sleep_until(), and outlive the stream.
  ReplayStream(std::vector<WireEvent> events, Clock& clock);

  /// @throws InstrumentError kLinkLost "the replay leaves the recording" if `bytes` are not what was written
  /// then: nobody knows what the instrument would have said.
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
  std::string name_ = "recording";
  mutable std::mutex mutex_;
  mutable std::size_t cursor_ = 0;
  mutable std::size_t dropped_ = 0;
  ReceivedBytes waiting_;  ///< Read in the recording before the write that has just been made.
};

}  // namespace abcal::wire
