#include "drivers/pi_gcs/stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <future>
#include <limits>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "tests/drivers/pi_gcs/scripted_controller.h"
#include "tests/drivers/reply_verdicts.h"
#include "tests/support/error_of.h"

namespace abcal::pi_gcs {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using test::ScriptedController;
using ::testing::AllOf;
using ::testing::HasSubstr;

class PiGcsStageTest : public ::testing::Test {
 protected:
  void connect(const StageSettings& settings = {}) {
    stage_ =
        std::make_unique<PiGcsStage>(std::unique_ptr<wire::ByteStream>(owned_.release()), clock_, settings);
  }

  test::FakeClock clock_;
  std::unique_ptr<ScriptedController> owned_ = std::make_unique<ScriptedController>(clock_);
  ScriptedController& controller_ = *owned_;
  std::unique_ptr<PiGcsStage> stage_;
};

TEST_F(PiGcsStageTest, IdentifiesControllerAndAxes) {
  connect();
  const StageInfo info = stage_->identify();
  EXPECT_EQ(info.model, "C-884.4DC");
  EXPECT_EQ(info.serial_number, "123456");
  EXPECT_EQ(info.firmware, "1.2.3");
  for (const StageAxisInfo& axis : info.axes) {
    EXPECT_EQ(axis.stage_name, "M-060.PD");
    EXPECT_EQ(axis.travel_min.deg(), -360.0);
    EXPECT_EQ(axis.travel_max.deg(), 370.5);
    EXPECT_EQ(axis.resolution.deg(), 1e-4);
    EXPECT_EQ(axis.speed_deg_per_s, 20.0);
    EXPECT_TRUE(axis.referenced);
  }
  for (const std::string& command : controller_.commands()) {
    EXPECT_TRUE(command.find('?') != std::string::npos) << command << " changes something";
  }
}

TEST_F(PiGcsStageTest, RepliesMayComeByteByByte) {
  controller_.byte_by_byte = true;
  connect();
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 370.5);
  stage_->move_to(StageAxis::kX, Angle::degrees(5.0));
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kZ).deg(), 14.5);
}

TEST_F(PiGcsStageTest, DoesWithoutWhatAControllerNeedNotKnow) {
  for (const std::string axis : {"1", "2"}) {
    controller_.replies.erase("VEL? " + axis);
    controller_.replies.erase("CST? " + axis);
    controller_.refusals["SPA? " + axis + " 14"] = 54;
  }
  connect();
  const StageInfo info = stage_->identify();
  EXPECT_EQ(info.axes[0].speed_deg_per_s, 0.0);
  EXPECT_EQ(info.axes[0].stage_name, "");
  EXPECT_EQ(info.axes[0].resolution.deg(), 0.0);
  EXPECT_EQ(info.axes[0].travel_max.deg(), 370.5);
}

TEST_F(PiGcsStageTest, AnotherInstrumentOnThePortIsNamed) {
  controller_.replies["*IDN?"] = "Keysight Technologies,34465A,MY54500001,A.02.14\n";
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("Keysight"), HasSubstr("PI controller")));
}

TEST_F(PiGcsStageTest, AStreamOfForeignBytesIsAnotherInstrument) {
  controller_.replies.erase("*IDN?");
  for (int i = 1; i < 2000; ++i) controller_.say("\x75\x65\x80\x1c\x0a", i * 10ms);
  connect();
  EXPECT_EQ(error_of([&] { stage_->identify(); }).fault(), Fault::kWrongIdentity);
}

TEST_F(PiGcsStageTest, AnAbsentAxisIsNamedWithThoseThatThereAre) {
  connect({.axis_names = {"1", "7"}, .speed_deg_per_s = {}, .address = {}});
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("no axis \"7\" (for Z)"), HasSubstr("1, 2, 3")));
}

TEST_F(PiGcsStageTest, AUnitOtherThanDegreesIsRefused) {
  controller_.replies["PUN? 2"] = "2=MM\n";
  connect();
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("\"MM\""), HasSubstr("degrees")));
  EXPECT_EQ(controller_.count("MOV 1 1.000000"), 0U);
}

