#include "sim/axis_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

const Clock::Instant kStart{seconds(10)};
const MotionLimits kLimits{
    .speed_deg_per_s = 20.0, .acceleration_deg_per_s2 = 40.0, .deceleration_deg_per_s2 = 40.0};

TEST(AxisMotionTest, ALongMoveAcceleratesCruisesAndDecelerates) {
  const AxisMotion motion = AxisMotion::move(kStart, Angle::degrees(0), 0.0, Angle::degrees(90), kLimits);
  // 0.5 s up (5 degrees), 0.5 s down (5 degrees), 80 degrees at 20 degrees/s.
  EXPECT_EQ(motion.end() - kStart, seconds(5));
  EXPECT_EQ(motion.position(kStart).deg(), 0.0);
  // Round-off of a polynomial of degree 2 at values up to 90.
  EXPECT_NEAR(motion.position(kStart + milliseconds(250)).deg(), 1.25, 1e-13);
  EXPECT_NEAR(motion.velocity_deg_per_s(kStart + milliseconds(250)), 10.0, 1e-13);
  EXPECT_NEAR(motion.position(kStart + milliseconds(2500)).deg(), 45.0, 1e-13);
  EXPECT_NEAR(motion.velocity_deg_per_s(kStart + milliseconds(2500)), 20.0, 1e-13);
  EXPECT_NEAR(motion.position(kStart + milliseconds(4750)).deg(), 88.75, 1e-13);
  EXPECT_TRUE(motion.moving(motion.end() - Clock::Duration(1)));
  EXPECT_FALSE(motion.moving(motion.end()));
  EXPECT_EQ(motion.position(motion.end()).deg(), 90.0);
  EXPECT_EQ(motion.position(motion.end() + seconds(100)).deg(), 90.0);
  EXPECT_EQ(motion.direction(), 1);
  EXPECT_EQ(motion.peak_speed_deg_per_s(), 20.0);
}

TEST(AxisMotionTest, AShortMoveNeverReachesTheSpeed) {
  const AxisMotion motion = AxisMotion::move(kStart, Angle::degrees(5), 0.0, Angle::degrees(4), kLimits);
  // sqrt(d a) = 6.32 degrees/s; 2 sqrt(d / a) = 0.316 s.
  EXPECT_NEAR(motion.peak_speed_deg_per_s(), std::sqrt(40.0), 1e-12);
  EXPECT_NEAR(to_seconds(motion.end() - kStart), 2.0 * std::sqrt(1.0 / 40.0), 1e-9);  // a nanosecond
  EXPECT_EQ(motion.direction(), -1);
}

TEST(AxisMotionTest, PositionAndVelocityNeverJump) {
  // Also from a start in motion: the wrong way, too fast, and past the point of no return.
  for (const double velocity : {0.0, 15.0, -15.0, 30.0, -30.0}) {
    for (const double target : {0.0, 1.0, -1.0, 60.0, -60.0}) {
      const AxisMotion motion =
          AxisMotion::move(kStart, Angle::degrees(0), velocity, Angle::degrees(target), kLimits);
      const Clock::Duration step = milliseconds(1);
      double position = 0.0;
      double speed = velocity;
      for (Clock::Instant t = kStart; t <= motion.end() + step; t += step) {
        const double p = motion.position(t).deg();
        const double v = motion.velocity_deg_per_s(t);
        ASSERT_LE(std::abs(p - position), 30.0 * 1e-3 + 1e-9) << velocity << " to " << target;
        ASSERT_LE(std::abs(v - speed), 40.0 * 1e-3 + 1e-6) << velocity << " to " << target;
        position = p;
        speed = v;
      }
      EXPECT_EQ(position, target);
      EXPECT_EQ(speed, 0.0);
    }
  }
}

TEST(AxisMotionTest, AHaltDeceleratesInTheWayLeftToIt) {
  const AxisMotion motion = AxisMotion::halt(kStart, Angle::degrees(30), -20.0, kLimits);
  EXPECT_EQ(motion.end() - kStart, milliseconds(500));
  EXPECT_EQ(motion.target().deg(), 25.0);  // v^2 / 2a
}

TEST(AxisMotionTest, AMoveToWhereItIsEndsAtOnce) {
  const AxisMotion motion = AxisMotion::move(kStart, Angle::degrees(7), 0.0, Angle::degrees(7), kLimits);
  EXPECT_FALSE(motion.moving(kStart));
  EXPECT_EQ(motion.direction(), 0);
}

TEST(AxisMotionTest, AStalledMotionStaysAndIsNeverDone) {
  AxisMotion motion = AxisMotion::move(kStart, Angle::degrees(0), 0.0, Angle::degrees(90), kLimits);
  motion.stall_at(kStart + seconds(2));
  const double stuck = motion.position(kStart + seconds(2)).deg();
  EXPECT_NEAR(stuck, 35.0, 1e-12);
  EXPECT_EQ(motion.position(kStart + seconds(3600)).deg(), stuck);
  EXPECT_TRUE(motion.moving(kStart + seconds(3600)));
  EXPECT_EQ(motion.velocity_deg_per_s(kStart + seconds(3)), 0.0);
}

TEST(AxisMotionTest, RefusesWhatCannotBe) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(AxisMotion::move(kStart, {}, 0.0, Angle::degrees(nan), kLimits), std::invalid_argument);
  EXPECT_THROW(AxisMotion::move(kStart, {}, 0.0, Angle::degrees(1), {.speed_deg_per_s = 0.0}),
               std::invalid_argument);
  EXPECT_THROW(AxisMotion::move(kStart, {}, 0.0, Angle::degrees(1), {.acceleration_deg_per_s2 = nan}),
               std::invalid_argument);
}

}  // namespace
}  // namespace abcal::sim
