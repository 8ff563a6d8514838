#include "drivers/wire/recording_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <mutex>
#include <thread>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "tests/support/fake_clock.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using Kind = WireEvent::Kind;

/// Answers each read with given bytes; its link can break.
class TalkingStream final : public ByteStream {
 public:
  void write(std::string_view bytes) override {
    if (bytes == "kill") throw InstrumentError("talking", Fault::kLinkLost, "killed");
  }
  ReceivedBytes read_until(Clock::Instant) override {
    if (next == "broken") throw InstrumentError("talking", Fault::kLinkLost, "broken");
    return {std::exchange(next, std::exchange(after_next, {})), arrival};
  }
  void discard_input() override { next.clear(); }
  std::size_t dropped_bytes() const override { return dropped; }
  std::string name() const override { return "talking"; }
  std::string next, after_next;
  Clock::Instant arrival;
  std::size_t dropped = 0;
};

class RecordingStreamTest : public ::testing::Test {
 protected:
  /// Events since the last call; at the beginning without "opened".
  std::vector<WireEvent> told() { return std::exchange(events_, {}); }

  test::FakeClock clock_;
  const Clock::Instant start_ = clock_.now();
  std::mutex mutex_;
  std::vector<WireEvent> events_;
  std::unique_ptr<TalkingStream> owned_ = std::make_unique<TalkingStream>();
  TalkingStream& inner_ = *owned_;
  RecordingStream stream_{std::move(owned_), clock_, [this](WireEvent&& event) {
                            const std::lock_guard lock(mutex_);
                            events_.push_back(std::move(event));
                          }};
};

TEST_F(RecordingStreamTest, TellsFirstWhatIsOpen) {
  EXPECT_THAT(told(), ElementsAre(WireEvent{Kind::kOpened, start_, {}, "talking"}));
}

TEST_F(RecordingStreamTest, TellsBothDirectionsAndEmptyHandsWithTheirTimes) {
  told();
  clock_.advance(5ns);
  stream_.write("POS? 1\n");
  clock_.advance(2ms);
  inner_.next = std::string("1=\xB0\0\n", 5);
  inner_.arrival = start_ + 1ms;
  EXPECT_EQ(stream_.read_until(clock_.now()).bytes, std::string("1=\xB0\0\n", 5));
  EXPECT_EQ(stream_.read_until(clock_.now()).bytes, "");
  EXPECT_THAT(told(), ElementsAre(WireEvent{Kind::kWritten, start_ + 5ns, {}, "POS? 1\n"},
                                  WireEvent{Kind::kReceived, start_ + 5ns + 2ms, start_ + 1ms,
                                            std::string("1=\xB0\0\n", 5)},
                                  WireEvent{Kind::kReceived, start_ + 5ns + 2ms, start_ + 1ms, ""}));
}

TEST_F(RecordingStreamTest, ACommandThatKillsTheLinkIsToldAndThenTheFailure) {
  told();
  EXPECT_THROW(stream_.write("kill"), InstrumentError);
  EXPECT_THAT(told(), ElementsAre(WireEvent{Kind::kWritten, start_, {}, "kill"},
                                  WireEvent{Kind::kFailed, start_, {}, "write\nlink lost\ntalking\nkilled"}));
}

TEST_F(RecordingStreamTest, FailuresOfReadingAreToldWithTheCallThatFailed) {
  told();
  inner_.next = "broken";
  EXPECT_THROW(stream_.read_until(clock_.now()), InstrumentError);
  inner_.next = "stale";
  inner_.after_next = "broken";
  EXPECT_THROW(stream_.discard_input(), InstrumentError);
  EXPECT_THAT(told(),
              ElementsAre(WireEvent{Kind::kFailed, start_, {}, "read\nlink lost\ntalking\nbroken"},
                          WireEvent{Kind::kDiscarded, start_, {}, "stale"},
                          WireEvent{Kind::kFailed, start_, {}, "discard\nlink lost\ntalking\nbroken"}));
}

TEST_F(RecordingStreamTest, WhatIsDiscardedIsToldOnce) {
  told();
  inner_.next = "stale";
  inner_.after_next = " bytes";
  stream_.discard_input();
  EXPECT_EQ(inner_.next, "");
  stream_.discard_input();  // No input, no event.
  EXPECT_THAT(told(), ElementsAre(WireEvent{Kind::kDiscarded, start_, {}, "stale bytes"}));
}

TEST_F(RecordingStreamTest, DroppedBytesAreToldWhenTheyChange) {
  told();
  EXPECT_EQ(stream_.dropped_bytes(), 0U);
  inner_.dropped = 7;
  EXPECT_EQ(stream_.dropped_bytes(), 7U);
  EXPECT_EQ(stream_.dropped_bytes(), 7U);
  EXPECT_THAT(told(), ElementsAre(WireEvent{Kind::kDropped, start_, {}, "7"}));
}

TEST_F(RecordingStreamTest, SeveralThreadsMayWrite) {
  told();
  const auto write_often = [this](std::string_view bytes) {
    for (int i = 0; i < 500; ++i) stream_.write(bytes);
  };
  std::thread other(write_often, "\x18");
  write_often("ERR?\n");
  other.join();
  const auto events = told();
  const auto count = [&](std::string_view bytes) {
    return std::count_if(events.begin(), events.end(), [&](const WireEvent& e) { return e.bytes == bytes; });
  };
  EXPECT_EQ(count("\x18"), 500);
  EXPECT_EQ(count("ERR?\n"), 500);
}

TEST(WireFailureTest, ComesBackFromItsTextAndNothingElsePassesForOne) {
  const InstrumentError error("PI stage on /dev/ttyUSB0", Fault::kCannotOpen, "two\nlines");
  const WireFailure failure = parse_failure(failure_text(WireCall::kDiscard, error));
  EXPECT_EQ(failure.call, WireCall::kDiscard);
  EXPECT_STREQ(failure.error.what(), error.what());
  EXPECT_EQ(failure.error.fault(), Fault::kCannotOpen);
  EXPECT_EQ(failure.error.detail(), "two\nlines");
  for (const char* text : {"", "read", "read\nno such fault\nx\ny", "sing\nlink lost\nx\ny"}) {
    EXPECT_THROW(parse_failure(text), std::invalid_argument) << text;
  }
}

}  // namespace
}  // namespace abcal::wire