TEST_F(PiGcsStageTest, AControllerWithoutPunTellsItsUnitByAParameter) {
  for (const std::string axis : {"1", "2"}) {
    controller_.replies.erase("PUN? " + axis);
    controller_.replies["SPA? " + axis + " 0x7000601"] = axis + " 0x7000601=deg\n";
  }
  connect();
  EXPECT_EQ(stage_->identify().axes[0].travel_max.deg(), 370.5);
  controller_.replies["SPA? 2 0x7000601"] = "2 0x7000601=mm\n";
  EXPECT_THAT(error_of([&] { stage_->identify(); }).what(), HasSubstr("\"mm\""));
}

TEST_F(PiGcsStageTest, AControllerThatDoesNotTellItsUnitNeedsItInTheBenchFile) {
  for (const std::string axis : {"1", "2"}) controller_.replies.erase("PUN? " + axis);
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), HasSubstr("unit = \"deg\""));
}

TEST_F(PiGcsStageTest, TheBenchFileMayTellTheUnit) {
  for (const std::string axis : {"1", "2"}) controller_.replies.erase("PUN? " + axis);
  StageSettings settings;
  settings.unit = "deg";
  connect(settings);
  EXPECT_EQ(stage_->identify().axes[0].travel_max.deg(), 370.5);
}

TEST_F(PiGcsStageTest, AReadBackThatNoStageCanHaveIsNoAngle) {
  controller_.replies["POS? 1"] = "1=1e300\n";
  connect();
  EXPECT_THROW(stage_->encoder_angle(StageAxis::kX), InstrumentError);
}

TEST_F(PiGcsStageTest, SettingsThatCannotBeMeantAreRefused) {
  const auto with = [&](const StageSettings& settings) {
    return std::make_unique<PiGcsStage>(std::make_unique<ScriptedController>(clock_), clock_, settings);
  };
  StageSettings settings;
  settings.axis_names = {"1", "1"};
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings = {};
  settings.axis_names = {"", ""};
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings = {};
  settings.axis_names = {"1\nMOV", "2"};
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings = {};
  settings.speed_deg_per_s[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings = {};
  for (const std::string address : {"two", "0", "17", "02", "255"}) {  // 255: all of them at once
    settings.address = address;
    EXPECT_THROW(with(settings), std::invalid_argument) << address;
  }
  for (const std::string name : {"two 1", "1 2 3", "255 1"}) {
    settings = {};
    settings.axis_names = {name, "1 2"};
    EXPECT_THROW(with(settings), std::invalid_argument) << name;
  }
  settings = {};
  settings.axis_names = {"2 1", "1"};  // One has no address.
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings.address = "2";  // Both names then mean the same axis.
  EXPECT_THROW(with(settings), std::invalid_argument);
}

TEST_F(PiGcsStageTest, AnAxisOnAnotherControllerIsNotThisOnes) {
  connect({.axis_names = {"1", ""}, .speed_deg_per_s = {}, .address = {}});
  EXPECT_EQ(stage_->identify().axes[0].travel_max.deg(), 370.5);
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kZ); }).fault(), Fault::kNotReady);
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kZ); }).fault(), Fault::kNotReady);
}

TEST_F(PiGcsStageTest, HomesByTheReferenceSwitchWithTheServoOn) {
  controller_.refusals["EAX 1 1"] = 2;
  connect();
  stage_->home(StageAxis::kX);
  EXPECT_EQ(controller_.count("SVO 1 1"), 1U);
  EXPECT_EQ(controller_.count("FRF 1"), 1U);
}

TEST_F(PiGcsStageTest, HomesByTheLimitSwitchWhereThereIsNoOther) {
  controller_.replies["TRS? 2"] = "2=0\n";
  connect();
  stage_->home(StageAxis::kZ);
  EXPECT_EQ(controller_.count("FRF 2"), 0U);
  EXPECT_EQ(controller_.count("FNL 2"), 1U);
}

TEST_F(PiGcsStageTest, SaysSoWhereAnAxisCannotBeHomed) {
  controller_.replies["TRS? 2"] = "2=0\n";
  controller_.replies["LIM? 2"] = "2=0\n";
  connect();
  const InstrumentError error = error_of([&] { stage_->home(StageAxis::kZ); });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.what(), HasSubstr("neither a reference switch nor limit switches"));
}

