#include "drivers/newport_esp/stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <limits>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "tests/drivers/reply_verdicts.h"
#include "tests/support/error_of.h"
#include "tests/support/scripted_line.h"

namespace abcal::newport_esp {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// An ESP controller as a table: queries in `replies` are answered, all else is silent; a command in `errors`
/// puts its code into the error buffer, and a query that is not in the table code 6.
class NewportEspStageTest : public ::testing::Test {
 protected:
  NewportEspStageTest() {
    replies_["VE?"] = "ESP301 Version 3.0.1 6/1/99\r\n";
    for (const std::string axis : {"1", "2"}) {
      replies_[axis + "ID?"] = "URS100BCC, SN1234" + axis + "\r\n";
      replies_[axis + "SN?"] = "7\r\n";
      replies_[axis + "SL?"] = "-170.0\r\n";
      replies_[axis + "SR?"] = "370.5\r\n";
      replies_[axis + "VA?"] = "20.0\r\n";
      replies_[axis + "SU?"] = "0.0001\r\n";
      replies_[axis + "MO?"] = "1\r\n";
      replies_[axis + "MD?"] = "1\r\n";
      replies_[axis + "TP?"] = "14.50000\r\n";
    }
  }

  std::string answer(const std::string& command) {
    if (command == "TB?") {
      time_stamp_ += 2;
      int code = 0;
      if (!buffer_.empty()) {
        code = buffer_.front();
        buffer_.pop_front();
      }
      return std::to_string(code) + ", " + std::to_string(time_stamp_) +
             (code == 0 ? ", NO ERROR DETECTED\r\n" : ", ERROR\r\n");
    }
    if (const auto error = errors_.find(command); error != errors_.end()) {
      buffer_.push_back(error->second);
      return {};
    }
    if (const auto reply = replies_.find(command); reply != replies_.end()) return reply->second;
    if (command.ends_with('?')) buffer_.push_back(6);
    return {};
  }

  void connect(const StageSettings& settings = {}) {
    stage_ = std::make_unique<NewportEspStage>(std::unique_ptr<wire::ByteStream>(owned_.release()), clock_,
                                               settings);
  }
  void connect_and_home() {
    connect();
    stage_->identify();
    for (const StageAxis axis : kStageAxes) {
      stage_->home(axis);
      EXPECT_EQ(stage_->motion_state(axis), MotionState::kStopped);
    }
  }

  std::map<std::string, std::string> replies_;
  std::map<std::string, int> errors_;
  std::deque<int> buffer_;
  unsigned time_stamp_ = 87498345;
  test::FakeClock clock_;
  std::unique_ptr<test::ScriptedLine> owned_ =
      std::make_unique<test::ScriptedLine>(clock_, '\r', [this](const std::string& c) { return answer(c); });
  test::ScriptedLine& line_ = *owned_;
  std::unique_ptr<NewportEspStage> stage_;
};

TEST_F(NewportEspStageTest, IdentifiesControllerAndAxesAndChangesNothing) {
  connect();
  const StageInfo info = stage_->identify();
  EXPECT_EQ(info.model, "ESP301");
  EXPECT_EQ(info.firmware, "3.0.1 6/1/99");
  EXPECT_EQ(info.serial_number, "12341/12342");
  for (const StageAxisInfo& axis : info.axes) {
    EXPECT_EQ(axis.stage_name, "URS100BCC");
    EXPECT_EQ(axis.travel_min.deg(), -170.0);
    EXPECT_EQ(axis.travel_max.deg(), 370.5);
    EXPECT_EQ(axis.resolution.deg(), 1e-4);
    EXPECT_EQ(axis.speed_deg_per_s, 20.0);
    EXPECT_FALSE(axis.referenced) << "the controller cannot say, so nobody knows";
  }
  for (const std::string& command : line_.commands()) EXPECT_TRUE(command.ends_with('?')) << command;
}

TEST_F(NewportEspStageTest, HomesMovesAndReads) {
  connect();
  stage_->identify();
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(5.0)); }).fault(), Fault::kNotReady);
  EXPECT_EQ(line_.count("1PA5.000000"), 0U);
  replies_["1MO?"] = "0\r\n";
  stage_->home(StageAxis::kX);
  EXPECT_EQ(line_.count("1MO"), 1U);
  EXPECT_EQ(line_.count("1OR"), 1U);
  replies_["1MD?"] = "0\r\n";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_FALSE(stage_->identify().axes[0].referenced);
  replies_["1MD?"] = "1\r\n";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  const StageInfo info = stage_->identify();
  EXPECT_TRUE(info.axes[0].referenced);
  EXPECT_FALSE(info.axes[1].referenced);
  stage_->move_to(StageAxis::kX, Angle::degrees(5.0));
  EXPECT_EQ(line_.count("1PA5.000000"), 1U);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(NewportEspStageTest, RepliesMayComeByteByByteAndEndWithCarriageReturnAlone) {
  line_.byte_by_byte = true;
  connect();
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 370.5);
  for (auto& [query, reply] : replies_) reply.pop_back();
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 370.5);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kZ).deg(), 14.5);
}

