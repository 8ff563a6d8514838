#include "drivers/instrument/split_stage.h"

#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace abcal {
namespace {

/// Notes its calls, under its name.
class NotingStage final : public RotationStage {
 public:
  NotingStage(std::string name, std::vector<std::string>& notes) : name_(std::move(name)), notes_(notes) {}

  StageInfo identify() override {
    StageInfo info;
    info.maker = "Maker";
    info.model = "model " + name_;
    info.serial_number = name_;
    info.firmware = "1";
    for (StageAxisInfo& axis : info.axes) axis.stage_name = name_;
    return info;
  }
  void home(StageAxis axis) override { note("home", axis); }
  void move_to(StageAxis axis, Angle) override { note("move", axis); }
  MotionState motion_state(StageAxis axis) override {
    note("motion", axis);
    return name_ == "x" ? MotionState::kMoving : MotionState::kStopped;
  }
  Angle encoder_angle(StageAxis axis) override {
    note("encoder", axis);
    return Angle::degrees(name_ == "x" ? 1.0 : 2.0);
  }
  bool halt() noexcept override {
    halted = true;
    if (wait_for.valid()) wait_for.wait();
    return acknowledges;
  }

  std::atomic<bool> halted = false;
  bool acknowledges = true;
  std::shared_future<void> wait_for;

 private:
  void note(const std::string& what, StageAxis axis) {
    notes_.push_back(name_ + " " + what + " " + std::string(to_string(axis)));
  }
  std::string name_;
  std::vector<std::string>& notes_;
};

class SplitStageTest : public testing::Test {
 protected:
  std::vector<std::string> notes_;
  std::unique_ptr<NotingStage> owned_x_ = std::make_unique<NotingStage>("x", notes_);
  std::unique_ptr<NotingStage> owned_z_ = std::make_unique<NotingStage>("z", notes_);
  NotingStage& x_ = *owned_x_;
  NotingStage& z_ = *owned_z_;
  SplitStage stage_{std::move(owned_x_), std::move(owned_z_)};
};

TEST_F(SplitStageTest, EachAxisIsAskedOfItsOwnController) {
  stage_.home(StageAxis::kZ);
  stage_.move_to(StageAxis::kX, Angle::degrees(1.0));
  EXPECT_EQ(stage_.motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(stage_.motion_state(StageAxis::kZ), MotionState::kStopped);
  EXPECT_EQ(stage_.encoder_angle(StageAxis::kX).deg(), 1.0);
  EXPECT_EQ(stage_.encoder_angle(StageAxis::kZ).deg(), 2.0);
  EXPECT_EQ(notes_, (std::vector<std::string>{"z home Z", "x move X", "x motion X", "z motion Z",
                                              "x encoder X", "z encoder Z"}));
}

TEST_F(SplitStageTest, TheIdentityIsThatOfBoth) {
  const StageInfo info = stage_.identify();
  EXPECT_EQ(info.maker, "Maker");
  EXPECT_EQ(info.model, "model x + model z");
  EXPECT_EQ(info.serial_number, "x + z");
  EXPECT_EQ(info.firmware, "1");
  EXPECT_EQ(info.axes[0].stage_name, "x");
  EXPECT_EQ(info.axes[1].stage_name, "z");
}

TEST_F(SplitStageTest, HaltNeedsBothToAcknowledge) {
  EXPECT_TRUE(stage_.halt());
  x_.acknowledges = false;
  EXPECT_FALSE(stage_.halt());
  x_.acknowledges = true;
  z_.acknowledges = false;
  EXPECT_FALSE(stage_.halt());
}

TEST_F(SplitStageTest, AControllerThatIsSlowToStopDoesNotKeepTheOtherMoving) {
  for (const bool slow_x : {true, false}) {
    x_.halted = z_.halted = false;
    std::promise<void> may_end;
    (slow_x ? x_ : z_).wait_for = may_end.get_future().share();
    auto halting = std::async(std::launch::async, [&] { return stage_.halt(); });
    // Ends only if the other stage is halted while the slow one still halts.
    while (!(slow_x ? z_ : x_).halted) std::this_thread::yield();
    may_end.set_value();
    EXPECT_TRUE(halting.get());
    (slow_x ? x_ : z_).wait_for = {};
  }
}

TEST(SplitStageMakingTest, APartThatIsMissingIsRefused) {
  std::vector<std::string> notes;
  EXPECT_THROW(SplitStage(nullptr, std::make_unique<NotingStage>("z", notes)), std::invalid_argument);
  EXPECT_THROW(SplitStage(std::make_unique<NotingStage>("x", notes), nullptr), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
