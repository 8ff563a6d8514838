#include "drivers/wire/replay_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/recording_stream.h"
#include "tests/support/error_of.h"
#include "tests/support/fake_clock.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using testing::AllOf;
using testing::HasSubstr;
using Kind = WireEvent::Kind;

constexpr Clock::Instant at(Clock::Duration time) {
  return Clock::Instant(time);
}
WireEvent written(Clock::Duration time, std::string bytes) {
  return {Kind::kWritten, at(time), {}, std::move(bytes)};
}
WireEvent received(Clock::Duration time, std::string bytes, Clock::Duration arrival = 0s) {
  return {Kind::kReceived, at(time), at(arrival), std::move(bytes)};
}
WireEvent failed(Clock::Duration time, WireCall call, Fault fault) {
  return {Kind::kFailed, at(time), {}, failure_text(call, InstrumentError("port", fault, "as it was"))};
}
const WireEvent kOpened{Kind::kOpened, at(0s), {}, "/dev/ttyUSB0"};

class ReplayStreamTest : public ::testing::Test {
 protected:
  ReplayStreamTest() { EXPECT_EQ(clock_.now(), at(1s)); }
  ReplayStream replay(std::vector<WireEvent> events) { return {std::move(events), clock_}; }

  test::FakeClock clock_;
};

TEST_F(ReplayStreamTest, GivesTheRecordedAnswersAtTheRecordedTimes) {
  ReplayStream stream = replay({kOpened, written(2s, "POS?\n"), received(2010ms, "1=", 2009ms),
                                received(2020ms, "5\n", 2019ms), written(3s, "POS?\n")});
  EXPECT_EQ(stream.name(), "/dev/ttyUSB0");
  stream.write("POS?\n");
  EXPECT_EQ(clock_.now(), at(2s));
  const ReceivedBytes first = stream.read_until(at(4s));
  EXPECT_EQ(first.bytes, "1=");
  EXPECT_EQ(first.arrival, at(2009ms));
  EXPECT_EQ(clock_.now(), at(2010ms));
  EXPECT_EQ(stream.read_until(at(4s)).bytes, "5\n");
  EXPECT_EQ(clock_.now(), at(2020ms));
}

TEST_F(ReplayStreamTest, NothingComesBeforeTheWriteThatPrecedesIt) {
  ReplayStream stream = replay({kOpened, written(2s, "POS?\n"), received(2010ms, "1=5\n")});
  EXPECT_EQ(stream.read_until(at(5s)).bytes, "");
  EXPECT_EQ(clock_.now(), at(5s));
  stream.write("POS?\n");
  EXPECT_EQ(clock_.now(), at(5s));  // The clock never goes back.
  EXPECT_EQ(stream.read_until(at(5s)).bytes, "1=5\n");
}

TEST_F(ReplayStreamTest, AReadThatCameBackWithNothingDoesSoAgain) {
  ReplayStream stream = replay({kOpened, received(2500us + 1s, ""), received(3s, "late")});
  EXPECT_EQ(stream.read_until(at(1002ms)).bytes, "");
  EXPECT_EQ(clock_.now(), at(2500us + 1s));  // It had overslept.
  EXPECT_EQ(stream.read_until(at(4s)).bytes, "late");
}

TEST_F(ReplayStreamTest, AnEmptyReadNeverComesBackBeforeItsDeadline) {
  ReplayStream stream = replay({kOpened, received(2s, "")});
  EXPECT_EQ(stream.read_until(at(3s)).bytes, "");
  EXPECT_EQ(clock_.now(), at(3s));
}

TEST_F(ReplayStreamTest, AWriteThatIsNotTheRecordedOneIsRefusedWithBoth) {
  ReplayStream stream = replay({kOpened, written(2s, "MOV 1 30\n"), received(3s, "ok")});
  const InstrumentError error = error_of([&] { stream.write("MOV 1 \x18\n"); });
  EXPECT_EQ(error.fault(), Fault::kLinkLost);
  EXPECT_EQ(error.instrument(), "/dev/ttyUSB0");
  EXPECT_THAT(error.detail(), AllOf(HasSubstr("leaves the recording"), HasSubstr(R"("MOV 1 \x18\n")"),
                                    HasSubstr(R"("MOV 1 30\n")"), HasSubstr("t = 2.000000 s")));
  EXPECT_EQ(clock_.now(), at(1s));
  stream.write("MOV 1 30\n");  // It is still the next command.
}