TEST_F(PiGcsStageTest, MovesOnceWithServoAndSpeedSetBefore) {
  controller_.replies["SVO? 1"] = "1=0\n";
  connect({.axis_names = {"1", "2"}, .speed_deg_per_s = {12.5, {}}, .address = {}});
  stage_->move_to(StageAxis::kX, Angle::degrees(90.0));
  stage_->move_to(StageAxis::kX, Angle::degrees(95.0));
  EXPECT_EQ(controller_.count("SVO 1 1"), 1U);
  EXPECT_EQ(controller_.count("VEL 1 12.500000"), 1U);
  EXPECT_EQ(controller_.count("MOV 1 90.000000"), 1U);
  EXPECT_EQ(controller_.count("MOV 1 95.000000"), 1U);
  const std::vector<std::string> commands = controller_.commands();
  for (std::size_t i = 0; i < commands.size(); ++i) {  // ERR? after every set command.
    if (commands[i].find('?') == std::string::npos) {
      ASSERT_LT(i + 1, commands.size());
      EXPECT_EQ(commands[i + 1], "ERR?") << commands[i];
    }
  }
}

TEST_F(PiGcsStageTest, AMoveWithoutReferenceIsNotReady) {
  for (const int code : {5, 31}) {
    controller_.refusals["MOV 1 90.000000"] = code;
    controller_.replies["FRF? 1"] = "1=0\n";
    if (!stage_) connect();
    const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(90.0)); });
    EXPECT_EQ(error.fault(), Fault::kNotReady);
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("stage C-884.4DC (SN 123456)"), HasSubstr("has lost its reference; home it"),
                      HasSubstr("error " + std::to_string(code))));
  }
}

TEST_F(PiGcsStageTest, AServoThatWentOffIsNotCalledALostReference) {
  controller_.refusals["MOV 1 90.000000"] = 5;
  connect();
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(90.0)); });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.what(), HasSubstr("servo of axis \"1\" is off"));
}

TEST_F(PiGcsStageTest, ARefusalCarriesCodeTextAndCommandAndIsNotRepeated) {
  controller_.refusals["MOV 1 400.000000"] = 7;
  controller_.refusals["MOV 2 1.000000"] = 51;
  connect();
  const InstrumentError travel = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(400.0)); });
  EXPECT_EQ(travel.fault(), Fault::kOutOfTravel);
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kZ, Angle::degrees(1.0)); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(), HasSubstr("error 51 (axis is under joystick control) to \"MOV 2 1.000000\""));
  EXPECT_EQ(controller_.count("MOV 2 1.000000"), 1U);
}

TEST_F(PiGcsStageTest, AnOldErrorIsNotLaidAtANewCommandsDoor) {
  connect();
  controller_.write("NOSUCH?\n");  // An earlier program left error 2.
  EXPECT_NO_THROW(stage_->move_to(StageAxis::kX, Angle::degrees(90.0)));
}

TEST_F(PiGcsStageTest, AnErrorThatWasNotReadIsNotLaidAtTheNextCommandsDoor) {
  connect();
  stage_->identify();
  controller_.mishaps["ERR?"] = {{.instead = "", .late = {}}};
  EXPECT_THROW(stage_->home(StageAxis::kX), InstrumentError);  // Its error code is lost.
  controller_.write("NOSUCH?\n");                              // Error 2 waits.
  EXPECT_NO_THROW(stage_->move_to(StageAxis::kX, Angle::degrees(90.0)));
}

TEST_F(PiGcsStageTest, ATargetThatIsNoNumberIsNotSent) {
  connect();
  stage_->identify();
  const std::size_t before = controller_.commands().size();
  EXPECT_EQ(error_of([&] {
              stage_->move_to(StageAxis::kX, Angle::degrees(std::numeric_limits<double>::quiet_NaN()));
            }).fault(),
            Fault::kOutOfTravel);
  EXPECT_EQ(controller_.commands().size(), before);
}

TEST_F(PiGcsStageTest, MotionIsTheAxisOwnBitInTheOrderOfTheAxes) {
  controller_.replies["SAI?"] = "A \n2 \n1\n";
  connect();
  controller_.replies["\x05"] = "4\n";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kStopped);
  controller_.replies["\x05"] = "2\n";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kMoving);
}

