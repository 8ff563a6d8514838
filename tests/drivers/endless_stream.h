#pragma once

#include <chrono>
#include <cstddef>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"
#include "tests/support/fake_clock.h"

namespace abcal::test {

/// An endless stream of bytes, the same at each read, for any command and deadline. A read takes a
/// millisecond of the FakeClock. The stream ends with an error after kLongest, which exceeds every driver's
/// patience, so that the test of a driver that does not stop fails instead of hanging.
class EndlessStream final : public wire::ByteStream {
 public:
  static constexpr std::chrono::minutes kLongest{5};

  EndlessStream(FakeClock& clock, std::string bytes)
      : clock_(clock), bytes_(std::move(bytes)), end_(clock.now() + kLongest) {}

  void write(std::string_view) override {}
  wire::ReceivedBytes read_until(Clock::Instant) override {
    if (clock_.now() >= end_) throw InstrumentError(name(), Fault::kLinkLost, "still read after minutes");
    clock_.advance(std::chrono::milliseconds(1));
    given_ += bytes_.size();
    return {bytes_, clock_.now()};
  }
  void discard_input() override {}
  std::string name() const override { return "endless"; }

  /// Bytes that were read.
  std::size_t given() const { return given_; }

 private:
  FakeClock& clock_;
  const std::string bytes_;
  const Clock::Instant end_;
  std::size_t given_ = 0;
};

}  // namespace abcal::test
