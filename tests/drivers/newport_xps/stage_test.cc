#include "drivers/newport_xps/stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/newport_xps_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/reply_verdicts.h"
#include "tests/support/error_of.h"

namespace abcal::newport_xps {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using ::testing::HasSubstr;

class NewportXpsStageTest : public ::testing::Test {
 protected:
  std::unique_ptr<NewportXpsStage> connect(const StageSettings& settings = {}) {
    firmware_ = std::make_shared<sim::NewportXpsFirmware>(
        world_, sim::NewportXpsSettings{.axis_names = settings.axis_names});
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    streams.push_back(std::make_unique<sim::FirmwareStream>(firmware_, clock_));
    while (streams.size() < 3)
      streams.push_back(std::make_unique<sim::FirmwareStream>(firmware_->another_session(), clock_));
    return std::make_unique<NewportXpsStage>(std::move(streams), clock_, settings);
  }

  void wait(NewportXpsStage& stage, StageAxis axis) {
    while (stage.motion_state(axis) == MotionState::kMoving) clock_.sleep_until(clock_.now() + 20ms);
  }

  /// Answer of the controller to another client's request within 100 ms.
  std::string other_client(const std::string& request) {
    const auto session = firmware_->another_session();
    session->receive(request, clock_.now());
    clock_.sleep_until(clock_.now() + 100ms);
    return session->transmit(clock_.now());
  }

  sim::SimClock clock_;
  std::shared_ptr<sim::SimBench> world_ = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock_.now());
  std::shared_ptr<sim::NewportXpsFirmware> firmware_;
};

TEST_F(NewportXpsStageTest, SaysWhatTheControllerIs) {
  const StageInfo info = connect()->identify();
  EXPECT_EQ(info.maker, "Newport");
  EXPECT_EQ(info.model, "XPS-C8");
  EXPECT_EQ(info.firmware, "V2.6.0");
  EXPECT_EQ(info.axes[0].stage_name, "Group1.Pos");
  EXPECT_EQ(info.axes[1].stage_name, "Group2.Pos");
  EXPECT_FALSE(info.axes[0].referenced);
}

TEST_F(NewportXpsStageTest, AMoveBeforeHomingIsNotReady) {
  const auto stage = connect();
  const auto error = error_of([&] { stage->move_to(StageAxis::kX, Angle::degrees(1.0)); });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.detail(), HasSubstr("home it"));
}

TEST_F(NewportXpsStageTest, HomesAnAxisThatWasHomedBefore) {
  const auto stage = connect();
  for (int n = 0; n < 2; ++n) {
    stage->home(StageAxis::kX);
    wait(*stage, StageAxis::kX);
    EXPECT_TRUE(stage->identify().axes[0].referenced);
  }
}

TEST_F(NewportXpsStageTest, TheSpeedOfTheBenchFileIsSet) {
  StageSettings settings;
  settings.speed_deg_per_s[0] = 7.5;
  const auto stage = connect(settings);
  stage->home(StageAxis::kX);
  EXPECT_THAT(other_client("PositionerSGammaParametersGet(Group1.Pos,double *,double *,double *,double *)"),
              HasSubstr("0,7.5,"));
}