TEST_F(PiGcsStageTest, AnAxisThatStoppedOutsideItsWindowIsStopped) {
  controller_.replies["ONT? 1"] = "1=0\n";
  connect();
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(PiGcsStageTest, AsksForTheStatusWhereTheMaskIsNotKnown) {
  controller_.replies.erase("\x05");
  controller_.replies["\x04"] = "0x100050001000\n";
  connect();
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kMoving);  // 0x4000: homing.
  EXPECT_EQ(controller_.count("\x05"), 1U);
}

TEST_F(PiGcsStageTest, AsksForOnTargetWhereNothingElseIsKnown) {
  controller_.replies.erase("\x05");
  controller_.replies.erase("\x04");
  controller_.replies["ONT? 2"] = "2=0\n";
  connect();
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kMoving);
}

// ---- Faults on the wire

TEST_F(PiGcsStageTest, ASilentControllerNeverReadsAsStopped) {
  connect();
  stage_->identify();
  controller_.silent = true;
  const Clock::Instant before = clock_.now();
  const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kNoReply);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("no answer to \"#5\""), HasSubstr("nothing arrived")));
  EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline);
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kNoReply);
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNoReply);
  EXPECT_EQ(controller_.count("MOV 1 1.000000"), 0U)
      << "no move is sent to a controller that does not answer";
}

TEST_F(PiGcsStageTest, ASilentPortSaysWhatToCheck) {
  controller_.silent = true;
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kNoReply);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("*IDN?"), HasSubstr("baud rate")));
}

TEST_F(PiGcsStageTest, WorksAgainOnceTheControllerDoes) {
  connect();
  stage_->identify();
  controller_.silent = true;
  EXPECT_THROW(stage_->encoder_angle(StageAxis::kX), InstrumentError);
  controller_.silent = false;
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(PiGcsStageTest, AReplyThatWasLostIsAskedForOnceMore) {
  connect();
  stage_->identify();
  controller_.mishaps["POS? 1"] = {{.instead = "", .late = {}}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
  EXPECT_EQ(controller_.count("POS? 1"), 2U);
}

TEST_F(PiGcsStageTest, ALateReplyIsTheAnswerToItsOwnQueryOnly) {
  connect();
  stage_->identify();
  controller_.mishaps["POS? 1"] = {{.instead = "1=10.0\n", .late = 3s}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 10.0);  // In time for the resynchronisation.
  EXPECT_EQ(controller_.count("POS? 1"), 1U);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(PiGcsStageTest, AVeryLateReplyIsNotTheAnswerToTheNextQuery) {
  connect();
  stage_->identify();
  controller_.mishaps["POS? 1"] = {{.instead = "1=10.0\n", .late = 4500ms}};
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kNoReply);
  controller_.replies["POS? 1"] = "1=20.0\n";
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 20.0);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 20.0);
}

TEST_F(PiGcsStageTest, HalfAReplyIsNotJoinedToTheNext) {
  connect();
  stage_->identify();
  controller_.mishaps["POS? 1"] = {{.instead = "1=1", .late = {}}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(PiGcsStageTest, GarbageIsAskedAgainAndThenABadFrame) {
  connect();
  stage_->identify();
  controller_.mishaps["\x05"] = {{.instead = "\xFF\x80\n", .late = {}}};
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  controller_.replies["\x05"] = "\xFF\x80\n";
  const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kBadFrame);
  EXPECT_THAT(error.what(), HasSubstr("\"\\xff\\x80\\n\" is not an answer to \"#5\""));
}

TEST_F(PiGcsStageTest, GarbageWithoutEndDoesNotHoldTheDriver) {
  connect();
  stage_->identify();
  controller_.silent = true;
  for (int i = 1; i < 10000; ++i) controller_.say("garbage", i * 1ms);
  const Clock::Instant before = clock_.now();
  EXPECT_THROW(stage_->encoder_angle(StageAxis::kX), InstrumentError);
  EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline + 10ms);
}

TEST_F(PiGcsStageTest, AnAxisOtherThanTheOneAskedIsNoAnswer) {
  connect();
  stage_->identify();
  controller_.replies["POS? 1"] = "2=3.0\n";
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kBadFrame);
}

