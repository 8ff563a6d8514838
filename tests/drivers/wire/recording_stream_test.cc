#include "drivers/wire/recording_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <sstream>
#include <thread>

#include "drivers/instrument/instrument_error.h"
#include "tests/support/fake_clock.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;

/// Answers each read with what it was told to; a link that can break.
class TalkingStream final : public ByteStream {
 public:
  explicit TalkingStream(test::FakeClock& clock) : clock_(clock) {}
  void write(std::string_view bytes) override {
    if (bytes == "kill") throw InstrumentError("talking", Fault::kLinkLost, "killed");
  }
  ReceivedBytes read_until(Clock::Instant) override { return {std::exchange(next, {}), clock_.now()}; }
  void discard_input() override { next.clear(); }
  std::size_t dropped_bytes() const override { return 7; }
  std::string name() const override { return "talking"; }
  std::string next;

 private:
  test::FakeClock& clock_;
};

class RecordingStreamTest : public ::testing::Test {
 protected:
  test::FakeClock clock_;
  std::ostringstream log_;
  std::unique_ptr<TalkingStream> owned_ = std::make_unique<TalkingStream>(clock_);
  TalkingStream& inner_ = *owned_;
  RecordingStream stream_{std::move(owned_), clock_, log_};
};

TEST_F(RecordingStreamTest, NotesBothDirectionsWithTheirTimes) {
  clock_.advance(5ns);
  stream_.write("POS? 1\n");
  clock_.advance(2ms);
  inner_.next = std::string("1=\xB0\0\n", 5);
  EXPECT_EQ(stream_.read_until(clock_.now()).bytes, std::string("1=\xB0\0\n", 5));
  EXPECT_EQ(stream_.read_until(clock_.now()).bytes, "");  // Nothing came: nothing to note.
  EXPECT_EQ(log_.str(), "5 > 504f533f20310a\n2000005 < 313db0000a\n");
}

TEST_F(RecordingStreamTest, ACommandThatKillsTheLinkIsStillOnFile) {
  EXPECT_THROW(stream_.write("kill"), InstrumentError);
  EXPECT_EQ(log_.str(), "0 > 6b696c6c\n");
}

TEST_F(RecordingStreamTest, WhatIsDiscardedIsOnFileToo) {
  inner_.next = "stale";
  stream_.discard_input();
  EXPECT_EQ(inner_.next, "");
  EXPECT_EQ(log_.str(), "0 < 7374616c65\n");
}

TEST_F(RecordingStreamTest, PassesTheRestThrough) {
  EXPECT_EQ(stream_.name(), "talking");
  EXPECT_EQ(stream_.dropped_bytes(), 7U);
}

TEST_F(RecordingStreamTest, LinesOfSeveralThreadsAreNotMixed) {
  const auto write_often = [this](std::string_view bytes) {
    for (int i = 0; i < 500; ++i) stream_.write(bytes);
  };
  std::thread other(write_often, "\x18");
  write_often("ERR?\n");
  other.join();
  std::istringstream lines(log_.str());
  std::array<int, 2> counts{};
  for (std::string line; std::getline(lines, line);) {
    counts[0] += line == "0 > 18";
    counts[1] += line == "0 > 4552523f0a";
  }
  EXPECT_EQ(counts, (std::array<int, 2>{500, 500}));
}

}  // namespace
}  // namespace abcal::wire
