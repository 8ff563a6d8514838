#include "protocol/run/motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "tests/protocol/run/run_parts_fixture.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Pair;

class MotionTest : public test::RunPartsTest {
 protected:
  Motion motion() { return Motion(context(), stage); }
  test::ScriptedStage::Axis& x() { return stage.axes[0]; }
};

TEST_F(MotionTest, ComesFromBelowWhereTheTargetIsLower) {
  x().encoder = Angle::degrees(50);
  Motion axes = motion();
  axes.move_to(StageAxis::kX, Angle::degrees(20));
  axes.move_to(StageAxis::kX, Angle::degrees(30));
  EXPECT_THAT(stage.moves,
              ElementsAre(Pair(StageAxis::kX, Angle::degrees(19)), Pair(StageAxis::kX, Angle::degrees(20)),
                          Pair(StageAxis::kX, Angle::degrees(30))));
}

// The window of the position belongs to the target: an axis may stand above it by as much.
TEST_F(MotionTest, ComesFromBelowUnlessTheTargetIsAboveTheAxisByTheWindow) {
  const Angle window = settings.protocol.position_window;
  x().encoder = Angle::degrees(20);
  motion().move_to(StageAxis::kX, x().encoder + window);
  EXPECT_EQ(stage.moves.size(), 1U);
  stage.moves.clear();
  x().encoder = Angle::degrees(20);
  const Angle just_below = Angle::degrees(20.0 + window.deg() - 1e-9);
  motion().move_to(StageAxis::kX, just_below);
  EXPECT_THAT(stage.moves, ElementsAre(Pair(StageAxis::kX, just_below - settings.protocol.approach),
                                       Pair(StageAxis::kX, just_below)));
}

TEST_F(MotionTest, WithoutAnApproachEachAngleIsReachedAtOnce) {
  settings.protocol.approach = Angle{};
  x().encoder = Angle::degrees(50);
  motion().move_to(StageAxis::kX, Angle::degrees(20));
  EXPECT_THAT(stage.moves, ElementsAre(Pair(StageAxis::kX, Angle::degrees(20))));
}

// Below the target it needs to be found once, and within half of the approach.
TEST_F(MotionTest, TheApproachItselfIsNotMeasured) {
  x().encoder = Angle::degrees(50);
  const Clock::Instant begin = clock.now();
  motion().move_to(StageAxis::kX, Angle::degrees(20));
  const int polls = 2 + settings.protocol.window_polls - 1;  // Each move is seen under way once.
  EXPECT_NEAR(to_seconds(clock.now() - begin), polls * settings.protocol.poll_interval_s, 1e-9);
  const auto failed_at = [&](double error_deg) {
    x() = {.encoder = Angle::degrees(50), .error = Angle::degrees(error_deg)};
    return failure_of([&] { motion().move_to(StageAxis::kX, Angle::degrees(20)); }).second;
  };
  EXPECT_THAT(failed_at(0.4999), HasSubstr("commanded 20.0"));
  EXPECT_THAT(failed_at(0.5001), HasSubstr("commanded 19.0"));
}

TEST_F(MotionTest, LeavesAnAxisWhereItStandsUntilItsPositionIsForgotten) {
  Motion axes = motion();
  EXPECT_TRUE(axes.move_to(StageAxis::kX, Angle::degrees(20)));
  EXPECT_FALSE(axes.move_to(StageAxis::kX, Angle::degrees(20)));
  const std::size_t moves = stage.moves.size();
  axes.forget_positions();
  EXPECT_TRUE(axes.move_to(StageAxis::kX, Angle::degrees(20)));
  EXPECT_GT(stage.moves.size(), moves);
}

TEST_F(MotionTest, TheArrivalIsWhenItWasFirstFoundInside) {
  settings.protocol.window_polls = 4;
  settings.protocol.poll_interval_s = 0.1;
  x().polls_until_stop = 3;
  const Clock::Instant begin = clock.now();
  const auto stopped = motion().move_to(StageAxis::kX, Angle::degrees(20));
  ASSERT_TRUE(stopped);
  EXPECT_NEAR(to_seconds(*stopped - begin), 0.3, 1e-9);
  EXPECT_NEAR(to_seconds(clock.now() - begin), 0.6, 1e-9) << "four polls in a row";
}

TEST_F(MotionTest, AnAxisOutsideTheWindowEndsItWithFoundAndRequired) {
  x().error = Angle::degrees(0.05);
  const Clock::Instant begin = clock.now();
  const auto [fault, words] = failure_of([&] { motion().move_to(StageAxis::kX, Angle::degrees(20)); });
  EXPECT_EQ(fault, Fault::kStalled);
  EXPECT_THAT(words, AllOf(HasSubstr("axis X stopped at 20.05"), HasSubstr("commanded 20.0"),
                           HasSubstr("required: within 0.01 deg")));
  // Found stopped by the second poll, and a poll after more than a second later.
  EXPECT_NEAR(to_seconds(clock.now() - begin), 0.01 + 1.01, 1e-9);
}

