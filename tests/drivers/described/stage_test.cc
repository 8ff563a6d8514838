#include "drivers/described/stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/stage_description_file.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/mounted_stage.h"
#include "drivers/wire/halt_recipe.h"
#include "sim/firmware/described_firmware.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/sim_clock.h"
#include "tests/drivers/described/rt2_controller.h"
#include "tests/support/error_of.h"
#include "tests/support/project_paths.h"

namespace abcal::described {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using testing::AllOf;
using testing::HasSubstr;

std::shared_ptr<const StageDescription> example() {
  std::ifstream file(test::source_folder() / "docs/examples/described_stage.toml");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  std::vector<Problem> problems;
  auto description = parse_stage_description(text, "example", problems);
  EXPECT_EQ(list_of(problems), "");
  return std::make_shared<const StageDescription>(std::move(description));
}

/// The driver with the example's description, and the controller: written from the manual, or made of the
/// description.
class DescribedStageTest : public testing::Test {
 protected:
  static StageSettings settings() {
    StageSettings settings;
    settings.axis_names = {"O", "I"};
    settings.description = example();
    return settings;
  }
  std::unique_ptr<sim::FirmwareStream> stream() {
    return std::make_unique<sim::FirmwareStream>(controller_, clock_);
  }
  void wait_until_stopped(RotationStage& stage, StageAxis axis) {
    for (int polls = 0; stage.motion_state(axis) == MotionState::kMoving; ++polls) {
      ASSERT_LT(polls, 10'000);
      clock_.sleep_until(clock_.now() + 10ms);
    }
  }
  void home(RotationStage& stage) {
    stage.identify();
    for (const StageAxis axis : kStageAxes) {
      stage.home(axis);
      wait_until_stopped(stage, axis);
    }
  }

  sim::SimClock clock_;
  std::shared_ptr<sim::SimBench> world_ = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock_.now());
  std::shared_ptr<test::Rt2Controller> controller_ = std::make_shared<test::Rt2Controller>(world_);
  DescribedStage stage_{stream(), clock_, settings()};
};

TEST_F(DescribedStageTest, IdentifiesHomesAndMovesTheControllerOfTheManual) {
  const StageInfo info = stage_.identify();
  EXPECT_EQ(info.model, "RT-2");
  EXPECT_EQ(info.serial_number, "00412");
  EXPECT_EQ(info.firmware, "3.07");
  EXPECT_FALSE(info.axes[0].referenced);
  home(stage_);
  EXPECT_TRUE(stage_.identify().axes[0].referenced);
  for (const double angle : {12.5, 179.0, 350.0}) {
    stage_.move_to(StageAxis::kX, Angle::degrees(angle));
    EXPECT_EQ(stage_.motion_state(StageAxis::kX), MotionState::kMoving);
    wait_until_stopped(stage_, StageAxis::kX);
    EXPECT_NEAR(stage_.encoder_angle(StageAxis::kX).deg(), angle, 1e-3);
  }
  EXPECT_EQ(controller_->lost, 0U) << "the gap between commands is kept";
}

TEST_F(DescribedStageTest, SetsASpeedAndGoesBackToTheUsualOne) {
  home(stage_);
  const double usual = world_->motion_limits(StageAxis::kX).speed_deg_per_s;
  stage_.set_speed(StageAxis::kX, 7.5);
  EXPECT_DOUBLE_EQ(world_->motion_limits(StageAxis::kX).speed_deg_per_s, 7.5);
  stage_.set_speed(StageAxis::kX, std::nullopt);
  EXPECT_NEAR(world_->motion_limits(StageAxis::kX).speed_deg_per_s, usual, 1e-3);
  EXPECT_THAT(error_of([&] { stage_.set_speed(StageAxis::kX, 500.0); }, Fault::kOutOfTravel),
              HasSubstr("- 13"));
}

TEST_F(DescribedStageTest, AMoveBeforeHomingIsRefused) {
  stage_.identify();
  error_of([&] { stage_.move_to(StageAxis::kX, Angle::degrees(10)); }, Fault::kNotReady);
  EXPECT_FALSE(world_->moving(StageAxis::kX, clock_.now()));
}

TEST_F(DescribedStageTest, AnOpenInterlockIsRefusedBeforeAnythingMoves) {
  controller_->chain_open = true;
  stage_.identify();
  EXPECT_THAT(error_of([&] { stage_.home(StageAxis::kX); }, Fault::kNotReady),
              HasSubstr("emergency chain is open; close it"));
  EXPECT_FALSE(world_->moving(StageAxis::kX, clock_.now()));
}

TEST_F(DescribedStageTest, AnInterlockThatOpensInMotionIsAFaultAndTheServoIsSwitchedOnAgain) {
  home(stage_);
  stage_.move_to(StageAxis::kZ, Angle::degrees(90));
  controller_->open_chain(clock_.now());
  error_of([&] { stage_.motion_state(StageAxis::kZ); }, Fault::kNotReady);
  controller_->chain_open = false;
  stage_.move_to(StageAxis::kZ, Angle::degrees(20));
  wait_until_stopped(stage_, StageAxis::kZ);
  EXPECT_NEAR(stage_.encoder_angle(StageAxis::kZ).deg(), 20.0, 1e-3);
}

TEST_F(DescribedStageTest, ATableThatMovesWhenItIsPreparedIsHalted) {
  controller_->moves_on_servo = true;
  stage_.identify();
  EXPECT_THAT(error_of([&] { stage_.home(StageAxis::kX); }, Fault::kRefused),
              AllOf(HasSubstr("on [[prepare]]"), HasSubstr("was halted")));
  clock_.sleep_until(clock_.now() + 2s);
  EXPECT_FALSE(world_->moving(StageAxis::kX, clock_.now()));
  EXPECT_LT(world_->encoder_angle(StageAxis::kX, clock_.now()).deg(), 29.0);
}

TEST_F(DescribedStageTest, HaltsInMotionAndByTheRecipeAlone) {
  home(stage_);
  for (const bool by_recipe : {false, true}) {
    stage_.move_to(StageAxis::kX, Angle::degrees(by_recipe ? 80 : 150));
    stage_.move_to(StageAxis::kZ, Angle::degrees(by_recipe ? 80 : 150));
    clock_.sleep_until(clock_.now() + 500ms);
    ASSERT_TRUE(world_->moving(StageAxis::kX, clock_.now()));
    if (by_recipe) {
      const std::vector<HaltRecipe> recipes = stage_.halt_recipes();
      ASSERT_EQ(recipes.size(), 1U);
      sim::FirmwareStream port(controller_, clock_);
      port.write("GO O 12");  // The owner died here.
      EXPECT_TRUE(wire::carry_out(recipes[0], port, clock_, clock_.now() + 5s));
      EXPECT_TRUE(std::ranges::find(controller_->commands, "GO O 12") == controller_->commands.end());
    } else {
      EXPECT_TRUE(stage_.halt());
    }
    for (const StageAxis axis : kStageAxes) EXPECT_FALSE(world_->moving(axis, clock_.now()));
  }
}

TEST_F(DescribedStageTest, RefusesAnotherInstrumentAndAnAxisThatItDoesNotName) {
  auto other = *example();
  other.models = {"RT-3*"};
  StageSettings wrong = settings();
  wrong.description = std::make_shared<const StageDescription>(other);
  DescribedStage stage(stream(), clock_, wrong);
  error_of([&] { stage.identify(); }, Fault::kWrongIdentity);
  wrong = settings();
  wrong.axis_names = {"1", "2"};
  EXPECT_THROW(DescribedStage(stream(), clock_, wrong), std::invalid_argument);
  wrong = settings();
  wrong.description = nullptr;
  EXPECT_THROW(DescribedStage(stream(), clock_, wrong), std::invalid_argument);
}

TEST_F(DescribedStageTest, TurnsBeyondAWholeTurnWithItsMounting) {
  const AxisMounting mounting{Angle{}, +1, Angle::degrees(-400), Angle::degrees(400), true};
  MountedStage stage(std::make_unique<DescribedStage>(stream(), clock_, settings()), {mounting, mounting});
  home(stage);
  for (const double angle : {160.0, 320.0, 370.0, 250.0, 100.0, -20.0}) {
    stage.move_to(StageAxis::kX, Angle::degrees(angle));
    wait_until_stopped(stage, StageAxis::kX);
    EXPECT_NEAR(stage.encoder_angle(StageAxis::kX).deg(), angle, 1e-3);
    EXPECT_NEAR(world_->commanded_angle(StageAxis::kX, clock_.now()).deg(), angle, 1e-3);
  }
}

// The controller that the description itself makes: it agrees with the driver.
TEST_F(DescribedStageTest, TheEmulatorOfTheDescriptionAnswersTheDriver) {
  sim::DescribedSettings names;
  names.axis_names = {"O", "I"};
  const auto firmware = std::make_shared<sim::DescribedFirmware>(world_, example(), names);
  DescribedStage stage(std::make_unique<sim::FirmwareStream>(firmware, clock_), clock_, settings());
  home(stage);
  EXPECT_TRUE(stage.identify().axes[1].referenced);
  stage.move_to(StageAxis::kX, Angle::degrees(120));
  wait_until_stopped(stage, StageAxis::kX);
  EXPECT_NEAR(stage.encoder_angle(StageAxis::kX).deg(), 120.0, 1e-3);
  stage.move_to(StageAxis::kX, Angle::degrees(10));
  clock_.sleep_until(clock_.now() + 200ms);
  EXPECT_TRUE(stage.halt());
  EXPECT_FALSE(world_->moving(StageAxis::kX, clock_.now()));
  EXPECT_TRUE(firmware->unserved().all().empty());
}

/// A stage of a shipped description with its emulator.
struct ShippedStage {
  explicit ShippedStage(const std::string& name, std::array<std::string, 2> axes = {"1", "2"}) {
    std::vector<Problem> problems;
    description = std::make_shared<const StageDescription>(
        parse_stage_description(stage_description_text(name, problems), name, problems));
    EXPECT_EQ(list_of(problems), "");
    sim::DescribedSettings names;
    names.axis_names = axes;
    names.units_per_degree = {1000.0, 500.0};
    firmware = std::make_shared<sim::DescribedFirmware>(world, description, names);
    StageSettings settings;
    settings.axis_names = axes;
    settings.description = description;
    settings.units_per_degree = names.units_per_degree;
    stage = std::make_unique<DescribedStage>(port(), clock, settings);
    stage->identify();
    for (const StageAxis axis : kStageAxes) {
      stage->home(axis);
      wait(axis);
    }
  }
  std::unique_ptr<sim::FirmwareStream> port() {
    return std::make_unique<sim::FirmwareStream>(firmware, clock);
  }
  void wait(StageAxis axis) {
    while (stage->motion_state(axis) == MotionState::kMoving) clock.sleep_until(clock.now() + 10ms);
  }

  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock.now());
  std::shared_ptr<const StageDescription> description;
  std::shared_ptr<sim::DescribedFirmware> firmware;
  std::unique_ptr<DescribedStage> stage;
};