TEST_F(ReplayStreamTest, FailuresComeAgainFromTheCallThatFailed) {
  ReplayStream stream = replay({kOpened, written(2s, "a"), failed(4s, WireCall::kWrite, Fault::kNoReply),
                                written(5s, "b"), failed(6s, WireCall::kRead, Fault::kLinkLost),
                                failed(7s, WireCall::kDiscard, Fault::kLinkLost)});
  const InstrumentError of_write = error_of([&] { stream.write("a"); });
  EXPECT_STREQ(of_write.what(), "port: no reply: as it was");
  EXPECT_EQ(clock_.now(), at(4s));
  stream.write("b");
  EXPECT_EQ(clock_.now(), at(5s));
  EXPECT_EQ(error_of([&] { stream.read_until(at(9s)); }).fault(), Fault::kLinkLost);
  EXPECT_EQ(clock_.now(), at(6s));
  EXPECT_EQ(error_of([&] { stream.discard_input(); }).detail(), "as it was");
}

TEST_F(ReplayStreamTest, TheEndSaysSo) {
  ReplayStream stream = replay({kOpened, written(2s, "a")});
  stream.write("a");
  stream.discard_input();
  for (int k = 0; k < 2; ++k) {
    const InstrumentError error = error_of([&] { stream.read_until(at(9s)); });
    EXPECT_EQ(error.fault(), Fault::kLinkLost);
    EXPECT_THAT(error.detail(), HasSubstr("the recording ends here, at t = 2.000000 s"));
  }
  EXPECT_THAT(error_of([&] { stream.write("b"); }).detail(), HasSubstr("the recording ends here"));
  ReplayStream nothing = replay({});
  EXPECT_THAT(error_of([&] { nothing.write("b"); }).detail(), HasSubstr("the recording ends here"));
}

TEST_F(ReplayStreamTest, WhatWasDiscardedIsDiscardedAndNothingElse) {
  const WireEvent discarded{Kind::kDiscarded, at(2s), {}, "stale"};
  ReplayStream stream = replay({kOpened, discarded, received(3s, "fresh")});
  stream.discard_input();
  EXPECT_EQ(clock_.now(), at(2s));
  stream.discard_input();
  EXPECT_EQ(stream.read_until(at(4s)).bytes, "fresh");
}

TEST_F(ReplayStreamTest, ADriverThatLooksAtOtherMomentsGetsTheBytesAllTheSame) {
  const WireEvent discarded{Kind::kDiscarded, at(2s), {}, "stale"};
  ReplayStream reads = replay({kOpened, discarded, written(3s, "q")});
  EXPECT_EQ(reads.read_until(at(2s)).bytes, "stale");  // Thrown away then, read now.
  ReplayStream writes =
      replay({kOpened, received(2s, "a", 1s), received(3s, "b", 3s), written(4s, "q"), received(5s, "c")});
  writes.write("q");  // Read before the write then, after it now.
  const ReceivedBytes both = writes.read_until(at(9s));
  EXPECT_EQ(both.bytes, "ab");
  EXPECT_EQ(both.arrival, at(3s));
  EXPECT_EQ(writes.read_until(at(9s)).bytes, "c");
}

TEST_F(ReplayStreamTest, DroppedBytesGrowWhereTheyDid) {
  const WireEvent dropped{Kind::kDropped, at(2s), {}, "12"};
  ReplayStream stream = replay({kOpened, received(2s, "a"), dropped, received(3s, "b")});
  EXPECT_EQ(stream.dropped_bytes(), 0U);
  stream.read_until(at(4s));
  EXPECT_EQ(stream.dropped_bytes(), 12U);
  EXPECT_EQ(stream.read_until(at(4s)).bytes, "b");
}

/// The recording of a replay equals the original, except for times between two calls.
TEST_F(ReplayStreamTest, ARecordedReplayIsTheRecording) {
  const std::vector<WireEvent> events{{Kind::kOpened, at(1s), {}, "/dev/ttyUSB0"},
                                      written(1s, "go"),
                                      received(2100ms, "x", 2099ms),
                                      received(2200ms, "", 2200ms),
                                      {Kind::kDropped, at(2200ms), {}, "3"},
                                      written(2200ms, "stop"),
                                      failed(4s, WireCall::kWrite, Fault::kNoReply),
                                      failed(5s, WireCall::kRead, Fault::kLinkLost)};
  std::vector<WireEvent> again;
  RecordingStream stream(std::make_unique<ReplayStream>(events, clock_), clock_,
                         [&](WireEvent&& event) { again.push_back(std::move(event)); });
  stream.write("go");
  EXPECT_EQ(stream.read_until(at(9s)).bytes, "x");
  EXPECT_EQ(stream.read_until(at(2200ms)).bytes, "");
  EXPECT_EQ(stream.dropped_bytes(), 3U);
  EXPECT_THROW(stream.write("stop"), InstrumentError);
  EXPECT_THROW(stream.read_until(at(9s)), InstrumentError);
  EXPECT_EQ(again, events);
}

}  // namespace
}  // namespace abcal::wire
