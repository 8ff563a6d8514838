#pragma once

#include <memory>
#include <utility>

#include "app/measure/guard/halt_guard.h"
#include "drivers/instrument/clock.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// A clock whose waits are signs of life for the guard of the stage. Real time only.
class BeatingClock final : public Clock {
 public:
  /// Longest part of a wait between two beats.
  static constexpr Duration kSlice = std::chrono::milliseconds(200);

  BeatingClock(std::unique_ptr<Clock> clock, std::shared_ptr<HaltGuard> guard)
      : clock_(std::move(clock)), guard_(std::move(guard)) {}

  Instant now() const override { return clock_->now(); }
  UtcTime utc_now() const override { return clock_->utc_now(); }
  void sleep_until(Instant instant) override;

 private:
  std::unique_ptr<Clock> clock_;
  std::shared_ptr<HaltGuard> guard_;
};

/// A stream whose waits for bytes are signs of life for the guard of the stage. Real time only.
class BeatingStream final : public wire::ByteStream {
 public:
  BeatingStream(std::unique_ptr<wire::ByteStream> stream, std::shared_ptr<HaltGuard> guard,
                const Clock& clock)
      : stream_(std::move(stream)), guard_(std::move(guard)), clock_(clock) {}

  void write(std::string_view bytes) override;
  wire::ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override { stream_->discard_input(); }
  std::size_t dropped_bytes() const override { return stream_->dropped_bytes(); }
  std::string name() const override { return stream_->name(); }

 private:
  std::unique_ptr<wire::ByteStream> stream_;
  std::shared_ptr<HaltGuard> guard_;
  const Clock& clock_;
};

}  // namespace abcal