TEST(SilentCommandTest, IsRefusedByTheErrorQueryAndOlderErrorsAreDropped) {
  ShippedStage one("micos_hydra");
  sim::WorldFault fault;
  fault.kind = sim::FaultKind::kRefusedMove;
  fault.axis = StageAxis::kX;
  fault.at = one.clock.now();
  one.world->inject(fault);
  EXPECT_THAT(error_of([&] { one.stage->move_to(StageAxis::kX, Angle::degrees(90.0)); }, Fault::kRefused),
              HasSubstr("\"1\" to \"90.0000 1 nm\""));
  EXPECT_FALSE(one.world->moving(StageAxis::kX, one.clock.now()));
  one.port()->write("nonsense\r\n1 nonsense\r\n");  // Two errors in the queue.
  one.stage->move_to(StageAxis::kZ, Angle::degrees(30.0));
  one.wait(StageAxis::kZ);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kZ).deg(), 30.0, 1e-3);
}

TEST(SilentCommandTest, IsNotSentWhileAnErrorStays) {
  ShippedStage one("micos_hydra");
  for (int n = 0; n < 25; ++n) one.port()->write("nonsense\r\n");
  EXPECT_THAT(error_of([&] { one.stage->move_to(StageAxis::kX, Angle::degrees(90.0)); }, Fault::kNotReady),
              AllOf(HasSubstr("2000"), HasSubstr("was not sent")));
  EXPECT_FALSE(one.world->moving(StageAxis::kX, one.clock.now()));
}