TEST_F(PiGcsStageTest, AMoveWhoseAcceptanceIsNotKnownIsNotRepeated) {
  connect();
  stage_->identify();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  controller_.mishaps["ERR?"] = {{.instead = "", .late = {}}};
  const InstrumentError lost = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(2.0)); });
  EXPECT_EQ(lost.fault(), Fault::kNoReply);
  EXPECT_THAT(lost.what(), HasSubstr("whether that command was accepted is unknown"));
  EXPECT_EQ(controller_.count("MOV 1 2.000000"), 1U);
  controller_.mishaps["ERR?"] = {{.instead = {}, .late = {}}, {.instead = "?!\n", .late = {}}};
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(3.0)); }).fault(), Fault::kBadFrame);
  EXPECT_EQ(controller_.count("MOV 1 3.000000"), 1U);
}

TEST_F(PiGcsStageTest, ALateErrorCodeStillCounts) {
  connect();
  stage_->identify();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  controller_.refusals["MOV 1 2.000000"] = 51;
  controller_.mishaps["ERR?"] = {{.instead = {}, .late = 2500ms}};
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(2.0)); }).fault(), Fault::kRefused);
}

TEST_F(PiGcsStageTest, AQueryThatIsRefusedSaysWhy) {
  connect();
  stage_->identify();
  controller_.refusals["POS? 1"] = 63;
  const InstrumentError error = error_of([&] { stage_->encoder_angle(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(), HasSubstr("error 63 (initialisation is running) to \"POS? 1\""));
}

TEST_F(PiGcsStageTest, AnUnpluggedPortIsALostLink) {
  connect();
  stage_->identify();
  controller_.unplugged = true;
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kX); }).fault(), Fault::kLinkLost);
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kLinkLost);
  EXPECT_FALSE(stage_->halt());
}

// ---- Daisy chain

TEST_F(PiGcsStageTest, SpeaksToAControllerInADaisyChain) {
  std::map<std::string, std::string> chained;
  for (const auto& [command, reply] : controller_.replies) {
    if (command.size() > 1) chained["2 " + command] = "0 2 " + reply;
  }
  chained["2 ERR?"] = "0 2 0\n";
  chained["2 \x05"] = "0 2 1\n";
  controller_.replies = chained;
  connect({.axis_names = {"1", "2"}, .speed_deg_per_s = {}, .address = "2"});
  EXPECT_EQ(stage_->identify().axes[0].travel_min.deg(), -360.0);
  stage_->move_to(StageAxis::kX, Angle::degrees(5.0));
  EXPECT_EQ(controller_.count("2 MOV 1 5.000000"), 1U);
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kStopped);
}

/// Replies of controllers at addresses 1 and 4, each with one axis; that at 4 moves.
std::map<std::string, std::string> replies_of_a_chain(const std::map<std::string, std::string>& of_one) {
  std::map<std::string, std::string> chained;
  for (const std::string address : {"1", "4"}) {
    for (const auto& [command, reply] : of_one) {
      if (command.size() > 1) chained[address + " " + command] = "0 " + address + " " + reply;
    }
    chained[address + " ERR?"] = "0 " + address + " 0\n";
    chained[address + " \x05"] = "0 " + address + " 0\n";
  }
  chained["4 *IDN?"] = "0 4 (c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-863.12, 777, 1.2.3\n";
  chained["4 \x05"] = "0 4 1\n";
  chained["4 POS? 1"] = "0 4 1=-7.5\n";
  return chained;
}

TEST_F(PiGcsStageTest, TwoControllersOfAChainAreOneStage) {
  controller_.replies = replies_of_a_chain(controller_.replies);
  connect({.axis_names = {"1 1", "4 1"}, .speed_deg_per_s = {}, .address = {}, .unit = {}});
  const StageInfo info = stage_->identify();
  EXPECT_EQ(info.model, "C-884.4DC/C-863.12");
  EXPECT_EQ(info.serial_number, "123456/777");
  stage_->move_to(StageAxis::kZ, Angle::degrees(5.0));
  EXPECT_EQ(controller_.count("4 MOV 1 5.000000"), 1U);
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kMoving);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kZ).deg(), -7.5);
  // A halt reaches both, and is acknowledged by both.
  controller_.replies["1 ERR?"] = "0 1 10\n";
  controller_.replies["4 ERR?"] = "0 4 10\n";
  EXPECT_TRUE(stage_->halt());
  EXPECT_GE(controller_.count("1 STP"), 1U);
  EXPECT_GE(controller_.count("4 STP"), 1U);
  const std::vector<HaltRecipe> recipes = stage_->halt_recipes();
  ASSERT_EQ(recipes.size(), 2U);
  EXPECT_EQ(recipes[0].axes, (std::array{true, false}));
  EXPECT_EQ(recipes[1].axes, (std::array{false, true}));
  for (const HaltRecipe& recipe : recipes) {
    EXPECT_EQ(recipe.stop,
              "\x18"
              "1 STP\n4 STP\n")
        << "each stops both";
    EXPECT_EQ(recipe.questions.size(), 2U);
  }
}