TEST_F(NewportXpsStageTest, AMotionThatSomebodyElseAbortsIsNoArrival) {
  const auto stage = connect();
  stage->home(StageAxis::kX);
  wait(*stage, StageAxis::kX);
  stage->move_to(StageAxis::kX, Angle::degrees(100.0));
  EXPECT_EQ(other_client("GroupMoveAbort(Group1)"), "0,,EndOfAPI");
  clock_.sleep_until(clock_.now() + 5s);
  const auto error = error_of([&] { stage->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.detail(), HasSubstr("before its target"));
  // It is said once, and the next move is free.
  EXPECT_EQ(stage->motion_state(StageAxis::kX), MotionState::kStopped);
  stage->move_to(StageAxis::kX, Angle::degrees(0.0));
  wait(*stage, StageAxis::kX);
  EXPECT_NEAR(stage->encoder_angle(StageAxis::kX).deg(), 0.0, 1e-3);
}

TEST_F(NewportXpsStageTest, AHaltEndsAHomeSearch) {
  world_->place(StageAxis::kX, Angle::degrees(100.0), clock_.now());
  const auto stage = connect();
  stage->home(StageAxis::kX);
  EXPECT_TRUE(world_->moving(StageAxis::kX, clock_.now()));
  EXPECT_TRUE(stage->halt());
  clock_.sleep_until(clock_.now() + 1s);
  EXPECT_FALSE(world_->moving(StageAxis::kX, clock_.now()));
  EXPECT_FALSE(stage->identify().axes[0].referenced);
}

TEST_F(NewportXpsStageTest, APositionerThatIsNotThereIsSaid) {
  const auto stage = connect();
  StageSettings settings;
  settings.axis_names = {"Group1.Pos", "Spindle.Other"};
  std::vector<std::unique_ptr<wire::ByteStream>> streams;
  streams.push_back(std::make_unique<sim::FirmwareStream>(firmware_->another_session(), clock_));
  NewportXpsStage other(std::move(streams), clock_, settings);
  const auto error = error_of([&] { other.identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.detail(), HasSubstr("there is no such positioner"));
}

TEST_F(NewportXpsStageTest, SettingsThatCannotBeAreRefused) {
  StageSettings settings;
  settings.axis_names = {"G.X", "G.Z"};
  EXPECT_THROW(connect(settings), std::invalid_argument);
  settings.axis_names = {"G1.X,1", "G2.Z"};
  EXPECT_THROW(connect(settings), std::invalid_argument);
  settings.axis_names = {"G1", "G2.Z"};
  EXPECT_THROW(connect(settings), std::invalid_argument);
}

// ---- The simulated controller, as other hosts write to it

TEST_F(NewportXpsStageTest, AnswersInTheStylesOfOtherHosts) {
  connect();
  EXPECT_EQ(other_client("GroupStatusGet (Group1,int *)"), "0,0,EndOfAPI");
  EXPECT_EQ(other_client("GroupStatusGet(Group1, int *)"), "0,0,EndOfAPI");
  EXPECT_EQ(other_client("GroupInitialize(Group1)"), "0,,EndOfAPI");
  EXPECT_EQ(other_client("GroupInitialize(Group1)"), "-22,GroupInitialize(Group1),EndOfAPI");
  EXPECT_EQ(other_client("GroupMoveAbsolute(Group1,5)"), "-22,GroupMoveAbsolute(Group1,5),EndOfAPI");
  EXPECT_EQ(other_client("GroupStatusGet(Group3,int *)"), "-19,GroupStatusGet(Group3,int *),EndOfAPI");
  EXPECT_EQ(other_client("GroupStatusGet(Group1)"), "-9,GroupStatusGet(Group1),EndOfAPI");
  EXPECT_EQ(other_client("Unheard(1)"), "-4,Unheard(1),EndOfAPI");
  ASSERT_EQ(firmware_->unserved().all().size(), 1U);
  EXPECT_EQ(firmware_->unserved().all()[0].command, "Unheard");
}

TEST_F(NewportXpsStageTest, AMotionBlocksItsConnectionOnly) {
  const auto stage = connect();
  stage->home(StageAxis::kX);
  wait(*stage, StageAxis::kX);
  const auto session = firmware_->another_session();
  session->receive("GroupMoveAbsolute(Group1,90)", clock_.now());
  clock_.sleep_until(clock_.now() + 500ms);
  EXPECT_EQ(session->transmit(clock_.now()), "");
  session->receive("GroupStatusGet(Group1,int *)", clock_.now());
  clock_.sleep_until(clock_.now() + 100ms);
  EXPECT_EQ(session->transmit(clock_.now()), "-1,GroupStatusGet(Group1,int *),EndOfAPI");
  EXPECT_EQ(other_client("GroupStatusGet(Group1,int *)"), "0,44,EndOfAPI");
  clock_.sleep_until(clock_.now() + 30s);
  EXPECT_EQ(session->transmit(clock_.now()), "");
  clock_.sleep_until(clock_.now() + 100ms);
  EXPECT_EQ(session->transmit(clock_.now()), "0,,EndOfAPI");
  EXPECT_EQ(other_client("GroupStatusGet(Group1,int *)"), "0,12,EndOfAPI");
}

TEST_F(NewportXpsStageTest, ItsRecipeTellsStandingGroupsFromMovingOnesAndFromOtherReplies) {
  using enum test::Verdict;
  const HaltRecipe recipe = connect()->halt_recipes().at(0);
  EXPECT_EQ(recipe.reply_end, ",EndOfAPI");
  ASSERT_EQ(recipe.questions.size(), 5U);
  test::expect_verdicts(recipe, recipe.questions[0],
                        {{"0,XPS-C8 Firmware V2.6.0", kStanding},
                         {"0,XPS", kStanding},
                         {"0,HXP Firmware V1.4.0", kStanding},
                         {"", kOther},
                         {"0,", kOther},
                         {"0,12", kOther},
                         {"0,XP", kOther},
                         {"0,xps-c8", kOther},
                         {"0, XPS-C8", kOther},
                         {"XPS-C8 Firmware V2.6.0", kOther},
                         {"0,XPS-C8\r\nFirmware V2.6.0", kOther},
                         {"0,XPS-C8\n", kOther},
                         {"1,XPS-C8", kOther},
                         {"-4,FirmwareVersionGet(char *)", kOther}});
  for (const std::size_t axis : {0U, 1U}) {
    test::expect_verdicts(recipe, recipe.questions[1 + 2 * axis],
                          {{"0,", kStanding},
                           {"-22,GroupMoveAbort(Group1)", kStanding},
                           {"-4,", kStanding},
                           {"-100007,x", kStanding},
                           {"", kOther},
                           {"0", kOther},
                           {"0,12", kOther},
                           {"00,", kOther},
                           {"-22", kOther},
                           {"-,x", kOther},
                           {"22,GroupMoveAbort(Group1)", kOther},
                           {"+22,x", kOther},
                           {"-2a,x", kOther},
                           {"--2,x", kOther},
                           {"-22,x\r\n", kOther}});
    const HaltRecipe::Question& status = recipe.questions[2 + 2 * axis];
    test::expect_verdicts(recipe, status,
                          {{"", kOther},
                           {"0", kOther},
                           {"0,", kOther},
                           {"0,1,2", kOther},
                           {"0,-1", kOther},
                           {"0,+1", kOther},
                           {"0, 12", kOther},
                           {"0,12 ", kOther},
                           {"0,12\n", kOther},
                           {"0,12.0", kOther},
                           {"1,12", kOther},
                           {"12", kOther},
                           {"-22,GroupStatusGet(Group1,int *)", kOther},
                           {"0,XPS-C8 Firmware V2.6.0", kOther},
                           // Not written as the controller writes numbers: an answer, but no standstill.
                           {"0,00", kMoving},
                           {"0,07", kMoving},
                           {"0,012", kMoving},
                           {"0,042", kMoving},
                           {"0,4294967308", kMoving},
                           {"0,18446744073709551628", kMoving}});
    for (int state = 0; state < 1200; ++state) {
      const bool stands = state < 40 || state == 42 || state == 50 || state == 63;
      test::expect_verdicts(recipe, status, {{"0," + std::to_string(state), stands ? kStanding : kMoving}});
    }
  }
}

}  // namespace
}  // namespace abcal::newport_xps
