#include "protocol/plan/rotation_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

namespace abcal {
namespace {

Angle deg(double value) {
  return Angle::degrees(value);
}

constexpr std::array<AxisTravel, 2> kWide{};

/// The plan of the paper.
ProtocolConfig as_published() {
  ProtocolConfig config;
  config.check_poses = false;
  return config;
}

TEST(RotationPlanTest, DrivesTheThreeExperimentsOfThePaperWithTheirInitialTurns) {
  const auto plan = make_rotation_plan(as_published(), kWide);
  ASSERT_EQ(plan.size(), 3U * 73U);
  EXPECT_EQ(plan.front().x, deg(0));
  EXPECT_EQ(plan.front().z, deg(0));
  for (const PlannedAngle& angle : plan) {
    const Angle held = angle.experiment == 3 ? angle.x : angle.z;
    // X stands at 360 when experiment 2 ends: 270 is nearer than -90.
    EXPECT_EQ(held, angle.experiment == 1 ? deg(0) : angle.experiment == 2 ? deg(-90) : deg(270));
    const Angle turning = angle.experiment == 3 ? angle.z : angle.x;
    EXPECT_DOUBLE_EQ(std::remainder(turning.deg() - angle.alpha.deg(), 360.0), 0.0);
  }
}

TEST(RotationPlanTest, TwoFacesHaveHalfOfTheAnglesEachInterleavedAndOppositeToEachOther) {
  ProtocolConfig config = as_published();
  config.steps = 12;
  config.step = deg(30);
  config.faces = 2;
  const auto plan = make_rotation_plan(config, kWide);
  ASSERT_EQ(plan.size(), 6U * 7U);
  EXPECT_TRUE(has_two_faces(plan));
  EXPECT_FALSE(has_two_faces(make_rotation_plan(as_published(), kWide)));
  std::set<std::pair<int, double>> seen;
  for (std::size_t k = 0; k < plan.size(); ++k) {
    const PlannedAngle& angle = plan[k];
    EXPECT_EQ(angle.face, angle.n % 2 == 1 ? 1 : 2);
    EXPECT_EQ(angle.closing, k % 7 == 6);
    const Angle held = angle.experiment == 3 ? angle.x : angle.z;
    const double of_face_1 = angle.experiment == 1 ? 0.0 : -90.0;
    const double expected = angle.face == 1 ? of_face_1 : of_face_1 + 180.0;
    EXPECT_DOUBLE_EQ(std::remainder(held.deg() - expected, 360.0), 0.0) << k;
    const Angle turning = angle.experiment == 3 ? angle.z : angle.x;
    EXPECT_DOUBLE_EQ(std::remainder(turning.deg() - angle.alpha.deg(), 360.0), 0.0);
    if (!angle.closing) seen.insert({angle.experiment, angle.alpha.deg()});
    if (k > 0 && !angle.closing) {
      EXPECT_GE(std::tuple(angle.experiment, angle.face),
                std::tuple(plan[k - 1].experiment, plan[k - 1].face));
    }
  }
  EXPECT_EQ(seen.size(), 36U);  // Each angle of the circle once in each experiment.
}

TEST(RotationPlanTest, SaysWhichAxisDoesNotReachTheSecondFace) {
  ProtocolConfig config = as_published();
  config.faces = 2;
  config.steps = 71;
  try {
    make_rotation_plan(config, {AxisTravel{deg(-361), deg(85)}, AxisTravel{deg(-120), deg(120)}});
    FAIL();
  } catch (const PlanError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("steps: found 71 with faces = 2; required: an even number"));
    EXPECT_THAT(error.what(),
                testing::HasSubstr("axis Z: found travel -120 to 120 deg; required: a travel that "
                                   "includes the axis angle 180 deg, for face 2 (or [protocol] "
                                   "faces = 1)"));
    // X at 90 degrees is at -270 too.
    EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr("axis X")));
  }
}

ProtocolConfig at_constant_rate() {
  ProtocolConfig config = as_published();
  config.motion = kMotionNames[1];
  config.steps = 36;
  config.step = deg(10.0);
  return config;
}

