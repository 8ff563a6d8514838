// A stream that never pauses holds no driver beyond its patience: every driver of the registry, and what
// they share.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/registry.h"
#include "drivers/wire/haltable_line.h"
#include "drivers/wire/query_exchange.h"
#include "drivers/wire/reading_stream.h"
#include "tests/drivers/endless_stream.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::EndlessStream;

/// Some are whole lines or messages of another protocol, some have no end.
std::vector<std::string> babbles() {
  return {"x",           "garbage",           std::string(1024, 'x'),      std::string(64, '\0'), "other\r\n",
          "other\n\r\n", "!01 1 IDLE --\r\n", "@01 1 07 OK IDLE -- 0\r\n", "\x01\x02garbage"};
}

std::vector<std::unique_ptr<wire::ByteStream>> endless(std::size_t count, test::FakeClock& clock,
                                                       const std::string& bytes) {
  std::vector<std::unique_ptr<wire::ByteStream>> streams;
  for (std::size_t n = 0; n < count; ++n) streams.push_back(std::make_unique<EndlessStream>(clock, bytes));
  return streams;
}

/// `identify` ends with an error of its own, not with that of the stream.
template <class Call>
void expect_an_end(const std::string& driver, const std::string& bytes, const Call& identify) {
  SCOPED_TRACE(driver + ", " + bytes.substr(0, 24));
  try {
    identify();
    ADD_FAILURE() << "it takes this for its instrument";
  } catch (const InstrumentError& error) {
    EXPECT_NE(error.fault(), Fault::kLinkLost) << error.what();
    EXPECT_LT(std::string_view(error.what()).size(), 100'000U) << "all that came is in the message";
  }
}

TEST(EndlessBytesTest, HoldNoStage) {
  for (const StageDriver& driver : stage_drivers()) {
    if (driver.connections == 0) continue;
    for (const std::string& bytes : babbles()) {
      test::FakeClock clock;
      const auto stage = driver.make(endless(driver.connections, clock, bytes), clock, StageSettings{});
      expect_an_end(driver.name, bytes, [&] { stage->identify(); });
      const Clock::Instant before = clock.now();
      EXPECT_FALSE(stage->halt()) << driver.name;
      EXPECT_LT(clock.now() - before, 60s) << driver.name;
    }
  }
}

TEST(EndlessBytesTest, HoldNoAccelerometer) {
  AccelerometerSettings settings;
  settings.rate_hz = 5.0;  // A rate that a voltmeter can keep.
  for (const AccelerometerDriver& driver : accelerometer_drivers()) {
    if (driver.ports == 0) continue;
    for (const std::string& bytes : babbles()) {
      test::FakeClock clock;
      const auto accelerometer = driver.make(endless(driver.ports, clock, bytes), clock, settings);
      expect_an_end(driver.name, bytes, [&] { accelerometer->identify(); });
    }
  }
}

TEST(EndlessBytesTest, HoldNoChamber) {
  for (const ChamberDriver& driver : chamber_drivers()) {
    for (const std::string& bytes : babbles()) {
      test::FakeClock clock;
      const auto chamber = driver.make(endless(1, clock, bytes), clock, ChamberSettings{});
      expect_an_end(driver.name, bytes, [&] { chamber->identify(); });
    }
  }
}

// ---- What drivers share

/// A frame ends with '.'.
wire::FrameVerdict check(std::string_view bytes) {
  const std::size_t end = bytes.find('.');
  if (end == std::string_view::npos) return {wire::FrameCheck::kNeedMore, 0};
  return {wire::FrameCheck::kComplete, end + 1};
}

TEST(EndlessBytesTest, ALoopOverTheFramesOfALineEnds) {
  test::FakeClock clock;
  wire::HaltableLine line("stage", std::make_unique<EndlessStream>(clock, "a.b."), clock, check,
                          {"stop;", 5s, 2s, 100ms});
  const std::lock_guard lock(line);
  for (int attempt = 0; attempt < 2; ++attempt) {
    line.send("?");
    const Clock::Instant deadline = line.deadline_after(100ms);
    int frames = 0;
    while (line.take_frame(deadline)) ++frames;
    EXPECT_GE(frames, 200) << "until the deadline all are given";
    EXPECT_LE(clock.now(), deadline + 1ms) << "one look more";
    EXPECT_EQ(line.received(), "");
  }
}

TEST(EndlessBytesTest, AQuestionEndsAtItsPatience) {
  for (const char* bytes : {"x", "x."}) {
    test::FakeClock clock;
    wire::QueryExchange exchange(std::make_unique<EndlessStream>(clock, bytes), clock,
                                 {.who = "chamber",
                                  .patience = 1s,
                                  .check = check,
                                  .sync_request = "?",
                                  .is_sync = [](const std::string&) { return false; }});
    const Clock::Instant before = clock.now();
    const auto parse = [](const std::string&) -> std::optional<int> { return std::nullopt; };
    EXPECT_THROW(exchange.ask("!", "!", parse), InstrumentError) << bytes;
    EXPECT_LE(clock.now() - before, 3100ms) << bytes;
  }
}

/// Finds no frame in anything.
struct DeafParser {
  struct Frame {
    std::size_t size = 0;
  };
  void feed(std::string_view bytes) { skipped += bytes.size(); }
  std::optional<Frame> next() const { return std::nullopt; }
  bool has_partial() const { return false; }
  std::uint64_t bad_frames() const { return 0; }
  std::uint64_t skipped_bytes() const { return skipped; }
  std::uint64_t skipped = 0;
};

TEST(EndlessBytesTest, AReadingIsWaitedForUntilTheDeadline) {
  test::FakeClock clock;
  EndlessStream stream(clock, "garbage");
  wire::ReadingStream<DeafParser> readings(stream, DeafParser(),
                                           [](const DeafParser::Frame&) { return wire::DecodedFrame{}; });
  readings.start();
  const Clock::Instant deadline = clock.now() + 100ms;
  EXPECT_FALSE(readings.next(deadline));
  EXPECT_EQ(clock.now(), deadline + 1ms);
  readings.discard_pending(clock.now());
  EXPECT_LE(clock.now(), deadline + 3ms);
}

}  // namespace
}  // namespace abcal
