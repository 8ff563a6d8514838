#include "app/measure/bench/stage_watchdog.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <future>

#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

const Clock::Instant kStart{};

TEST(MotionWatch, IsOverdueOnlyWhileItMayMoveAndNothingIsHeard) {
  MotionWatch watch(5s);
  EXPECT_FALSE(watch.overdue(kStart + 1h));  // No motion was commanded.
  watch.told_to_move(StageAxis::kX, kStart);
  EXPECT_FALSE(watch.overdue(kStart + 5s));
  EXPECT_TRUE(watch.overdue(kStart + 5001ms));
  watch.heard(kStart + 4s);
  EXPECT_FALSE(watch.overdue(kStart + 9s));
  watch.told_to_move(StageAxis::kZ, kStart + 9s);
  watch.stands_still(StageAxis::kX);
  EXPECT_TRUE(watch.overdue(kStart + 15s));  // Z may still move.
  watch.stands_still(StageAxis::kZ);
  EXPECT_FALSE(watch.overdue(kStart + 1h));
  watch.told_to_move(StageAxis::kX, kStart + 2h);
  watch.forget();
  EXPECT_FALSE(watch.overdue(kStart + 3h));
}

/// After a freeze of the whole program the guard's halt is the first cause, and the controller is not to
/// blame.
TEST(MotionWatch, AFreezeOfThisProgramIsNoSilenceOfTheController) {
  MotionWatch watch(5s);
  const auto look = [&](Clock::Duration at) {
    watch.look(kStart + at);
    return watch.overdue(kStart + at);
  };
  watch.told_to_move(StageAxis::kX, kStart);
  EXPECT_FALSE(look(500ms));
  EXPECT_FALSE(look(10s)) << "nobody could hear an answer";
  Clock::Duration at = 10s;
  while (!look(at) && at < 1min) at += 500ms;
  EXPECT_EQ(at, 15500ms) << "from then on silence counts";
}

/// Reports a halt to the test.
class HaltedStage final : public RotationStage {
 public:
  StageInfo identify() override { return {}; }
  void home(StageAxis) override {}
  void move_to(StageAxis, Angle) override {}
  MotionState motion_state(StageAxis) override { return MotionState::kMoving; }
  Angle encoder_angle(StageAxis) override { return {}; }
  bool halt() noexcept override {
    const std::lock_guard lock(mutex);
    ++halts;
    changed.notify_all();
    return acknowledges;
  }
  Clock::Duration reply_deadline() const override { return reply; }
  bool wait_for_halt() {
    std::unique_lock lock(mutex);
    return changed.wait_for(lock, 30s, [&] { return halts > 0; });
  }
  std::mutex mutex;
  std::condition_variable changed;
  int halts = 0;
  bool acknowledges = true;
  Clock::Duration reply{};
};

class StageWatchdogTest : public testing::Test {
 protected:
  StageWatchdogTest() {
    auto owned = std::make_unique<HaltedStage>();
    stage = owned.get();
    dog = std::make_unique<StageWatchdog>(std::move(owned), clock, 50ms);
  }
  /// Error of the next call of the run; calls until the watchdog has noted its halt.
  std::string next_error() {
    for (;;) {
      try {
        dog->encoder_angle(StageAxis::kX);
      } catch (const InstrumentError& error) {
        EXPECT_EQ(error.fault(), Fault::kStalled);
        return error.what();
      }
    }
  }
  RealClock clock;
  HaltedStage* stage = nullptr;
  std::unique_ptr<StageWatchdog> dog;
};

TEST_F(StageWatchdogTest, HaltsAStageThatNobodyHearsOfAndTheRunIsTold) {
  dog->move_to(StageAxis::kX, Angle::degrees(30));
  ASSERT_TRUE(stage->wait_for_halt());  // The measuring thread hangs here.
  EXPECT_THAT(next_error(), HasSubstr("the watchdog halted the stage"));
  EXPECT_THROW(dog->move_to(StageAxis::kZ, {}), InstrumentError);
  dog->identify();  // A new beginning.
  EXPECT_NO_THROW(dog->encoder_angle(StageAxis::kX));
  EXPECT_EQ(stage->halts, 1);
}

TEST_F(StageWatchdogTest, EachHaltIsAnEvent) {
  EXPECT_TRUE(dog->take_events().empty());
  dog->move_to(StageAxis::kX, Angle::degrees(30));
  ASSERT_TRUE(stage->wait_for_halt());
  next_error();
  const std::vector<StageEvent> events = dog->take_events();
  ASSERT_EQ(events.size(), 1U);
  EXPECT_EQ(events[0].kind, "watchdog halt");
  EXPECT_THAT(events[0].text, HasSubstr("had not answered for 0.05 s"));
  EXPECT_TRUE(dog->take_events().empty());
}

TEST(StageWatchdog, IsNeverLessPatientThanAReplyMayTake) {
  RealClock clock;
  for (const auto& [reply, patience] : {std::pair(0s, 5s), std::pair(2s, 5s), std::pair(6s, 7s)}) {
    auto stage = std::make_unique<HaltedStage>();
    stage->reply = reply;
    EXPECT_EQ(StageWatchdog(std::move(stage), clock).patience(), patience);
  }
}

/// Its exchange under way fails because of the halt, as a driver's does.
class InterruptedStage final : public RotationStage {
 public:
  StageInfo identify() override { return {}; }
  void home(StageAxis) override {}
  void move_to(StageAxis, Angle) override {}
  MotionState motion_state(StageAxis) override {
    halted_.get_future().wait();
    throw InstrumentError("stage", Fault::kNotReady, "the stage is being halted");
  }
  Angle encoder_angle(StageAxis) override { return {}; }
  bool halt() noexcept override {
    halted_.set_value();
    return true;
  }

 private:
  std::promise<void> halted_;
};

TEST(StageWatchdog, TheFirstCauseIsToldNotThatTheStageIsBeingHalted) {
  RealClock clock;
  StageWatchdog dog(std::make_unique<InterruptedStage>(), clock, 50ms);
  dog.move_to(StageAxis::kX, Angle::degrees(30));
  try {
    dog.motion_state(StageAxis::kX);
    FAIL() << "nothing was thrown";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kStalled);
    EXPECT_THAT(error.what(), HasSubstr("the watchdog halted the stage"));
  }
}

TEST_F(StageWatchdogTest, SaysIfTheHaltWasNotAcknowledged) {
  stage->acknowledges = false;
  dog->home(StageAxis::kZ);
  ASSERT_TRUE(stage->wait_for_halt());
  while (next_error().find("not acknowledged") == std::string::npos) continue;
}

}  // namespace
}  // namespace abcal