TEST(PlaceTest, EachAxisReadsItsOwnLetterInAReplyForAll) {
  ShippedStage one("owis_ps90", {"7", "3"});
  one.stage->move_to(StageAxis::kZ, Angle::degrees(60.0));
  EXPECT_EQ(one.stage->motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_EQ(one.stage->motion_state(StageAxis::kZ), MotionState::kMoving);
  one.wait(StageAxis::kZ);
  one.stage->move_to(StageAxis::kX, Angle::degrees(60.0));
  EXPECT_EQ(one.stage->motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(one.stage->motion_state(StageAxis::kZ), MotionState::kStopped);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kZ).deg(), 60.0, 1e-3);
}

sim::WorldFault fault_of(sim::FaultKind kind, StageAxis axis, Clock::Instant at) {
  sim::WorldFault fault;
  fault.kind = kind;
  fault.axis = axis;
  fault.at = at;
  return fault;
}

TEST(ReferenceByHandTest, IsNeverSearchedFor) {
  ShippedStage one("aerotech_ensemble", {"X", "Y"});
  one.stage->move_to(StageAxis::kX, Angle::degrees(30.0));
  one.wait(StageAxis::kX);
  one.stage->home(StageAxis::kX);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kX).deg(), 30.0, 1e-3);
  one.world->inject(fault_of(sim::FaultKind::kLostReference, StageAxis::kX, one.clock.now()));
  EXPECT_THAT(error_of([&] { one.stage->home(StageAxis::kX); }, Fault::kNotReady),
              AllOf(HasSubstr("has no reference"), HasSubstr("at the controller")));
  EXPECT_FALSE(one.world->moving(StageAxis::kX, one.clock.now()));
}

