#pragma once

#include <iosfwd>
#include <memory>
#include <mutex>

#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// Passes everything through to another stream and notes it, one chunk a line:
/// "<nanoseconds since this object was made> <direction> <hex bytes>", direction '>' for what we wrote and
/// '<' for what came in (with its time of arrival, as the inner stream gave it). Safe with writers in other
/// threads.
class RecordingStream final : public ByteStream {
 public:
  /// @param log Must outlive the stream; lines of several streams may not go to one log.
  RecordingStream(std::unique_ptr<ByteStream> inner, const Clock& clock, std::ostream& log);

  void write(std::string_view bytes) override;
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override;

 private:
  void note(char direction, std::string_view bytes, Clock::Instant when);

  std::unique_ptr<ByteStream> inner_;
  const Clock& clock_;
  const Clock::Instant start_;
  std::mutex log_mutex_;
  std::ostream& log_;
};

}  // namespace abcal::wire
