#include "drivers/instrument/mounted_stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

/// Its axes jump to their targets by the shorter way, and are reported from 0 to 360 degrees.
class WrappingStage final : public RotationStage {
 public:
  struct Axes {
    double turned_deg = 0.0;  ///< Angle of X with all turns.
    std::vector<double> targets;
  };
  explicit WrappingStage(Axes& axes) : axes_(axes) {}

  StageInfo identify() override {
    StageInfo info;
    for (StageAxisInfo& axis : info.axes) axis.travel_max = Angle::degrees(360.0);
    return info;
  }
  void home(StageAxis) override { axes_.turned_deg = 0.0; }
  void move_to(StageAxis, Angle target) override {
    axes_.targets.push_back(target.deg());
    axes_.turned_deg += std::remainder(target.deg() - axes_.turned_deg, 360.0);
  }
  MotionState motion_state(StageAxis) override { return MotionState::kStopped; }
  Angle encoder_angle(StageAxis) override {
    return Angle::degrees(axes_.turned_deg - 360.0 * std::floor(axes_.turned_deg / 360.0));
  }
  bool halt() noexcept override { return true; }

 private:
  Axes& axes_;
};

class WrappedStageTest : public testing::Test {
 protected:
  std::unique_ptr<MountedStage> made(std::shared_ptr<CountedTurns> turns = nullptr) {
    const AxisMounting mounting{Angle::degrees(10.0), -1, Angle::degrees(-400.0), Angle::degrees(400.0),
                                true};
    auto stage = std::make_unique<MountedStage>(std::make_unique<WrappingStage>(axes_),
                                                std::array{mounting, mounting}, std::move(turns));
    stage->identify();
    return stage;
  }
  WrappingStage::Axes axes_;
};

TEST_F(WrappedStageTest, CountsTheTurnsThatTheControllerDoesNot) {
  axes_.turned_deg = 10.0;
  const auto stage = made();
  EXPECT_EQ(stage->identify().axes[0].travel_min.deg(), -400.0);
  EXPECT_GT(stage->identify().axes[0].longest_move, Angle{});
  for (const double angle : {150.0, 300.0, 390.0, 250.0, 100.0, -60.0}) {
    stage->move_to(StageAxis::kX, Angle::degrees(angle));
    EXPECT_NEAR(stage->encoder_angle(StageAxis::kX).deg(), angle, 1e-9);
    EXPECT_NEAR(axes_.turned_deg, 10.0 - angle, 1e-9);
  }
  for (const double target : axes_.targets) EXPECT_TRUE(target >= 0.0 && target < 360.0) << target;
}

TEST_F(WrappedStageTest, RefusesAMoveWhoseSenseIsNotCertainAndATargetOutsideTheCable) {
  axes_.turned_deg = 10.0;
  const auto stage = made();
  for (const double angle : {180.0, -200.0, 401.0})
    EXPECT_THROW(stage->move_to(StageAxis::kX, Angle::degrees(angle)), InstrumentError) << angle;
  EXPECT_TRUE(axes_.targets.empty());
}

TEST_F(WrappedStageTest, TheCountOutlivesAStageThatIsMadeAgain) {
  axes_.turned_deg = 10.0;
  const auto turns = std::make_shared<CountedTurns>();
  {
    const auto stage = made(turns);
    for (const double angle : {150.0, 300.0, 390.0}) stage->move_to(StageAxis::kX, Angle::degrees(angle));
  }
  EXPECT_NEAR(made(turns)->encoder_angle(StageAxis::kX).deg(), 390.0, 1e-9);
  EXPECT_NEAR(made()->encoder_angle(StageAxis::kX).deg(), 30.0, 1e-9) << "within half a turn of its zero";
}

TEST_F(WrappedStageTest, AWoundCableIsNotTakenForUnwoundByASearchOfTheReference) {
  axes_.turned_deg = 10.0;
  const auto stage = made();
  for (const double angle : {150.0, 300.0}) stage->move_to(StageAxis::kX, Angle::degrees(angle));
  try {
    stage->home(StageAxis::kX);
    FAIL() << "a search may wind it further";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kNotReady);
    EXPECT_THAT(error.what(), testing::HasSubstr("-300.0 deg from its zero"));
  }
  EXPECT_NEAR(axes_.turned_deg, -290.0, 1e-9) << "nothing was turned";
  stage->move_to(StageAxis::kX, Angle::degrees(140.0));
  stage->home(StageAxis::kX);
  EXPECT_EQ(axes_.turned_deg, 0.0);
}

}  // namespace
}  // namespace abcal
