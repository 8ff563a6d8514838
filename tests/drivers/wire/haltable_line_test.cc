#include "drivers/wire/haltable_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <memory>
#include <string>

#include "tests/support/fake_clock.h"
#include "tests/support/scripted_line.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;

/// A frame ends with '.'; a '!' is none.
FrameVerdict check(std::string_view bytes) {
  if (bytes.find('!') != std::string_view::npos) return {FrameCheck::kInvalid, 0};
  const std::size_t end = bytes.find('.');
  if (end == std::string_view::npos) return {FrameCheck::kNeedMore, 0};
  return {FrameCheck::kComplete, end + 1};
}

class HaltableLineTest : public testing::Test {
 protected:
  HaltableLineTest() {
    auto stream = std::make_unique<test::ScriptedLine>(clock_, ';', [](const std::string& command) {
      return command == "stop" ? std::string() : command + ".";
    });
    far_end_ = stream.get();
    line_ = std::make_unique<HaltableLine>("stage", std::move(stream), clock_, check,
                                           HaltableLine::Halting{"stop;", 5s, 2s, 100ms});
  }
  std::optional<std::string> ask(const std::string& query) {
    line_->send(query + ";");
    return line_->take_frame(line_->deadline_after(1s));
  }

  test::FakeClock clock_;
  test::ScriptedLine* far_end_;
  std::unique_ptr<HaltableLine> line_;
};

TEST_F(HaltableLineTest, GivesFramesOneByOneAndKeepsWhatIsNotWhole) {
  const std::lock_guard lock(*line_);
  far_end_->say("a.b.cd", 1ms);
  const Clock::Instant deadline = line_->deadline_after(10ms);
  EXPECT_EQ(line_->take_frame(deadline), "a.");
  EXPECT_EQ(line_->take_frame(deadline), "b.");
  EXPECT_EQ(line_->take_frame(deadline), std::nullopt);
  EXPECT_EQ(clock_.now(), deadline);
  EXPECT_EQ(line_->received(), "cd");
  far_end_->say("e.", 1ms);
  EXPECT_EQ(line_->take_frame(line_->deadline_after(10ms)), "cde.");
  far_end_->say("f!.", 1ms);
  EXPECT_EQ(line_->take_frame(line_->deadline_after(10ms)), "f!.") << "no frame, given as it came";
  far_end_->say("g.h", 0ms);
  line_->take_frame(line_->deadline_after(10ms));
  line_->discard_input();
  EXPECT_EQ(line_->received(), "");
}

TEST_F(HaltableLineTest, NamesThePortUntilItIsRenamed) {
  EXPECT_STREQ(line_->failure(Fault::kNoReply, "x").what(), "stage on scripted: no reply: x");
  line_->rename("stage 7");
  EXPECT_STREQ(line_->failure(Fault::kNoReply, "x").what(), "stage 7: no reply: x");
}

TEST_F(HaltableLineTest, HaltStopsAsksAndStopsAgainUntilAllStandsStill) {
  int asked = 0;
  int forgotten = 0;
  EXPECT_TRUE(line_->halt(
      [&] {
        EXPECT_EQ(far_end_->count("stop"), 1U) << "the first stop waits for nothing";
        ++forgotten;
      },
      [&] {
        EXPECT_TRUE(line_->halting());
        EXPECT_EQ(ask("moving"), "moving.");
        return ++asked == 3;
      }));
  EXPECT_EQ(forgotten, 1);
  EXPECT_EQ(far_end_->count("stop"), 4U);
  EXPECT_FALSE(line_->halting());
  const std::lock_guard lock(*line_);
  EXPECT_EQ(ask("next"), "next.") << "then it is the owner's again";
}

TEST_F(HaltableLineTest, HaltGivesUpAtItsDeadlineAndAtOnceWithoutALink) {
  const auto nothing = [] {};
  const Clock::Instant start = clock_.now();
  EXPECT_FALSE(line_->halt(nothing, [] { return false; }));
  EXPECT_EQ(clock_.now() - start, 5s);
  far_end_->silent = true;
  EXPECT_FALSE(line_->halt(nothing, [&]() -> bool {
    EXPECT_EQ(ask("moving"), std::nullopt);  // No wait goes beyond the deadline of the halt.
    throw line_->failure(Fault::kNoReply, "silent");
  }));
  EXPECT_EQ(clock_.now() - start, 10s);
  far_end_->unplugged = true;
  EXPECT_FALSE(line_->halt(nothing, [] { return true; }));
  EXPECT_EQ(clock_.now() - start, 10s);
}

TEST_F(HaltableLineTest, MeanwhileTheOwnerSendsNothing) {
  // The owner is held in its query until the stop is written; its next command is refused.
  far_end_->held_until = "query";
  far_end_->released_by = "stop";
  auto owner = std::async(std::launch::async, [&] {
    const std::lock_guard lock(*line_);
    EXPECT_EQ(ask("query"), "query.");
    Fault fault = Fault::kStalled;
    try {
      line_->send("move;");
    } catch (const InstrumentError& error) {
      fault = error.fault();
    }
    return fault;
  });
  far_end_->await_hold();
  EXPECT_TRUE(line_->halt([] {}, [] { return true; }));
  EXPECT_EQ(owner.get(), Fault::kNotReady);
  EXPECT_EQ(far_end_->count("move"), 0U);
}

}  // namespace
}  // namespace abcal::wire