TEST_F(NewportEspStageTest, TheSpeedOfTheBenchFileIsSetOnce) {
  connect({.axis_names = {"1", "2"}, .speed_deg_per_s = {10.0, std::nullopt}, .address = {}});
  EXPECT_EQ(stage_->identify().axes[0].speed_deg_per_s, 10.0);
  stage_->home(StageAxis::kX);
  stage_->motion_state(StageAxis::kX);
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  stage_->move_to(StageAxis::kX, Angle::degrees(2.0));
  EXPECT_EQ(line_.count("1VA10.000000"), 1U);
  EXPECT_EQ(line_.count("2VA10.000000"), 0U);
}

TEST_F(NewportEspStageTest, OldErrorsAreNotLaidAtANewCommandsDoor) {
  buffer_ = {6, 113, 37};
  connect_and_home();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
}

TEST_F(NewportEspStageTest, UnsolicitedLinesAreSkipped) {
  connect_and_home();
  line_.mishaps["1TP?"] = {{.before = "E38\r\n"}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
  EXPECT_EQ(line_.count("1TP?"), 1U);
}

TEST_F(NewportEspStageTest, AnotherInstrumentOnThePortIsNamed) {
  replies_["VE?"] = "Keysight Technologies,34465A,MY54500001,A.02.14\n";
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("Keysight"), HasSubstr("ESP controller")));
}

TEST_F(NewportEspStageTest, AnAbsentAxisIsNamed) {
  replies_.erase("2SN?");
  errors_["2SN?"] = 9;
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("no axis 2 (for Z)"), HasSubstr("error 9")));
}

TEST_F(NewportEspStageTest, AUnitOtherThanDegreesIsRefused) {
  replies_["2SN?"] = "9\r\n";
  connect();
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("unit of axis 2 is rad"), HasSubstr("2SN7")));
}

TEST_F(NewportEspStageTest, SettingsThatCannotBeMeantAreRefused) {
  const auto with = [&](const StageSettings& settings) {
    return std::make_unique<NewportEspStage>(
        std::make_unique<test::ScriptedLine>(clock_, '\r', [](const std::string&) { return std::string(); }),
        clock_, settings);
  };
  StageSettings settings;
  for (const auto& names :
       {std::array<std::string, 2>{"1", "1"}, {"", ""}, {"1;2PA0", "2"}, {"7", "2"}, {"0", ""}}) {
    settings.axis_names = names;
    EXPECT_THROW(with(settings), std::invalid_argument) << names[0];
  }
  settings = {};
  settings.speed_deg_per_s[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings = {};
  settings.address = "2";
  EXPECT_THROW(with(settings), std::invalid_argument);
}

TEST_F(NewportEspStageTest, AnAxisOnAnotherControllerIsNotThisOnes) {
  connect({.axis_names = {"1", ""}, .speed_deg_per_s = {}, .address = {}});
  EXPECT_EQ(stage_->identify().axes[0].stage_name, "URS100BCC");
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kZ); }).fault(), Fault::kNotReady);
  EXPECT_TRUE(stage_->halt());
}

TEST_F(NewportEspStageTest, ARefusedMoveSaysWhy) {
  connect_and_home();
  errors_["1PA300.000000"] = 106;
  InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(300.0)); });
  EXPECT_EQ(error.fault(), Fault::kOutOfTravel);
  EXPECT_THAT(error.what(), HasSubstr("error 106 (axis 1: positive software limit) to \"1PA300.000000\""));
  errors_["1PA1.000000"] = 113;
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNotReady);
  errors_["1PA2.000000"] = 4;
  error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(2.0)); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(), HasSubstr("emergency stop"));
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(std::nan(""))); }).fault(),
            Fault::kOutOfTravel);
}

TEST_F(NewportEspStageTest, AMotionThatAFaultHasEndedIsNotDone) {
  connect_and_home();
  stage_->move_to(StageAxis::kX, Angle::degrees(90.0));
  buffer_ = {103};
  const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(), HasSubstr("following error"));
}