TEST_F(PiGcsStageTest, AReplyOfTheOtherControllerIsNoAnswer) {
  controller_.replies = replies_of_a_chain(controller_.replies);
  connect({.axis_names = {"1 1", "4 1"}, .speed_deg_per_s = {}, .address = {}, .unit = {}});
  stage_->identify();
  controller_.mishaps["1 POS? 1"] = {{.instead = "0 4 1=-7.5\n", .late = {}}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5) << "asked again";
  controller_.replies["1 POS? 1"] = "0 4 1=-7.5\n";
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kBadFrame);
}

TEST_F(PiGcsStageTest, WhatOneControllerOfAChainSaysOfAHaltIsHeardWhereTheOtherOneIsSilent) {
  const std::map<std::string, std::string> chained = replies_of_a_chain(controller_.replies);
  controller_.replies = chained;
  connect({.axis_names = {"1 1", "4 1"}, .speed_deg_per_s = {}, .address = {}, .unit = {}});
  stage_->identify();
  for (const std::string silent : {"1 ", "4 "}) {
    controller_.replies = chained;
    for (const auto& [command, reply] : chained)
      if (command.starts_with(silent)) controller_.replies.erase(command);
    controller_.replies[silent == "1 " ? "4 ERR?" : "1 ERR?"] = silent == "1 " ? "0 4 10\n" : "0 1 10\n";
    const Clock::Instant before = clock_.now();
    const HaltReport report = stage_->halt_axes();
    EXPECT_EQ(report.axes[0], silent == "1 " ? AxisHalt::kUnreachable : AxisHalt::kHalted) << silent;
    EXPECT_EQ(report.axes[1], silent == "4 " ? AxisHalt::kUnreachable : AxisHalt::kHalted) << silent;
    EXPECT_LE(clock_.now() - before, kHaltDeadline);
  }
}

TEST_F(PiGcsStageTest, TheLineIsAskedForTheAxesOfAllItsControllers) {
  const std::map<std::string, std::string> one = controller_.replies;
  controller_.replies = replies_of_a_chain(one);
  controller_.replies["4 SAI?"] = "0 4 A \nB\n";
  auto line = std::make_unique<ScriptedController>(clock_);
  line->replies = controller_.replies;
  EXPECT_THAT(axes_on_line(std::move(line), clock_),
              ::testing::ElementsAre("1 1", "1 2", "1 3", "4 A", "4 B"));
  // One alone, which knows no addresses.
  EXPECT_THAT(axes_on_line(std::make_unique<ScriptedController>(clock_), clock_),
              ::testing::ElementsAre("1", "2", "3"));
  line = std::make_unique<ScriptedController>(clock_);
  line->silent = true;
  const Clock::Instant before = clock_.now();
  EXPECT_THAT(axes_on_line(std::move(line), clock_), ::testing::IsEmpty());
  EXPECT_LE(clock_.now() - before, 16 * kAddressDeadline + 600ms);
}

TEST_F(PiGcsStageTest, AControllerOfAChainThatIsSilentIsNamedByItsAddress) {
  std::map<std::string, std::string> chained;
  for (const auto& [command, reply] : controller_.replies) {
    if (command.size() > 1) chained["1 " + command] = "0 1 " + reply;
  }
  chained["1 ERR?"] = "0 1 0\n";
  controller_.replies = chained;
  connect({.axis_names = {"1 1", "4 1"}, .speed_deg_per_s = {}, .address = {}, .unit = {}});
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kNoReply);
  EXPECT_THAT(error.what(), HasSubstr("\"4 *IDN?\""));
}