TEST(RotationPlanTest, AtAConstantRateEachCircleIsSweptUpAndDown) {
  const ProtocolConfig config = at_constant_rate();
  const auto plan = make_rotation_plan(config, kWide);
  ASSERT_EQ(plan.size(), 3U * 2U * 36U);
  for (std::size_t first = 0; first < plan.size(); first += 36) {
    ASSERT_EQ(end_of_sweep(plan, first), first + 36);
    ASSERT_EQ(end_of_sweep(plan, first + 35), first + 36);
    const bool up = (first / 36) % 2 == 0;
    std::set<int> seen;
    for (std::size_t k = first; k < first + 36; ++k) {
      EXPECT_EQ(plan[k].sweep, up ? 1 : 2);
      EXPECT_EQ(plan[k].rate_deg_per_s, up ? 60.0 : -20.0);
      EXPECT_NEAR(std::remainder(plan[k].turning().deg() - plan[k].alpha.deg(), 360.0), 0.0, 1e-9);
      if (k > first) {
        EXPECT_NEAR((plan[k].turning() - plan[k - 1].turning()).deg(), up ? 10.0 : -10.0, 1e-9);
      }
      seen.insert(plan[k].n);
    }
    EXPECT_EQ(seen.size(), 36U);
    // 22.5 degrees to reach 60 degrees/s at 80 degrees/s2, a quarter of a second at it before and a twentieth
    // after, and half a step.
    const SweepTravel way = sweep_travel(plan[first], plan[first + 35], config);
    EXPECT_NEAR((way.from - plan[first].turning()).deg(), up ? -42.5 : 12.5, 1e-9);
    EXPECT_NEAR((way.to - plan[first + 35].turning()).deg(), up ? 30.5 : -8.5, 1e-9);
    EXPECT_GE(std::min(way.from, way.to), kWide[0].min);
    EXPECT_LE(std::max(way.from, way.to), kWide[0].max);
  }
  const auto twist = cable_twist(plan, config);
  EXPECT_GE(twist[0].max.deg() - twist[0].min.deg(), 350.0 + 42.5 + 30.5);
  const std::array<AxisSpeed, 2> speed{AxisSpeed{60.0, 80.0}, AxisSpeed{60.0, 80.0}};
  const PlanDuration duration = estimate_duration(plan, config, speed, 100.0);
  EXPECT_GT(duration.dwelling_s, 3.0 * (6.0 + 18.0));
  EXPECT_LT(duration.total_s(), 110.0);
}

// Up and down in turn, so that each sweep begins where the one before has ended: with an odd number of sweeps
// experiment 2, about the same axis as experiment 1, goes the other way round. Rates begin again after the
// last.
TEST(RotationPlanTest, AtAConstantRateSweepsGoUpAndDownInTurn) {
  struct Case {
    std::vector<double> rates;     ///< As the bench file states them.
    int sweeps;                    ///< In each circle.
    std::vector<double> expected;  ///< The rate of each sweep of the plan.
  };
  const AxisTravel endless{deg(-1000), deg(1000)};
  for (const Case& each :
       {Case{{60.0, 20.0}, 1, {60.0, -60.0, 60.0}},
        Case{{60.0, 20.0}, 2, {60.0, -20.0, 60.0, -20.0, 60.0, -20.0}},
        Case{{60.0, 20.0}, 3, {60.0, -20.0, 60.0, -60.0, 20.0, -60.0, 60.0, -20.0, 60.0}},
        Case{{60.0, 30.0, 20.0},
             4,
             {60.0, -30.0, 20.0, -60.0, 60.0, -30.0, 20.0, -60.0, 60.0, -30.0, 20.0, -60.0}}}) {
    ProtocolConfig config = at_constant_rate();
    config.rate_deg_per_s = each.rates;
    config.sweeps = each.sweeps;
    const auto plan = make_rotation_plan(config, {endless, endless});
    ASSERT_EQ(plan.size(), 36U * each.expected.size());
    for (std::size_t k = 0; k < plan.size(); ++k) {
      const std::size_t number = k / 36;
      const double rate = each.expected[number];
      EXPECT_EQ(plan[k].experiment, static_cast<int>(number) / each.sweeps + 1);
      EXPECT_EQ(plan[k].sweep, static_cast<int>(number) % each.sweeps + 1);
      EXPECT_EQ(plan[k].rate_deg_per_s, rate) << each.sweeps << " sweeps, angle " << k;
      const std::size_t from_first = rate > 0.0 ? k % 36 : 35 - k % 36;
      EXPECT_EQ(plan[k].n, static_cast<int>(from_first) + 1);
      EXPECT_EQ(plan[k].turning(), deg(10.0 * static_cast<double>(from_first)));
    }
  }
}