TEST_F(NewportEspStageTest, AnErrorOfOneAxisIsNotTheAnswerToACommandToTheOther) {
  connect_and_home();
  stage_->move_to(StageAxis::kX, Angle::degrees(90.0));
  buffer_ = {103};
  EXPECT_NO_THROW(stage_->move_to(StageAxis::kZ, Angle::degrees(10.0)));
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kStopped);
  EXPECT_THAT(error_of([&] { stage_->motion_state(StageAxis::kX); }).what(), HasSubstr("following error"));
  // It is not the reason for an unanswered query, either.
  stage_->move_to(StageAxis::kX, Angle::degrees(80.0));
  line_.mishaps["2TP?"] = {{.instead = ""}};
  buffer_ = {103};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kZ).deg(), 14.5);
  EXPECT_THAT(error_of([&] { stage_->motion_state(StageAxis::kX); }).what(), HasSubstr("following error"));
}

TEST_F(NewportEspStageTest, AHomingThatFailsLeavesNoReference) {
  connect();
  stage_->identify();
  stage_->home(StageAxis::kX);
  buffer_ = {120};
  EXPECT_THAT(error_of([&] { stage_->motion_state(StageAxis::kX); }).what(), HasSubstr("homing aborted"));
  EXPECT_FALSE(stage_->identify().axes[0].referenced);
}

TEST_F(NewportEspStageTest, AControllerThatWasSwitchedOffHasLostItsReference) {
  connect_and_home();
  time_stamp_ = 100;
  const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.what(), HasSubstr("switched off and on"));
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNotReady);
  EXPECT_FALSE(stage_->identify().axes[0].referenced);
}

TEST_F(NewportEspStageTest, ARestartSeenByIdentifyIsNoError) {
  connect_and_home();
  time_stamp_ = 100;
  EXPECT_FALSE(stage_->identify().axes[0].referenced);
}

// ---- Silence, garbage, late replies

TEST_F(NewportEspStageTest, ASilentPortSaysWhatToCheck) {
  line_.silent = true;
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kNoReply);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("VE?"), HasSubstr("19200"), HasSubstr("RTS/CTS")));
}

TEST_F(NewportEspStageTest, SilenceIsNeverStopped) {
  connect_and_home();
  line_.silent = true;
  const Clock::Instant before = clock_.now();
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kX); }).fault(), Fault::kNoReply);
  EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline);
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNoReply);
  EXPECT_EQ(line_.count("1PA1.000000"), 0U) << "no move is sent to a controller that does not answer";
}

TEST_F(NewportEspStageTest, TheSilenceAfterALimitIsWaitedOut) {
  connect_and_home();
  line_.mishaps["1MD?"] = {{.late = 5s}};
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(NewportEspStageTest, ALateReplyIsTheAnswerToItsOwnQueryOnly) {
  connect_and_home();
  line_.mishaps["1TP?"] = {{.instead = "10.0\r\n", .late = 7s}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 10.0);  // In time for the resynchronisation.
  EXPECT_EQ(line_.count("1TP?"), 1U);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(NewportEspStageTest, AVeryLateReplyIsNotTheAnswerToTheNextQuery) {
  connect_and_home();
  line_.mishaps["1TP?"] = {{.instead = "10.0\r\n", .late = 13s}};
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kNoReply);
  replies_["1TP?"] = "20.0\r\n";
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 20.0);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 20.0);
}

TEST_F(NewportEspStageTest, HalfAReplyIsNotJoinedToTheNext) {
  connect_and_home();
  line_.mishaps["1TP?"] = {{.instead = "1"}};
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kX).deg(), 14.5);
}

TEST_F(NewportEspStageTest, GarbageIsAskedAgainAndThenABadFrame) {
  connect_and_home();
  line_.mishaps["1MD?"] = {{.instead = "\xFF\x80\r\n"}};
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  replies_["1MD?"] = "\xFF\x80\r\n";
  const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kBadFrame);
  EXPECT_THAT(error.what(), HasSubstr("\\xff\\x80"));
}

TEST_F(NewportEspStageTest, GarbageWithoutEndDoesNotHoldTheDriver) {
  connect_and_home();
  line_.silent = true;
  for (int i = 1; i < 20000; ++i) line_.say("garbage", i * 1ms);
  const Clock::Instant before = clock_.now();
  EXPECT_THROW(stage_->encoder_angle(StageAxis::kX), InstrumentError);
  EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline + 10ms);
}

TEST_F(NewportEspStageTest, AMoveWhoseAcceptanceIsNotKnownIsNotRepeated) {
  connect_and_home();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  line_.mishaps["TB?"] = {{.instead = ""}};
  const InstrumentError lost = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(2.0)); });
  EXPECT_EQ(lost.fault(), Fault::kNoReply);
  EXPECT_THAT(lost.what(), HasSubstr("whether that command was accepted is unknown"));
  EXPECT_EQ(line_.count("1PA2.000000"), 1U);
}

