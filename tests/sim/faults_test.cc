#include "sim/faults.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "drivers/instrument/instrument_error.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/sim_clock.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::EndsWith;
using testing::HasSubstr;

class FaultyStreamTest : public testing::Test {
 protected:
  FaultyStream& with(WireFault fault) {
    stream->add(std::move(fault));
    return *stream;
  }
  /// All that comes within a second of a query.
  std::string ask(const std::string& query) {
    stream->write(query + "\n");
    return listen(seconds(1));
  }
  std::string listen(Clock::Duration duration) {
    const Clock::Instant deadline = clock.now() + duration;
    std::string bytes;
    pieces = 0;
    for (;;) {
      const wire::ReceivedBytes received = stream->read_until(deadline);
      if (received.bytes.empty()) {
        EXPECT_EQ(clock.now(), deadline);
        return bytes;
      }
      EXPECT_LE(received.arrival, clock.now());
      bytes += received.bytes;
      ++pieces;
    }
  }

  SimClock clock;
  std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(BenchTruth{}, clock.now());
  std::unique_ptr<FaultyStream> stream = std::make_unique<FaultyStream>(
      std::make_unique<FirmwareStream>(std::make_shared<PiGcsFirmware>(bench), clock, "simulated"), clock,
      std::vector<WireFault>{});
  int pieces = 0;
};

TEST_F(FaultyStreamTest, WithoutFaultsItIsTheStreamItself) {
  EXPECT_EQ(ask("POS?"), "1=0.000000 \n2=0.000000\n");
  EXPECT_EQ(stream->name(), "simulated");
  EXPECT_EQ(stream->writes(), 1U);
}

TEST_F(FaultyStreamTest, SilenceBeginsAtItsWriteAndEndsAfterSoMany) {
  with({.kind = FaultKind::kSilence, .at_write = 2, .for_writes = 2});
  EXPECT_EQ(ask("CSV?"), "2.0\n");
  EXPECT_EQ(ask("CSV?"), "");
  EXPECT_EQ(ask("CSV?"), "");
  EXPECT_EQ(ask("CSV?"), "2.0\n");
}

TEST_F(FaultyStreamTest, SilenceMayBeginAtATime) {
  with({.kind = FaultKind::kSilence, .at = clock.now() + seconds(5)});
  EXPECT_EQ(ask("CSV?"), "2.0\n");
  clock.sleep_until(clock.now() + seconds(5));
  EXPECT_EQ(ask("CSV?"), "");
}

TEST_F(FaultyStreamTest, GarbageComesBeforeTheReplyAndRepeatsWithTheSeed) {
  with({.kind = FaultKind::kGarbage});
  const std::string first = ask("CSV?");
  EXPECT_GT(first.size(), 4U);
  EXPECT_LE(first.size(), 20U);
  EXPECT_THAT(first, EndsWith("2.0\n"));
  FaultyStream again(
      std::make_unique<FirmwareStream>(std::make_shared<PiGcsFirmware>(bench), clock, "simulated"), clock,
      {{.kind = FaultKind::kGarbage}});
  again.write("CSV?\n");
  EXPECT_EQ(again.read_until(clock.now() + seconds(1)).bytes, first);
}

TEST_F(FaultyStreamTest, ABitIsFlippedAndAByteIsDropped) {
  with({.kind = FaultKind::kFlippedBits, .at_write = 1, .for_writes = 1});
  with({.kind = FaultKind::kDroppedBytes, .at_write = 2, .for_writes = 1});
  const std::string flipped = ask("CSV?");
  ASSERT_EQ(flipped.size(), 4U);
  int bits = 0;
  for (std::size_t n = 0; n < 4; ++n)
    bits +=
        __builtin_popcount(static_cast<unsigned char>(flipped[n]) ^ static_cast<unsigned char>("2.0\n"[n]));
  EXPECT_EQ(bits, 1);
  EXPECT_EQ(ask("CSV?").size(), 3U);
  EXPECT_EQ(ask("CSV?"), "2.0\n");
}

TEST_F(FaultyStreamTest, ASplitFrameComesByteByByte) {
  with({.kind = FaultKind::kSplitFrame});
  EXPECT_EQ(ask("CSV?"), "2.0\n");
  EXPECT_EQ(pieces, 4);
}

