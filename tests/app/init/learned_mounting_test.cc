// The nearest mounting and the signs of the axes from readings whose truth is known: every mounting, sign and
// side of the travel, with tilts, offsets and noise; and readings from which nothing may be learned.

#include "app/measure/session/learned_mounting.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <functional>
#include <set>

#include "app/measure/session/bench_check.h"
#include "app/measure/session/mounting_series.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/mountings.h"

namespace abcal {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using testing::AllOf;
using testing::HasSubstr;

/// A stage and the item on it.
struct TrueBench {
  std::string mounting = "x y z";
  int sign_x = +1, sign_z = +1;
  Matrix3d tilt = Matrix3d::Identity();
  Vector3d offset = Vector3d::Zero();  ///< g_loc
  double response = 1.0;               ///< R for one g_loc
  double turn_x_deg = 30.0, turn_z_deg = 30.0;
};

/// Readings at the three poses of the small turn, turned forwards by Eigen's rotations.
std::vector<PoseReading> readings(const TrueBench& bench) {
  std::vector<PoseReading> poses;
  const Matrix3d axes = mounting_matrix(bench.mounting).value() * bench.tilt;
  for (const auto& [x, z] :
       {std::pair{0.0, 0.0}, {bench.turn_x_deg, 0.0}, {bench.turn_x_deg, bench.turn_z_deg}}) {
    PoseReading pose{Angle::degrees(x), Angle::degrees(z)};
    const Matrix3d turned =
        Eigen::AngleAxisd(bench.sign_x * pose.x.rad(), Vector3d::UnitX()).toRotationMatrix() *
        Eigen::AngleAxisd(bench.sign_z * pose.z.rad(), Vector3d::UnitZ()).toRotationMatrix();
    pose.mean = bench.response * (axes * turned.transpose() * Vector3d::UnitZ() + bench.offset);
    pose.spread = Vector3d::Constant(1e-4 * bench.response);
    pose.u_mean = Vector3d::Constant(1e-5 * bench.response);
    poses.push_back(pose);
  }
  return poses;
}

MountingSearch in_g() {
  return {"g", 1.0, ""};
}

std::vector<std::string> all_mountings() {
  std::vector<std::string> all;
  for (const char* u : {"x", "-x", "y", "-y", "z", "-z"})
    for (const char* v : {"x", "-x", "y", "-y", "z", "-z"})
      for (const char* w : {"x", "-x", "y", "-y", "z", "-z"}) {
        const std::string words = std::string(u) + " " + v + " " + w;
        const auto axes = mounting_matrix(words);
        if (axes && axes->determinant() > 0.0) all.push_back(words);
      }
  return all;
}

/// Turns by an angle about axes in all directions.
std::vector<Matrix3d> tilts(double degrees) {
  std::vector<Matrix3d> all;
  for (int x = -1; x <= 1; ++x)
    for (int y = -1; y <= 1; ++y)
      for (int z = -1; z <= 1; ++z)
        if (x != 0 || y != 0 || z != 0)
          all.push_back(Eigen::AngleAxisd(Angle::degrees(degrees).rad(), Vector3d(x, y, z).normalized())
                            .toRotationMatrix());
  return all;
}

/// The same item, as a person sees it who takes the other end of X for +x.
std::string turned_about_z(const std::string& mounting) {
  const Matrix3d axes = mounting_matrix(mounting).value() * Vector3d(-1, -1, 1).asDiagonal();
  for (const std::string& each : all_mountings())
    if (mounting_matrix(each).value() == axes) return each;
  return {};
}

template <class Test>
void for_all_benches(const Test& test) {
  const std::vector<std::string> mountings = all_mountings();
  ASSERT_EQ(mountings.size(), 24U);
  for (const std::string& mounting : mountings)
    for (const int sign_x : {+1, -1})
      for (const int sign_z : {+1, -1})
        for (const double x : {30.0, -30.0})
          for (const double z : {30.0, -30.0}) {
            TrueBench bench{mounting, sign_x, sign_z};
            bench.turn_x_deg = x;
            bench.turn_z_deg = z;
            test(bench);
          }
}

std::string refusal(const std::vector<PoseReading>& poses, const MountingSearch& search) {
  try {
    const LearnedMounting learned = learn_mounting(poses, search);
    return "learned " + learned.mounting;
  } catch (const MountingUnclear& error) {
    return error.what();
  }
}

TEST(SeriesMounting, NamesTheTurnThatIsMissing) {
  for (const std::string& found : all_mountings())
    for (const char* required : {"x y z", "x z -y", "y z x"}) {
      const MountingJudgement judged =
          judge_series_mounting(readings(TrueBench{.mounting = found}), in_g(), required);
      EXPECT_EQ(judged.is_as_required, found == required) << found << ": " << judged.words;
    }
  const auto words = [](const TrueBench& bench) {
    return judge_series_mounting(readings(bench), in_g(), "x z -y").words;
  };
  EXPECT_THAT(words(TrueBench{.mounting = "x y z"}),
              HasSubstr("it is still to be turned by 90 degrees about X"));
  EXPECT_THAT(words(TrueBench{.mounting = "x z -y", .sign_z = -1}), HasSubstr("[stage.z] sign"));
}

TEST(SeriesMounting, TheTurnsOfASeriesAreThoseOfItsWords) {
  BenchConfig config;
  config.items.front().expected.mounting = "-y x z";
  for (const int count : kMountingCounts) {
    const std::vector<SeriesMounting> series = mountings_of_series(config, count);
    ASSERT_EQ(series.size(), static_cast<std::size_t>(count));
    std::set<std::string> different;
    for (const SeriesMounting& one : series) {
      different.insert(one.mounting);
      EXPECT_EQ(one.bench.items.front().expected.mounting, one.mounting);
    }
    EXPECT_EQ(different.size(), series.size());
    EXPECT_EQ(series.front().mounting, "-y x z");
    EXPECT_EQ(series.front().words, "as in the first run");
  }
  // Turned by 90 degrees about X, y becomes z and z becomes -y.
  const SeriesMounting second = mountings_of_series(config, 2).at(1);
  EXPECT_EQ(second.words, "turned by 90 degrees about X");
  EXPECT_EQ(second.mounting, "-z x -y");
  EXPECT_THAT(mounting_drawing(second.mounting),
              AllOf(HasSubstr("z: -u   (up)"), HasSubstr("y: -w"), HasSubstr("x: v ")));
  config.items.front().expected.mounting = "-x y z";
  EXPECT_THROW(mountings_of_series(config, 3), std::invalid_argument);
}

TEST(LearnMounting, FindsEveryMountingAndBothSigns) {
  for_all_benches([](const TrueBench& bench) {
    const LearnedMounting learned = learn_mounting(readings(bench), in_g());
    EXPECT_EQ(learned.sign_x, +1);
    EXPECT_FALSE(learned.is_sign_x_known);
    EXPECT_EQ(learned.sign_z, bench.sign_z) << bench.mounting;
    // An axis X that counts the other way looks like an item that is turned by half a turn about z.
    EXPECT_EQ(learned.mounting, bench.sign_x > 0 ? bench.mounting : turned_about_z(bench.mounting));
    EXPECT_NEAR(learned.tilt.deg(), 0.0, 1e-5);  // acos near 1 has half the digits
    EXPECT_NEAR(learned.response, 1.0, 1e-12);

    MountingSearch search = in_g();
    search.known = bench.mounting;
    const LearnedMounting known = learn_mounting(readings(bench), search);
    EXPECT_EQ(known.sign_x, bench.sign_x);
    EXPECT_TRUE(known.is_sign_x_known);
    EXPECT_EQ(known.sign_z, bench.sign_z);
    EXPECT_EQ(known.mounting, bench.mounting);
  });
}

// The result must satisfy `abcal check`, which judges with hypotheses of its own.
TEST(LearnMounting, WhatIsLearnedPassesTheCheckWithTiltsAndOffsets) {
  for (const double degrees : {3.0, 9.5}) {
    for (const Matrix3d& tilt : tilts(degrees)) {
      for_all_benches([&](TrueBench bench) {
        bench.tilt = tilt;
        bench.offset = Vector3d(0.1, -0.15, 0.12);  // g_loc: more than an accelerometer in g has
        bench.response = 9.81;
        const std::vector<PoseReading> seen = readings(bench);
        const LearnedMounting learned = learn_mounting(seen, {"m/s2", 9.81, ""});
        ASSERT_EQ(learned.sign_z, bench.sign_z);
        ASSERT_EQ(learned.mounting, bench.sign_x > 0 ? bench.mounting : turned_about_z(bench.mounting));
        ASSERT_NEAR(learned.tilt.deg(), degrees, 1e-4);
        ASSERT_NEAR(learned.offset, bench.offset.norm(), 1e-9);
        std::vector<PoseReading> in_protocol_angles = seen;
        for (PoseReading& pose : in_protocol_angles) {
          pose.x = pose.x * learned.sign_x;
          pose.z = pose.z * learned.sign_z;
          pose.mean = mounting_matrix(learned.mounting)->transpose() * pose.mean;
        }
        ASSERT_EQ(judge_signs(in_protocol_angles).grade, Finding::Grade::kGood);
      });
    }
  }
}

TEST(LearnMounting, AnItemAskewIsRefusedFromTwelveDegreesTo45) {
  for (const double degrees : {12.0, 20.0, 30.0, 45.0}) {
    for (const Matrix3d& tilt : tilts(degrees)) {
      for (const std::string& mounting : all_mountings()) {
        TrueBench bench{mounting};
        bench.tilt = tilt;
        ASSERT_THAT(refusal(readings(bench), in_g()),
                    AllOf(HasSubstr("degrees from the nearest position"), HasSubstr("nine numbers")));
      }
    }
  }
}

TEST(LearnMounting, AnotherUnitIsRefused) {
  TrueBench bench{"-y x z"};
  bench.response = 9.80665;
  EXPECT_THAT(refusal(readings(bench), in_g()), AllOf(HasSubstr("in m/s2"), HasSubstr("response_unit")));
  bench.response = 1.0;
  EXPECT_THAT(refusal(readings(bench), {"m/s2", 9.81, ""}), HasSubstr("changes the readings by"));
  bench.response = 2.0;
  EXPECT_THAT(refusal(readings(bench), in_g()), HasSubstr("full scale"));
  bench.response = 1000.0;
  EXPECT_THAT(refusal(readings(bench), in_g()), HasSubstr("thousandths"));
  bench.response = 123.0;
  EXPECT_EQ(refusal(readings(bench), {"LSB", {}, ""}), "learned -y x z") << "the unit tells nothing";
}

TEST(LearnMounting, ADeadOutputIsNamedWhereverItPoints) {
  for_all_benches([](const TrueBench& bench) {
    for (int j = 0; j < 3; ++j) {
      const std::string name = std::string("output ") + "uvw"[j];
      std::vector<PoseReading> stuck = readings(bench), open = stuck;
      for (PoseReading& pose : stuck) {
        pose.mean[j] = 0.73;  // without noise
        pose.spread[j] = 0.0;
      }
      ASSERT_THAT(refusal(stuck, in_g()), AllOf(HasSubstr(name), HasSubstr("without any noise")));
      double hum = 0.002;
      for (PoseReading& pose : open) pose.mean[j] = 0.1 + (hum = -hum);
      ASSERT_THAT(refusal(open, in_g()), HasSubstr(name));
      ASSERT_THAT(refusal(open, {"V", {}, ""}), HasSubstr("mounting: ")) << bench.mounting;
    }
  });
}

TEST(LearnMounting, AnAxisThatDoesNotTurnGravityIsNamed) {
  TrueBench bench;
  bench.turn_x_deg = 0.0;
  std::vector<PoseReading> poses = readings(bench);
  poses[1].x = poses[2].x = Angle::degrees(30.0);
  EXPECT_THAT(refusal(poses, in_g()), HasSubstr("not fixed to this stage"));
  EXPECT_THAT(refusal(poses, {"V", {}, ""}), HasSubstr("not fixed to this stage"));
  // Both axes exchanged: the first turn is about the vertical, and only the second one tilts.
  std::vector<PoseReading> exchanged = readings({});
  exchanged[2].mean = exchanged[1].mean;
  exchanged[1].mean = exchanged[0].mean;
  for (const MountingSearch& search : {in_g(), MountingSearch{"V", {}, ""}})
    EXPECT_THAT(refusal(exchanged, search), AllOf(HasSubstr("turning X by 30 degrees"), HasSubstr("--axes")));
  std::vector<PoseReading> loose = readings({});
  loose[2].mean = loose[1].mean;
  for (const MountingSearch& search : {in_g(), MountingSearch{"V", {}, ""}})
    EXPECT_THAT(refusal(loose, search), HasSubstr("turning Z by 30 degrees"));
}

TEST(LearnMounting, NoiseOffsetsAndNonsenseAreRefused) {
  std::vector<PoseReading> noisy = readings({});
  noisy[1].u_mean[2] = 0.05;
  EXPECT_THAT(refusal(noisy, in_g()), AllOf(HasSubstr("standard uncertainty"), HasSubstr("vibration")));
  TrueBench far;
  far.offset = Vector3d(0.0, 0.5, 0.0);
  EXPECT_THAT(refusal(readings(far), in_g()), HasSubstr("0.50 g_loc away"));
  std::vector<PoseReading> lost = readings({});
  lost[2].mean[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(refusal(lost, in_g()), HasSubstr("no numbers"));
  std::vector<PoseReading> shaken = readings({});
  shaken[1].mean += Vector3d(0.2, 0.1, -0.2);
  EXPECT_THAT(refusal(shaken, in_g()), HasSubstr("mounting: "));
  EXPECT_THROW(learn_mounting({lost[0], lost[1]}, in_g()), std::invalid_argument);
}

TEST(LearnMounting, AStatedMountingThatGravityContradictsIsRefused) {
  MountingSearch search = in_g();
  search.known = "x y z";
  EXPECT_THAT(refusal(readings({"-y x z"}), search),
              AllOf(HasSubstr("stated is \"x y z\""), HasSubstr("\"-y x z\""), HasSubstr("\"y -x z\"")));
  search.known = "y x z";
  EXPECT_THROW(learn_mounting(readings({}), search), std::invalid_argument) << "left-handed";
}

}  // namespace
}  // namespace abcal
