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

/// Bytes that never cease to come, the same at each read, whatever is asked and whatever the deadline. A read
/// takes a millisecond of the FakeClock. So that a test of a driver that does not stop fails and does not
/// hang, the stream breaks off after kLongest, which no driver's patience reaches.
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