TEST_F(PiGcsStageTest, WhatIsNotInTheControllersListIsNotAskedOfIt) {
  controller_.replies["HLP?"] =
      "The following commands are valid: \n#4 Request Status Register \n#24 Stop All Axes \n"
      "*IDN? Get Device Identification \nERR? Get Error Number \nFRF {<AxisID>} Reference \n"
      "FRF? Get Referencing Result \nMOV {<AxisID> <Position>} Set Target \nPOS? Get Position \n"
      "PUN? Get Unit \nSAI? Get Axes \nSVO Set Servo \nSVO? Get Servo \nTMN? Min \nTMX? Max \n"
      "TRS? Reference Switch \nend of help\n";
  controller_.replies["\x04"] = "0x100050001000\n";
  connect();
  stage_->identify();
  stage_->home(StageAxis::kX);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kMoving);
  for (const char* unknown : {"EAX 1 1", "\x05", "CST? 1", "VEL? 1", "SPA? 1 14"})
    EXPECT_EQ(controller_.count(unknown), 0U) << unknown;
  EXPECT_EQ(controller_.count("FRF 1"), 1U);
}

// ---- Halt

TEST_F(PiGcsStageTest, HaltIsAcknowledgedByTheErrorCode) {
  connect();
  stage_->identify();
  controller_.replies["\x05"] = "3\n";
  EXPECT_TRUE(stage_->halt());
  EXPECT_GE(controller_.count("\x18"), 1U);
  controller_.replies["\x05"] = "0\n";
  EXPECT_NO_THROW(stage_->move_to(StageAxis::kX, Angle::degrees(1.0))) << "error 10 must not be left over";
}

TEST_F(PiGcsStageTest, HaltIsAcknowledgedByStandstill) {
  controller_.stop_acknowledged_by = "mask";
  connect();
  stage_->identify();
  EXPECT_TRUE(stage_->halt());
}

TEST_F(PiGcsStageTest, TheErrorOfAHaltIsNotTheAnswerToTheNextCommand) {
  connect();
  stage_->identify();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  EXPECT_TRUE(stage_->halt());
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  // A stop that was repeated on a slow line takes effect, and leaves its error, only now.
  controller_.mishaps["ERR?"] = {{.instead = "10\n", .late = {}}};
  EXPECT_NO_THROW(stage_->move_to(StageAxis::kX, Angle::degrees(2.0)));
  EXPECT_EQ(controller_.count("MOV 1 2.000000"), 1U);
  // It is not the reason for an unanswered query, either.
  controller_.mishaps["POS? 1"] = {{.instead = "", .late = {}}};
  controller_.mishaps["ERR?"] = {{.instead = "10\n", .late = {}}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(PiGcsStageTest, HaltThatChangesNothingIsNotAcknowledged) {
  controller_.stop_acknowledged_by = "nothing";
  connect();
  stage_->identify();
  const Clock::Instant before = clock_.now();
  EXPECT_FALSE(stage_->halt());
  EXPECT_LE(clock_.now() - before, kHaltDeadline);
  EXPECT_GT(controller_.count("\x18"), 2U) << "it is tried again";
}

TEST_F(PiGcsStageTest, HaltOfASilentControllerIsNotAcknowledgedInTime) {
  connect();
  stage_->identify();
  controller_.silent = true;
  const Clock::Instant before = clock_.now();
  EXPECT_FALSE(stage_->halt());
  EXPECT_LE(clock_.now() - before, kHaltDeadline);
}

TEST_F(PiGcsStageTest, HaltSurvivesALostReply) {
  connect();
  stage_->identify();
  controller_.mishaps["ERR?"] = {{.instead = "", .late = {}}};
  EXPECT_TRUE(stage_->halt());
}

TEST_F(PiGcsStageTest, HaltWorksBeforeAnythingWasAsked) {
  connect();
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(controller_.commands().front(), "\x18") << "it stops first and asks afterwards";
}

TEST_F(PiGcsStageTest, HaltDoesNotWaitForAQueryUnderWay) {
  connect();
  stage_->identify();
  controller_.held_until_stop = "POS? 1";  // The owner is held in its query until the stop is written.
  auto owner = std::async(std::launch::async, [&] { return stage_->encoder_angle(StageAxis::kX).deg(); });
  controller_.await_hold();
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(owner.get(), 14.5);  // Its own reply.
}

TEST_F(PiGcsStageTest, AnOwnerWhoseReplyIsLostInAHaltGetsAnErrorAndSendsNothingMore) {
  connect();
  stage_->identify();
  controller_.held_until_stop = "POS? 1";
  controller_.mishaps["POS? 1"] = {{.instead = "", .late = {}}};
  auto owner = std::async(std::launch::async,
                          [&] { return error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(); });
  controller_.await_hold();
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(owner.get(), Fault::kNotReady);
  EXPECT_EQ(controller_.count("POS? 1"), 1U);
}

TEST_F(PiGcsStageTest, AMoveThatIsHaltedWhileItIsSentIsNotReportedAsAccepted) {
  connect();
  stage_->identify();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  controller_.held_until_stop = "MOV 1 50.000000";
  controller_.mishaps["ERR?"] = {{.instead = "10\n", .late = {}}};
  auto owner = std::async(std::launch::async, [&] {
    return error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(50.0)); });
  });
  controller_.await_hold();
  EXPECT_TRUE(stage_->halt());
  const InstrumentError error = owner.get();
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(), HasSubstr("error 10 (stopped by command)"));
  EXPECT_GE(controller_.count("\x18"), 2U) << "the stop is repeated after the move";
}

