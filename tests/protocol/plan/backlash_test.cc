#include "protocol/plan/backlash.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace abcal {
namespace {

TEST(BacklashTest, IsLeftWhereAnAxisTurnsBothWaysWithoutApproach) {
  ProtocolConfig protocol;
  const std::vector<PlannedAngle> plan = make_rotation_plan(protocol, {});
  EXPECT_FALSE(backlash_is_left(protocol, plan)) << "1 degree is the default";
  protocol.approach = Angle{};
  EXPECT_TRUE(backlash_is_left(protocol, plan));
}

TEST(BacklashTest, IsNotLeftWhereBothAxesTurnOneWay) {
  const auto pose = [](double x, double z) { return std::array{Angle::degrees(x), Angle::degrees(z)}; };
  // X only up, Z only down: each axis has its backlash on one side.
  const std::vector<std::array<Angle, 2>> one_way{pose(0, 0), pose(90, 0), pose(90, -90), pose(180, -90)};
  EXPECT_FALSE(turns_both_ways(one_way));
  const std::vector<std::array<Angle, 2>> back{pose(0, 0), pose(90, -90), pose(90, 0)};
  EXPECT_TRUE(turns_both_ways(back));
  EXPECT_FALSE(turns_both_ways({}));
}

TEST(BacklashTest, WordsSayWhatIsRequired) {
  EXPECT_THAT(backlash_words(Angle::degrees(0.02)),
              testing::AllOf(testing::HasSubstr("approach_deg = 0"),
                             testing::HasSubstr("backlash within zero_deg (0.02 degree)")));
}

}  // namespace
}  // namespace abcal