TEST_F(FaultyStreamTest, ALateReplyComesAfterTheNextQueryWasSent) {
  with({.kind = FaultKind::kLateReply, .at_write = 1, .for_writes = 1, .delay = milliseconds(1500)});
  EXPECT_EQ(ask("CSV?"), "");
  EXPECT_EQ(ask("SAI?"), "2.0\n1 \n2\n");  // in order, and not the answer to this one
}

TEST_F(FaultyStreamTest, AReplyIsReplacedByARefusal) {
  with({.kind = FaultKind::kReplacedReply, .at_write = 2, .for_writes = 1, .text = "7\n"});
  EXPECT_EQ(ask("ERR?"), "0\n");
  EXPECT_EQ(ask("ERR?"), "7\n");
  EXPECT_EQ(ask("ERR?"), "0\n");
}

TEST_F(FaultyStreamTest, AnUnpluggedPortThrowsFromEveryCall) {
  with({.kind = FaultKind::kUnplug, .at = clock.now() + seconds(2)});
  EXPECT_EQ(ask("CSV?"), "2.0\n");
  try {
    stream->read_until(clock.now() + seconds(60));
    FAIL() << "still plugged in";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kLinkLost);
  }
  EXPECT_EQ(clock.now(), Clock::Instant(seconds(2)));  // at once, not at the deadline
  EXPECT_THROW(stream->write("CSV?\n"), InstrumentError);
  EXPECT_THROW(stream->read_until(clock.now()), InstrumentError);
  EXPECT_THROW(stream->discard_input(), InstrumentError);
}

TEST_F(FaultyStreamTest, DiscardingForgetsWhatHasComeOnly) {
  with({.kind = FaultKind::kLateReply, .at_write = 1, .for_writes = 1, .delay = milliseconds(1500)});
  EXPECT_EQ(ask("CSV?"), "");
  stream->discard_input();
  EXPECT_EQ(listen(seconds(1)), "2.0\n");
}

TEST(FaultsTest, EveryFaultHasAnOwnNameByWhichItIsFound) {
  EXPECT_EQ(fault_descriptions().size(), 22U);
  for (const FaultDescription& description : fault_descriptions()) {
    EXPECT_EQ(fault_description(description.name).kind, description.kind);
    EXPECT_FALSE(description.what.empty());
  }
  try {
    fault_description("earthquake");
    FAIL() << "known";
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), HasSubstr("earthquake"));
    EXPECT_THAT(error.what(), HasSubstr("stalled-axis"));
  }
}

TEST_F(FaultyStreamTest, RefusesAFaultOfTheWorld) {
  EXPECT_THROW(with({.kind = FaultKind::kStalledAxis}), std::invalid_argument);
}

TEST_F(FaultyStreamTest, APowerCycleIsALostLinkAndTellsTheInstrument) {
  std::vector<std::pair<bool, Clock::Instant>> told;
  with({.kind = FaultKind::kPowerCycle, .at = clock.now() + seconds(2), .until = clock.now() + seconds(5)});
  stream->on_power([&](bool on) { told.emplace_back(on, clock.now()); });
  const Clock::Instant begin = clock.now();
  EXPECT_THROW(stream->read_until(begin + seconds(10)), InstrumentError);
  EXPECT_EQ(clock.now(), begin + seconds(2));
  EXPECT_EQ(stream->next_change(), begin + seconds(5));
  EXPECT_THROW(stream->write("x"), InstrumentError);
  clock.sleep_until(begin + seconds(5));
  stream->read_until(begin + seconds(6));
  ASSERT_EQ(told.size(), 2U);
  EXPECT_EQ(told[0], std::pair(false, begin + seconds(2)));
  EXPECT_EQ(told[1], std::pair(true, begin + seconds(5)));
}

TEST_F(FaultyStreamTest, APowerCycleThatNobodySawIsOneAllTheSame) {
  std::vector<bool> told;
  with({.kind = FaultKind::kPowerCycle, .at = clock.now() + seconds(2), .until = clock.now() + seconds(5)});
  stream->on_power([&](bool on) { told.push_back(on); });
  stream->write("x");
  EXPECT_TRUE(told.empty());
  clock.sleep_until(clock.now() + seconds(7));
  stream->write("x");
  stream->write("x");
  EXPECT_EQ(told, (std::vector{false, true}));
}

}  // namespace
}  // namespace abcal::sim