TEST_F(PiGcsStageTest, ItsRecipeTellsStandingAxesFromMovingOnesAndFromOtherReplies) {
  using enum test::Verdict;
  connect();
  const HaltRecipe recipe = stage_->halt_recipes().at(0);
  ASSERT_EQ(recipe.questions.size(), 2U);
  test::expect_verdicts(
      recipe, recipe.questions[0],
      {{"(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 123456, 1.2.3", kStanding},
       {"(c)2013 Physik Instrumente(PI) Karlsruhe, E-861 Version 7.2.0", kStanding},
       {"Physik Instrumente", kStanding},
       {"0 2 (c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-863.12, 777, 1.2.3 ", kStanding},
       {"", kOther},
       {"0", kOther},
       {"1=89.9998", kOther},
       {"(c)2013 physik instrumente", kOther},
       {"(c)2013 Physik  Instrumente", kOther},
       {"(c)2013 Physik Instrument", kOther},
       {"Keysight Technologies,34465A,MY54500001,A.02.14", kOther}});
  test::expect_verdicts(
      recipe, recipe.questions[1],
      {{"0", kStanding},
       {"00", kStanding},
       {"00000000", kStanding},
       {"1", kMoving},
       {"2", kMoving},
       {"3", kMoving},
       {"a", kMoving},
       {"F", kMoving},
       {"10", kMoving},
       {"01", kMoving},
       {"00000100", kMoving},
       {"", kOther},
       {" 0", kOther},
       {"0 ", kOther},
       {"0x0", kOther},
       {"g", kOther},
       {"-0", kOther},
       {"0.0", kOther},
       {"0 1 0", kOther},
       {"1=0", kOther},
       {"1=89.9998", kOther},
       {"(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 123456, 1.2.3", kOther}});
}

TEST_F(PiGcsStageTest, ARecipeOfAChainTakesRepliesOfItsControllerOnly) {
  using enum test::Verdict;
  connect({.axis_names = {"1 1", "4 1"}, .speed_deg_per_s = {}, .address = {}, .unit = {}});
  const std::vector<HaltRecipe> recipes = stage_->halt_recipes();
  ASSERT_EQ(recipes.size(), 2U);
  const std::string identity = "(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-863.12, 777, 1.2.3";
  for (const std::size_t member : {0U, 1U}) {
    const std::string own = member == 0 ? "0 1 " : "0 4 ", other = member == 0 ? "0 4 " : "0 1 ";
    test::expect_verdicts(recipes[member], recipes[member].questions[0],
                          {{own + identity, kStanding},
                           {own + "Physik Instrumente", kStanding},
                           {other + identity, kOther},
                           {identity, kOther},
                           {own, kOther},
                           {own + "0", kOther},
                           {"0" + own + identity, kOther}});
    test::expect_verdicts(recipes[member], recipes[member].questions[1],
                          {{own + "0", kStanding},
                           {own + "0000", kStanding},
                           {own + "1", kMoving},
                           {own + "a0", kMoving},
                           {other + "0", kOther},
                           {"0", kOther},
                           {"1", kOther},
                           {own, kOther},
                           {own + " 0", kOther},
                           {own + "0 ", kOther},
                           {own + "1=0", kOther},
                           {own + identity, kOther}});
  }
}

}  // namespace
}  // namespace abcal::pi_gcs