TEST_F(MotionTest, WholeTurnsBetweenCommandAndEncoderAreCalledSo) {
  settings.protocol.approach = Angle{};
  for (const double turns : {360.0, -720.0}) {
    x().error = Angle::degrees(turns + 0.005);
    const auto [fault, words] = failure_of([&] { motion().move_to(StageAxis::kX, Angle::degrees(20)); });
    EXPECT_EQ(fault, Fault::kStalled);
    EXPECT_THAT(words, AllOf(HasSubstr("commanded 20.0"), HasSubstr("whole turns"),
                             HasSubstr("wraps_deg = 360 under [stage.x]")));
    EXPECT_THAT(words, testing::Not(HasSubstr("missed step")));
  }
  x().error = Angle::degrees(360.05);
  EXPECT_THAT(failure_of([&] { motion().move_to(StageAxis::kX, Angle::degrees(20)); }).second,
              HasSubstr("missed step"));
}

TEST_F(MotionTest, ALongMoveIsMadeInPartsIfTheStageAsksForIt) {
  settings.protocol.approach = Angle{};
  context().stage_info.axes[0].longest_move = Angle::degrees(170);
  motion().move_to(StageAxis::kX, Angle::degrees(340));
  motion().move_to(StageAxis::kX, Angle::degrees(-5));
  EXPECT_THAT(stage.moves,
              ElementsAre(Pair(StageAxis::kX, Angle::degrees(170)), Pair(StageAxis::kX, Angle::degrees(340)),
                          Pair(StageAxis::kX, Angle::degrees(225)), Pair(StageAxis::kX, Angle::degrees(110)),
                          Pair(StageAxis::kX, Angle::degrees(-5))));
  const auto [fault, words] =
      failure_of([&] { motion().sweep(StageAxis::kX, Angle::degrees(300), 10.0, [] {}); });
  EXPECT_EQ(fault, Fault::kRefused);
  EXPECT_THAT(words, HasSubstr("modulo 360"));
}

TEST_F(MotionTest, AnEncoderThatIsNoNumberIsOutside) {
  x().error = Angle::degrees(std::numeric_limits<double>::quiet_NaN());
  EXPECT_EQ(failure_of([&] { motion().move_to(StageAxis::kX, Angle::degrees(20)); }).first, Fault::kStalled);
}

TEST_F(MotionTest, AnAxisThatNeverStopsEndsItAfterItsTime) {
  x().polls_until_stop = 1'000'000;
  settings.protocol.motion_timeout_s = 5.0;
  const Clock::Instant begin = clock.now();
  const auto [fault, words] = failure_of([&] { motion().move_to(StageAxis::kX, Angle::degrees(20)); });
  EXPECT_EQ(fault, Fault::kStalled);
  EXPECT_THAT(words, HasSubstr("still moving"));
  // 20 deg at 10 deg/s, and 5 s; the next poll is later.
  EXPECT_NEAR(to_seconds(clock.now() - begin), 7.01, 1e-9);
}

TEST_F(MotionTest, HomingEndsWhenTheReferenceIsFoundOrSaysThatItIsNot) {
  motion().home(StageAxis::kX);
  EXPECT_TRUE(context().stage_info.axes[0].referenced);
  stage.axes[1].finds_reference = false;
  const auto [fault, words] = failure_of([&] { motion().home(StageAxis::kZ); });
  EXPECT_EQ(fault, Fault::kNotReady);
  EXPECT_THAT(words, HasSubstr("axis Z stopped without finding its reference"));
  x().polls_until_stop = 1'000'000;
  settings.protocol.homing_timeout_s = 1.0;
  context().settings.protocol.homing_timeout_s = 1.0;
  EXPECT_EQ(failure_of([&] { motion().home(StageAxis::kX); }).first, Fault::kStalled);
}

TEST_F(MotionTest, AStopEndsTheWait) {
  x().polls_until_stop = 1'000'000;
  context();
  stop.request_stop();
  EXPECT_THROW(motion().move_to(StageAxis::kX, Angle::degrees(20)), RunInterrupted);
}

TEST_F(MotionTest, TheWindowHoldsForBothAxes) {
  PlannedAngle angle;
  angle.x = Angle::degrees(10);
  angle.z = Angle::degrees(20);
  Motion axes = motion();
  EXPECT_TRUE(axes.is_inside_window(angle, Angle::degrees(10.009), Angle::degrees(19.991)));
  EXPECT_FALSE(axes.is_inside_window(angle, Angle::degrees(10.011), Angle::degrees(20)));
  EXPECT_FALSE(axes.is_inside_window(angle, Angle::degrees(10), Angle::degrees(19.98)));
}

}  // namespace
}  // namespace abcal