TEST(RotationPlanTest, AtAConstantRateStopsAreEvenlySpaced) {
  ProtocolConfig config = at_constant_rate();
  config.stops = 4;
  const auto plan = make_rotation_plan(config, kWide);
  ASSERT_EQ(plan.size(), 3U * (2U * 36U + 4U));
  for (std::size_t k = 0; k < 4; ++k) {
    EXPECT_EQ(plan[72 + k].sweep, 0);
    EXPECT_EQ(plan[72 + k].experiment, 1);
    EXPECT_EQ(end_of_sweep(plan, 72 + k), 73 + k);
    if (k > 0) {
      EXPECT_NEAR((plan[72 + k].x - plan[71 + k].x).deg(), 90.0, 1e-9);
    }
  }
}

TEST(RotationPlanTest, AtAConstantRateTheTravelNeedsRoomToReachTheRate) {
  try {
    make_rotation_plan(at_constant_rate(), {AxisTravel{deg(-20.0), deg(370.0)}, AxisTravel{}});
    FAIL() << "380 degrees are enough?";
  } catch (const PlanError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("axis X"));
    EXPECT_THAT(error.what(), testing::HasSubstr("60 deg/s at 80 deg/s2"));
  }
}

TEST(RotationPlanTest, EndsEachExperimentWithAClosingAngleOneTurnOn) {
  const auto plan = make_rotation_plan(as_published(), kWide);
  EXPECT_TRUE(plan[72].closing);
  EXPECT_EQ(plan[72].alpha, deg(360));
  EXPECT_EQ(plan[72].x, deg(360));
  EXPECT_FALSE(plan[71].closing);
}

TEST(RotationPlanTest, ReturnsToTheFirstAngleWhereTheTravelEndsBeforeAFullTurn) {
  const auto plan = make_rotation_plan(as_published(), {AxisTravel{deg(-180), deg(180)}, AxisTravel{}});
  EXPECT_TRUE(plan[72].closing);
  EXPECT_EQ(plan[72].x, plan[0].x);
  EXPECT_EQ(plan[72].n, plan[0].n);
}

TEST(RotationPlanTest, SweepsUpwardsInsideANarrowTravelWithRoomForTheApproach) {
  const AxisTravel narrow{deg(-180), deg(180)};
  const auto plan = make_rotation_plan(as_published(), {narrow, narrow});
  std::set<int> seen;
  Angle previous = deg(-1e9);
  for (const PlannedAngle& angle : plan) {
    if (angle.experiment != 1 || angle.closing) continue;
    EXPECT_GE(angle.x, narrow.min + deg(1));
    EXPECT_LE(angle.x, narrow.max);
    EXPECT_GT(angle.x, previous);
    previous = angle.x;
    seen.insert(angle.n);
  }
  EXPECT_EQ(seen.size(), 72U);
}

TEST(RotationPlanTest, NamesEveryAngleThatTheTravelCannotReachOnBothAxes) {
  try {
    make_rotation_plan(as_published(), {AxisTravel{deg(-100), deg(100)}, AxisTravel{deg(0), deg(200)}});
    FAIL();
  } catch (const PlanError& error) {
    EXPECT_EQ(error.problems().size(), 4U);  // X turning; Z turning; Z held at 0 (no room below) and at -90
    EXPECT_THAT(error.what(), testing::HasSubstr("axis X"));
    EXPECT_THAT(error.what(), testing::HasSubstr("105"));
    EXPECT_THAT(error.what(), testing::HasSubstr("includes the axis angle -90"));
  }
}

TEST(RotationPlanTest, LetsTheDwellLastWholeMainsPeriods) {
  ProtocolConfig config;
  config.dwell_readings = 1000;
  config.mains_hz = 60.0;
  const int count = readings_per_dwell(config, 128.0);
  EXPECT_GE(count, 1000);
  EXPECT_NEAR(std::remainder(count / 128.0 * 60.0, 1.0), 0.0, 0.5 * 60.0 / 128.0);  // half a reading
  config.mains_hz = 50.0;
  EXPECT_EQ(readings_per_dwell(config, 100.0), 1000);
}

TEST(RotationPlanTest, EstimatesTheDurationFromSpeedSettleAndDwell) {
  ProtocolConfig config = as_published();
  config.approach = deg(0);
  const auto plan = make_rotation_plan(config, kWide);
  const PlanDuration duration = estimate_duration(plan, config, {AxisSpeed{20.0}, AxisSpeed{20.0}}, 100.0);
  EXPECT_DOUBLE_EQ(duration.settling_s, 219 * 5.0);
  EXPECT_DOUBLE_EQ(duration.dwelling_s, 219 * 10.0);
  // Exp 1: X to 360. Exp 2: X back, Z to -90, X to 360. Exp 3: X to 270, Z to 0, Z to 360.
  EXPECT_DOUBLE_EQ(duration.moving_s, (360 + 360 + 90 + 360 + 90 + 90 + 360) / 20.0);
}