TEST_F(NewportEspStageTest, AnErrorBufferThatNeverEmptiesIsNotReadForEver) {
  connect();
  for (int n = 0; n < 1000; ++n) buffer_.push_back(6);
  EXPECT_EQ(error_of([&] { stage_->identify(); }).fault(), Fault::kBadFrame);
}

TEST_F(NewportEspStageTest, AnUnpluggedPortIsALostLink) {
  connect_and_home();
  line_.unplugged = true;
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kX); }).fault(), Fault::kLinkLost);
  EXPECT_FALSE(stage_->halt());
}

// ---- Halt

TEST_F(NewportEspStageTest, HaltIsAcknowledgedByStandstill) {
  connect_and_home();
  EXPECT_TRUE(stage_->halt());
  EXPECT_GE(line_.count("ST"), 1U);
}

TEST_F(NewportEspStageTest, HaltThatChangesNothingIsNotAcknowledged) {
  connect_and_home();
  replies_["2MD?"] = "0\r\n";
  const Clock::Instant before = clock_.now();
  EXPECT_FALSE(stage_->halt());
  EXPECT_LE(clock_.now() - before, kHaltDeadline);
  EXPECT_GT(line_.count("ST"), 2U) << "it is tried again";
}

TEST_F(NewportEspStageTest, HaltOfASilentControllerIsNotAcknowledgedInTime) {
  connect_and_home();
  line_.silent = true;
  const Clock::Instant before = clock_.now();
  EXPECT_FALSE(stage_->halt());
  EXPECT_LE(clock_.now() - before, kHaltDeadline);
}

TEST_F(NewportEspStageTest, HaltWorksBeforeAnythingWasAsked) {
  connect();
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(line_.commands().front(), "ST") << "it stops first and asks afterwards";
}

TEST_F(NewportEspStageTest, AHomingThatIsHaltedLeavesNoReference) {
  connect();
  stage_->identify();
  stage_->home(StageAxis::kX);
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_FALSE(stage_->identify().axes[0].referenced);
}

TEST_F(NewportEspStageTest, HaltDoesNotWaitForAQueryUnderWay) {
  connect_and_home();
  line_.held_until = "1TP?";  // The owner is held in its query until the stop is written.
  line_.released_by = "ST";
  auto owner = std::async(std::launch::async, [&] { return stage_->encoder_angle(StageAxis::kX).deg(); });
  line_.await_hold();
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(owner.get(), 14.5);  // Its own reply.
}

TEST_F(NewportEspStageTest, ItsRecipeTellsStandingAxesFromMovingOnesAndFromOtherReplies) {
  using enum test::Verdict;
  connect();
  const HaltRecipe recipe = stage_->halt_recipes().at(0);
  ASSERT_EQ(recipe.questions.size(), 3U);
  test::expect_verdicts(recipe, recipe.questions[0],
                        {{"ESP301 Version 3.0.1 6/1/99", kStanding},
                         {"ESP300 Version 3.04 12/10/01", kStanding},
                         {"ESP302", kStanding},
                         {"ESP30", kStanding},
                         {"", kOther},
                         {" ESP301 Version 3.0.1", kOther},
                         {"ESP3", kOther},
                         {"ESP310", kOther},
                         {"esp301 version 3.0.1", kOther},
                         {"URS100BCC, SN12345", kOther},
                         {"0, 450322, NO ERROR DETECTED", kOther},
                         {"1", kOther}});
  for (const std::size_t axis : {1U, 2U})
    test::expect_verdicts(recipe, recipe.questions[axis],
                          {{"1", kStanding},
                           {" 1", kStanding},
                           {"1 ", kStanding},
                           {"   1  ", kStanding},
                           {"0", kMoving},
                           {" 0 ", kMoving},
                           {"", kOther},
                           {" ", kOther},
                           {"2", kOther},
                           {"01", kOther},
                           {"10", kOther},
                           {"11", kOther},
                           {"1 1", kOther},
                           {"1.0", kOther},
                           {"+1", kOther},
                           {"-1", kOther},
                           {"\t1", kOther},
                           {"1\t", kOther},
                           {"12.34500", kOther},
                           {"E35", kOther},
                           {"0, 450322, NO ERROR DETECTED", kOther},
                           {"6, 450333, UNKNOWN COMMAND", kOther},
                           {"ESP301 Version 3.0.1 6/1/99", kOther}});
}

}  // namespace
}  // namespace abcal::newport_esp