TEST(SpeedInAMoveTest, IsTheDescribedOneUnlessOneIsStated) {
  ShippedStage one("aerotech_ensemble", {"X", "Y"});
  EXPECT_DOUBLE_EQ(one.stage->identify().axes[0].speed_deg_per_s, 10.0);
  one.stage->move_to(StageAxis::kX, Angle::degrees(30.0));
  EXPECT_DOUBLE_EQ(one.world->motion_limits(StageAxis::kX).speed_deg_per_s, 10.0);
  one.wait(StageAxis::kX);
  one.stage->set_speed(StageAxis::kX, 2.5);
  one.stage->move_to(StageAxis::kX, Angle::degrees(20.0));
  EXPECT_DOUBLE_EQ(one.world->motion_limits(StageAxis::kX).speed_deg_per_s, 2.5);
  one.wait(StageAxis::kX);
  one.stage->set_speed(StageAxis::kX, std::nullopt);
  one.stage->move_to(StageAxis::kX, Angle::degrees(30.0));
  EXPECT_DOUBLE_EQ(one.world->motion_limits(StageAxis::kX).speed_deg_per_s, 10.0);
}

TEST(LastLineTest, EndsAReplyWhoseFirstLineCounts) {
  ShippedStage one("grbl", {"X", "Y"});
  EXPECT_EQ(one.stage->identify().model, "1.1h.20190825");
  one.stage->move_to(StageAxis::kZ, Angle::degrees(60.0));
  // Grbl has one state for all axes.
  EXPECT_EQ(one.stage->motion_state(StageAxis::kX), MotionState::kMoving);
  one.wait(StageAxis::kZ);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kZ).deg(), 60.0, 1e-3);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kX).deg(), 0.0, 1e-3);
  one.world->inject(fault_of(sim::FaultKind::kRefusedMove, StageAxis::kX, one.clock.now()));
  EXPECT_THAT(error_of([&] { one.stage->move_to(StageAxis::kX, Angle::degrees(9.0)); }, Fault::kRefused),
              HasSubstr("error:"));
}

// A question that is answered in the order of the lines comes first: a status may overtake the last jog.
TEST(LastLineTest, TheHaltOfAJogIsAByteAndIsConfirmedBehindTheLastJog) {
  ShippedStage one("grbl", {"X", "Y"});
  const HaltRecipe recipe = one.stage->halt_recipes().at(0);
  EXPECT_EQ(recipe.end_partial, "$\n");
  EXPECT_EQ(recipe.stop, "\x85");
  ASSERT_EQ(recipe.questions.size(), 3U);
  EXPECT_EQ(recipe.questions[0].bytes, "$G\n");
  EXPECT_EQ(recipe.questions[1].bytes, "?\n");
}