TEST(RotationPlanTest, CheckPosesStandAtTheStartBetweenTheExperimentsAndAtTheEnd) {
  const ProtocolConfig config;
  const auto plan = make_rotation_plan(config, kWide);
  ASSERT_EQ(plan.size(), make_rotation_plan(as_published(), kWide).size() + 8);
  for (const std::size_t visit : {0U, 75U, 150U, 225U}) {
    EXPECT_EQ(plan[visit].n + plan[visit + 1].n, 3) << "either order";
    for (const PlannedAngle& pose : {plan[visit], plan[visit + 1]}) {
      EXPECT_TRUE(pose.check);
      EXPECT_EQ(pose.experiment, 0);
      // Gravity in the frame of the platter: turned back about X, then about Z.
      const SinCos x = sincos(pose.x), z = sincos(pose.z);
      const double sign = pose.n == 1 ? 1.0 : -1.0;
      for (const double g : {x.sin * z.sin, x.sin * z.cos, x.cos})
        EXPECT_NEAR(g, sign / std::sqrt(3.0), 4e-16);  // A few ulp.
    }
  }
  for (const PlannedAngle& angle : plan) EXPECT_EQ(angle.check, angle.experiment == 0);
}

TEST(RotationPlanTest, CheckPosesCountForTheDurationAndKeepInsideTheTravel) {
  ProtocolConfig config;
  const auto seconds = [&](bool check) {
    config.check_poses = check;
    return estimate_duration(make_rotation_plan(config, kWide), config, {AxisSpeed{20.0}, AxisSpeed{20.0}},
                             100.0);
  };
  EXPECT_DOUBLE_EQ(seconds(true).dwelling_s - seconds(false).dwelling_s, 8 * 10.0);
  EXPECT_DOUBLE_EQ(seconds(true).settling_s - seconds(false).settling_s, 8 * 5.0);
  EXPECT_GT(seconds(true).moving_s, seconds(false).moving_s);
  config.check_poses = true;
  const AxisTravel narrow{deg(-185), deg(185)};
  const auto plan = make_rotation_plan(config, {narrow, AxisTravel{}});
  for (const PlannedAngle& angle : plan) {
    EXPECT_LE(std::abs(angle.x.deg()), 185.0);
    if (angle.check && angle.n == 2) {
      EXPECT_NEAR(angle.x.deg(), 234.7356 - 360.0, 1e-4);  // The digits that are written.
    }
  }
}

TEST(RotationPlanTest, ChecksItsPosesOnTheWay) {
  ProtocolConfig config;
  config.steps = 4;
  config.step = deg(90);
  const auto plan = make_rotation_plan(config, kWide);
  double x_deg = 0.0, travelled_deg = 0.0;
  for (const PlannedAngle& angle : plan) {
    travelled_deg += std::abs(angle.x.deg() - x_deg);
    x_deg = angle.x.deg();
  }
  // To 54.7 and -125.3 and back; experiment 1; back past 234.7 and 54.7; experiment 2; 234.7, 54.7 and on to
  // -90, or to 270 with a way back; then both poses again, and to zero.
  const double parts_deg = 2 * (54.7356 + 180.0) + 360 + 360 + 360;
  EXPECT_GE(travelled_deg + std::abs(x_deg), parts_deg);
  EXPECT_LE(travelled_deg + std::abs(x_deg), 2600.0) << "3310 with the poses and turns in a fixed order";
}

TEST(CableTwist, IsWhatTheWholePlanAndItsApproachesNeed) {
  ProtocolConfig config =
      as_published();  // 72 angles of 5 degrees, the closing angle, from below by 1 degree
  const auto twist = cable_twist(make_rotation_plan(config, {}), config);
  EXPECT_EQ(twist[0].min.deg(), -1.0);   // X stands at 270 in experiment 3; its zero is come to from below.
  EXPECT_EQ(twist[1].min.deg(), -91.0);  // The initial turn, come to from below.
  for (const AxisTravel& axis : twist) EXPECT_EQ(axis.max.deg(), 360.0);
  // A travel without room for a whole turn upwards shifts it, and never winds further.
  const auto shifted = cable_twist(
      make_rotation_plan(config, {AxisTravel{Angle::degrees(-200), Angle::degrees(200)}, AxisTravel{}}),
      config);
  EXPECT_GE(shifted[0].min.deg(), -200.0);
  EXPECT_LE(shifted[0].max.deg(), 200.0);
}

}  // namespace
}  // namespace abcal