// An axis at rest away from its target has not begun to move, as far as its rate says.
TEST(WindowTest, ARateOfZeroAwayFromTheTargetIsNoRestUntilAHalt) {
  ShippedStage one("acutrol3000");
  one.world->inject(fault_of(sim::FaultKind::kStalledAxis, StageAxis::kX, one.clock.now()));
  one.stage->move_to(StageAxis::kX, Angle::degrees(40.0));
  one.clock.sleep_until(one.clock.now() + 60s);
  EXPECT_EQ(one.stage->motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(one.stage->motion_state(StageAxis::kZ), MotionState::kStopped);
  EXPECT_TRUE(one.stage->halt());
  EXPECT_EQ(one.stage->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST(AllTargetsTest, AnAxisThatIsNotToMoveKeepsItsTargetOrItsAngle) {
  ShippedStage one("micos_corvus", {"3", "1"});
  one.stage->move_to(StageAxis::kX, Angle::degrees(60.0));
  one.stage->move_to(StageAxis::kZ, Angle::degrees(-30.0));
  one.wait(StageAxis::kX);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kX).deg(), 60.0, 1e-3);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kZ).deg(), -30.0, 1e-3);
  one.stage->move_to(StageAxis::kX, Angle::degrees(0.0));
  one.clock.sleep_until(one.clock.now() + 500ms);
  EXPECT_TRUE(one.stage->halt());
  const double halted = one.stage->encoder_angle(StageAxis::kX).deg();
  EXPECT_GT(halted, 1.0);
  one.stage->move_to(StageAxis::kZ, Angle::degrees(0.0));
  one.wait(StageAxis::kZ);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kX).deg(), halted, 0.01);
  EXPECT_NEAR(one.stage->encoder_angle(StageAxis::kZ).deg(), 0.0, 1e-3);
}

// Nothing spoils a command of these: it is carried out, and the halt behind it ends its motion.
TEST(HalfCommandTest, IsHaltedInTheWriteThatEndsIt) {
  for (const char* name : {"newport_smc100", "newport_conex_cc"}) {
    ShippedStage one(name);
    const std::vector<HaltRecipe> recipes = one.stage->halt_recipes();
    ASSERT_EQ(recipes.size(), 1U);
    EXPECT_EQ(recipes[0].end_partial, "\r\n");
    const auto port = one.port();
    port->write("1PA12");  // The owner died before "0.0000".
    EXPECT_TRUE(wire::carry_out(recipes[0], *port, one.clock, one.clock.now() + 5s));
    EXPECT_FALSE(one.world->moving(StageAxis::kX, one.clock.now()));
    EXPECT_LT(std::abs(one.world->commanded_angle(StageAxis::kX, one.clock.now()).deg()), 0.05);
    // Without its halt the same line turns the axis.
    port->write("1PA12\r\n");
    EXPECT_TRUE(one.world->moving(StageAxis::kX, one.clock.now()));
  }
}

// Without the gap the second of two stops would be lost.
TEST(GapTest, IsKeptBetweenTheStopsOfTwoAxes) {
  for (const bool by_recipe : {false, true}) {
    ShippedStage one("owis_ps90");
    for (const StageAxis axis : kStageAxes) one.stage->move_to(axis, Angle::degrees(150.0));
    one.clock.sleep_until(one.clock.now() + 200ms);
    const HaltRecipe recipe = one.stage->halt_recipes().at(0);
    EXPECT_EQ(recipe.stop, "STOP1\r");
    EXPECT_EQ(recipe.further_stops, std::vector<std::string>{"STOP2\r"});
    if (by_recipe) {
      const auto port = one.port();
      EXPECT_TRUE(wire::carry_out(recipe, *port, one.clock, one.clock.now() + 5s));
    } else {
      EXPECT_TRUE(one.stage->halt());
    }
    for (const StageAxis axis : kStageAxes) EXPECT_FALSE(one.world->moving(axis, one.clock.now()));
    for (const sim::UnservedCommand& each : one.firmware->unserved().all())
      EXPECT_THAT(each.reaction, testing::Not(HasSubstr("lost"))) << each.command;
  }
}

}  // namespace
}  // namespace abcal::described
