#include "drivers/zaber_ascii/stage.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <future>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "tests/drivers/endless_stream.h"
#include "tests/drivers/reply_verdicts.h"
#include "tests/support/error_of.h"
#include "tests/support/scripted_line.h"

namespace abcal::zaber_ascii {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr double kStepsPerTurn = 384000.0;

/// State that one axis reports.
struct FakeAxis {
  std::string position = "15466";  ///< 14.499375 degrees.
  std::string warnings = "00";
  std::string status = "IDLE";
  std::map<std::string, std::string> rejections;
};

/// The checksum in closed form, not the driver's.
unsigned fake_checksum(std::string_view content) {
  unsigned sum = 0;
  for (const char c : content) sum += static_cast<unsigned char>(c);
  return ((sum ^ 0xFFU) + 1U) & 0xFFU;
}

/// A chain of devices as a table.
class FakeChain {
 public:
  std::map<int, std::vector<FakeAxis>> devices{{1, {FakeAxis{}, FakeAxis{}}}};
  bool checksums = true;
  std::string limit_max = "384000";
  std::map<std::string, std::string> replies;  ///< Replies to queries, in place of the usual ones.
  unsigned damaged = 0;                        ///< Number of replies that come with one bit wrong.
  std::string alert;                           ///< Before every reply.

  /// "1 1 get pos" of "/1 1 05 get pos:CC".
  static std::string name(const std::string& command) {
    const auto words = split(command);
    std::string name = words.device + " " + words.axis;
    if (!words.data.empty()) name += " " + words.data;
    return name;
  }

  std::string answer(const std::string& command) {
    const auto words = split(command);
    std::string all;
    for (auto& [number, axes] : devices) {
      if (words.device != "0" && std::stoi(words.device) != number) continue;
      all += alert + reply(number, axes, words.axis, words.id, words.data);
    }
    return all;
  }

 private:
  struct Words {
    std::string device, axis, id, data;
  };
  static Words split(const std::string& command) {
    EXPECT_EQ(command.at(0), '/') << command;
    EXPECT_EQ(command.at(command.size() - 3), ':') << command;
    const std::string content = command.substr(1, command.size() - 4);
    EXPECT_EQ(command.substr(command.size() - 2), fmt::format("{:02X}", fake_checksum(content))) << command;
    std::istringstream in(content);
    Words words;
    in >> words.device >> words.axis >> std::ws;
    if (std::isdigit(in.peek()) != 0) in >> words.id >> std::ws;
    std::getline(in, words.data);
    return words;
  }

  std::string reply(int device, std::vector<FakeAxis>& axes, const std::string& axis, const std::string& id,
                    const std::string& data) {
    const std::size_t number = std::stoul(axis);
    std::string flag = "--";
    std::string status = "IDLE";
    std::string verdict = "OK";
    std::string text = "0";
    if (number > axes.size()) {
      verdict = "RJ";
      text = "BADAXIS";
    } else {
      FakeAxis& fake = axes[number == 0 ? 0 : number - 1];
      status = fake.status;
      if (fake.warnings.size() > 3) flag = fake.warnings.substr(3, 2);
      const auto said = replies.find(data);
      if (const auto rejected = fake.rejections.find(data); rejected != fake.rejections.end()) {
        verdict = "RJ";
        text = rejected->second;
      } else if (said != replies.end()) {
        text = said->second;
      } else if (data == "get system.axiscount") {
        text = std::to_string(axes.size());
      } else if (data == "get deviceid") {
        text = "50009";
      } else if (data == "get system.serial") {
        text = "7777" + std::to_string(device);
      } else if (data == "get version") {
        text = "7.38";
      } else if (data == "get peripheralid") {
        text = "0";
      } else if (data == "get limit.cycle.dist") {
        text = "384000";
      } else if (data == "get limit.min") {
        text = "0";
      } else if (data == "get limit.max") {
        text = limit_max;
      } else if (data == "get maxspeed") {
        text = "34953";  // 20 deg/s
      } else if (data == "get pos") {
        text = fake.position;
      } else if (data == "warnings") {
        text = fake.warnings;
      } else if (data == "warnings clear") {
        fake.warnings = "00";
        text = "00";
      } else if (data == "driver enable") {
        fake.warnings = "00";
      }
    }
    std::string content = fmt::format("{:02} {} ", device, axis);
    if (!id.empty()) content += fmt::format("{:02} ", std::stoi(id));
    content += fmt::format("{} {} {} {}", verdict, status, flag, text);
    std::string line = "@" + content;
    if (checksums) line += fmt::format(":{:02X}", fake_checksum(content));
    if (damaged > 0) {
      --damaged;
      line[line.size() - 4] = static_cast<char>(line[line.size() - 4] ^ 1);
    }
    return line + "\r\n";
  }
};

class ZaberAsciiStageTest : public ::testing::Test {
 protected:
  void connect(const StageSettings& settings = {}) {
    stage_ = std::make_unique<ZaberAsciiStage>(std::unique_ptr<wire::ByteStream>(owned_.release()), clock_,
                                               settings);
  }

  FakeAxis& x() { return chain_.devices[1][0]; }

  FakeChain chain_;
  test::FakeClock clock_;
  std::unique_ptr<test::ScriptedLine> owned_ = std::make_unique<test::ScriptedLine>(
      clock_, '\n', [this](const std::string& c) { return chain_.answer(c); }, &FakeChain::name);
  test::ScriptedLine& line_ = *owned_;
  std::unique_ptr<ZaberAsciiStage> stage_;
};

TEST_F(ZaberAsciiStageTest, IdentifiesATwoAxisControllerAndChangesNothing) {
  connect();
  const StageInfo info = stage_->identify();
  EXPECT_EQ(info.maker, "Zaber");
  EXPECT_EQ(info.model, "X-RSW60A-E03");
  EXPECT_EQ(info.serial_number, "77771");
  EXPECT_EQ(info.firmware, "7.38");
  for (const StageAxisInfo& axis : info.axes) {
    EXPECT_EQ(axis.travel_min.deg(), 0.0);
    EXPECT_EQ(axis.travel_max.deg(), 360.0);
    EXPECT_EQ(axis.resolution.deg(), 360.0 / kStepsPerTurn);
    EXPECT_NEAR(axis.speed_deg_per_s, 20.0, 1e-3);  // 34953 is rounded: 1/34953 of 20 is 6e-4
    EXPECT_TRUE(axis.referenced);
  }
  for (const std::string& command : line_.commands())
    EXPECT_TRUE(command.find("get ") != std::string::npos || command.ends_with("warnings")) << command;
}

TEST_F(ZaberAsciiStageTest, FindsSingleAxisDevicesInADaisyChain) {
  chain_.devices = {{1, {FakeAxis{}}}, {2, {FakeAxis{}}}};
  chain_.devices[2][0].position = "384000";
  connect();
  const StageInfo info = stage_->identify();
  EXPECT_EQ(info.serial_number, "77771/77772");
  EXPECT_NEAR(stage_->encoder_angle(StageAxis::kX).deg(), 14.499375, 1e-9);
  EXPECT_EQ(stage_->encoder_angle(StageAxis::kZ).deg(), 360.0);
  EXPECT_EQ(line_.count("2 1 get pos"), 1U);
}

TEST_F(ZaberAsciiStageTest, AxesMayBeNamedInFull) {
  chain_.devices = {{1, {FakeAxis{}, FakeAxis{}}}, {4, {FakeAxis{}}}};
  connect({.axis_names = {"4 1", "1 2"}, .speed_deg_per_s = {}, .address = {}});
  stage_->encoder_angle(StageAxis::kX);
  stage_->encoder_angle(StageAxis::kZ);
  EXPECT_EQ(line_.count("4 1 get pos"), 1U);
  EXPECT_EQ(line_.count("1 2 get pos"), 1U);
}

TEST_F(ZaberAsciiStageTest, AnAddressMakesNumbersAxesOfThatDevice) {
  chain_.devices = {{1, {FakeAxis{}}}, {3, {FakeAxis{}, FakeAxis{}}}};
  connect({.axis_names = {"1", "2"}, .speed_deg_per_s = {}, .address = "3"});
  stage_->encoder_angle(StageAxis::kZ);
  EXPECT_EQ(line_.count("3 2 get pos"), 1U);
}

TEST_F(ZaberAsciiStageTest, ANameThatCanBeMeantInTwoWaysIsRefused) {
  chain_.devices = {{1, {FakeAxis{}, FakeAxis{}}}, {2, {FakeAxis{}}}};
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("is ambiguous"), HasSubstr("\"1 1\", \"1 2\", \"2 1\"")));
}

TEST_F(ZaberAsciiStageTest, AnAbsentAxisIsNamedWithThoseThatThereAre) {
  connect({.axis_names = {"1", "3"}, .speed_deg_per_s = {}, .address = {}});
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("no axis \"3\" (for Z)"), HasSubstr("\"1 1\", \"1 2\"")));
}

TEST_F(ZaberAsciiStageTest, AnAxisThatDoesNotRotateIsRefused) {
  chain_.devices[1][1].rejections["get limit.cycle.dist"] = "BADCOMMAND";
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
  EXPECT_THAT(error.what(), HasSubstr("not a rotary axis"));
}

TEST_F(ZaberAsciiStageTest, SettingsThatCannotBeMeantAreRefused) {
  const auto with = [&](const StageSettings& settings) {
    return std::make_unique<ZaberAsciiStage>(
        std::make_unique<test::ScriptedLine>(clock_, '\n', [](const std::string&) { return std::string(); }),
        clock_, settings);
  };
  StageSettings settings;
  for (const auto& names : {std::array<std::string, 2>{"1", "1"},
                            {"", ""},
                            {"1 2 3", "2"},
                            {"x", "2"},
                            {"0", "1"},
                            {"1 0", "1"},
                            {"1  2", "1"},
                            {"100", "1"}}) {
    settings.axis_names = names;
    EXPECT_THROW(with(settings), std::invalid_argument) << names[0];
  }
  settings = {};
  settings.speed_deg_per_s[1] = -1.0;
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings = {};
  settings.address = "100";
  EXPECT_THROW(with(settings), std::invalid_argument);
  settings.address = "2";
  settings.axis_names = {"1 1", "1 2"};
  EXPECT_THROW(with(settings), std::invalid_argument);
}

TEST_F(ZaberAsciiStageTest, AnAxisOnAnotherLineIsNotThisOnes) {
  connect({.axis_names = {"", "2"}, .speed_deg_per_s = {}, .address = {}});
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 360.0);
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kX); }).fault(), Fault::kNotReady);
  EXPECT_TRUE(stage_->halt());
}

TEST_F(ZaberAsciiStageTest, MovesInStepsAndTellsMovingFromStopped) {
  connect();
  stage_->move_to(StageAxis::kX, Angle::degrees(90.0));
  EXPECT_EQ(line_.count("1 1 move abs 96000"), 1U);
  x().status = "BUSY";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kStopped);
  x().status = "IDLE";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(ZaberAsciiStageTest, TheSpeedOfTheBenchFileIsWrittenOnlyWhereItIsAnotherOne) {
  connect({.axis_names = {"1", "2"}, .speed_deg_per_s = {10.0, 20.0}, .address = {}});
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  stage_->move_to(StageAxis::kX, Angle::degrees(2.0));
  stage_->move_to(StageAxis::kZ, Angle::degrees(2.0));
  EXPECT_EQ(line_.count("1 1 set maxspeed 17476"), 1U);  // 10 deg/s * 384000/360 * 1.6384
  for (const std::string& command : line_.commands()) EXPECT_EQ(command.find("1 2 set"), std::string::npos);
}

TEST_F(ZaberAsciiStageTest, ATargetOutsideTheLimitsIsNotSent) {
  connect();
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(-5.0)); });
  EXPECT_EQ(error.fault(), Fault::kOutOfTravel);
  EXPECT_THAT(error.what(), HasSubstr("0.000000 to 360.000000 deg"));
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(std::nan(""))); }).fault(),
            Fault::kOutOfTravel);
  for (const std::string& command : line_.commands()) EXPECT_EQ(command.find("move"), std::string::npos);
}

TEST_F(ZaberAsciiStageTest, ARejectionIsToldInWords) {
  x().rejections["move abs 96000"] = "PARKED";
  connect();
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(90.0)); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(),
              AllOf(HasSubstr("PARKED"), HasSubstr("the axis is parked"), HasSubstr("move abs 96000")));
}

// ---- Warning flags

TEST_F(ZaberAsciiStageTest, AnAxisWithoutReferenceIsHomedFirst) {
  x().warnings = "02 WR NU";
  connect();
  EXPECT_FALSE(stage_->identify().axes[0].referenced);
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.what(), HasSubstr("WR (no reference position); home it"));
  stage_->home(StageAxis::kX);
  EXPECT_EQ(line_.count("1 1 home"), 1U);
  EXPECT_TRUE(stage_->identify().axes[0].referenced);
}

TEST_F(ZaberAsciiStageTest, AFaultStopsEveryCall) {
  connect();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  x().warnings = "01 FS";
  const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.what(), HasSubstr("FS (stalled and stopped)"));
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kRefused);
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kRefused);
  EXPECT_FALSE(stage_->identify().axes[0].referenced) << "a stall loses steps";
  EXPECT_EQ(stage_->motion_state(StageAxis::kZ), MotionState::kStopped);
}

TEST_F(ZaberAsciiStageTest, ADriverThatIsOffIsEnabledOnce) {
  x().warnings = "01 FD";
  connect();
  stage_->home(StageAxis::kX);
  EXPECT_EQ(line_.count("1 1 driver enable"), 1U);
}

TEST_F(ZaberAsciiStageTest, AMotionThatSomethingElseEndedIsNotDone) {
  connect();
  for (const std::string flag : {"NI", "NC", "WL", "WM"}) {
    stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
    x().warnings = "02 WT " + flag;
    const InstrumentError error = error_of([&] { stage_->motion_state(StageAxis::kX); });
    EXPECT_EQ(error.fault(), Fault::kRefused);
    EXPECT_THAT(error.what(), HasSubstr(flag + " ("));
  }
}

TEST_F(ZaberAsciiStageTest, AWarningThatChangesNothingIsNoFault) {
  connect();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  x().warnings = "01 WT";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(ZaberAsciiStageTest, OldWarningsAreNotLaidAtANewMovesDoor) {
  x().warnings = "01 NC";
  connect();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(ZaberAsciiStageTest, OurOwnHaltIsNoSurprise) {
  connect();
  stage_->move_to(StageAxis::kX, Angle::degrees(1.0));
  EXPECT_TRUE(stage_->halt());
  x().warnings = "01 NI";
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

// ---- Silence, garbage, late replies

TEST_F(ZaberAsciiStageTest, AlertsAndInfosAreSkipped) {
  chain_.alert = "!01 1 IDLE --\r\n#01 0 somebody speaks\r\n!02 1 BUSY FS\r\n";
  connect();
  EXPECT_EQ(stage_->identify().axes[0].travel_max.deg(), 360.0);
  EXPECT_EQ(stage_->motion_state(StageAxis::kX), MotionState::kStopped);
}

TEST_F(ZaberAsciiStageTest, RepliesMayComeByteByByte) {
  line_.byte_by_byte = true;
  connect();
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 360.0);
}

TEST_F(ZaberAsciiStageTest, ADeviceWithoutChecksumsIsServedToo) {
  chain_.checksums = false;
  connect();
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 360.0);
}

TEST_F(ZaberAsciiStageTest, OnceChecksumsAreSeenAReplyWithoutOneIsDamaged) {
  connect();
  stage_->identify();
  chain_.checksums = false;
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kBadFrame);
}

TEST_F(ZaberAsciiStageTest, ADamagedReplyIsAskedForOnceMore) {
  connect();
  stage_->identify();
  chain_.damaged = 1;
  EXPECT_NEAR(stage_->encoder_angle(StageAxis::kX).deg(), 14.499375, 1e-9);
  EXPECT_EQ(line_.count("1 1 get pos"), 2U);
  chain_.damaged = 2;
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kBadFrame);
}

TEST_F(ZaberAsciiStageTest, ADamagedFirstAnswerHidesNobody) {
  chain_.damaged = 1;
  connect();
  EXPECT_EQ(stage_->identify().axes[1].travel_max.deg(), 360.0);
}

TEST_F(ZaberAsciiStageTest, ASilentPortSaysWhatToCheck) {
  line_.silent = true;
  connect();
  const InstrumentError error = error_of([&] { stage_->identify(); });
  EXPECT_EQ(error.fault(), Fault::kNoReply);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("ASCII"), HasSubstr("115200")));
}

TEST_F(ZaberAsciiStageTest, AStreamOfForeignBytesIsAnotherInstrument) {
  line_.silent = true;
  for (int i = 1; i < 1000; ++i) line_.say("\x75\x65\x80\x1c\x0a", i * 10ms);
  connect();
  EXPECT_EQ(error_of([&] { stage_->identify(); }).fault(), Fault::kWrongIdentity);
}

TEST_F(ZaberAsciiStageTest, SilenceIsNeverStopped) {
  connect();
  stage_->identify();
  line_.silent = true;
  const Clock::Instant before = clock_.now();
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kX); }).fault(), Fault::kNoReply);
  EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline);
  EXPECT_EQ(error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNoReply);
  for (const std::string& command : line_.commands()) EXPECT_EQ(command.find("move"), std::string::npos);
}

TEST_F(ZaberAsciiStageTest, ALateReplyIsNeverTheAnswerToAnotherQuery) {
  connect();
  stage_->identify();
  line_.mishaps["1 1 get pos"] = {{.late = 1500ms}};
  x().position = "1000";
  EXPECT_NEAR(stage_->encoder_angle(StageAxis::kX).deg(), 1000 * 360.0 / kStepsPerTurn, 1e-9);
  x().position = "2000";
  EXPECT_NEAR(stage_->encoder_angle(StageAxis::kX).deg(), 2000 * 360.0 / kStepsPerTurn, 1e-9);
  line_.mishaps["1 1 get pos"] = {{.late = 2500ms}, {.late = 2500ms}};
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kNoReply);
  x().position = "3000";
  EXPECT_NEAR(stage_->encoder_angle(StageAxis::kX).deg(), 3000 * 360.0 / kStepsPerTurn, 1e-9);
}

TEST_F(ZaberAsciiStageTest, AMoveWhoseAcceptanceIsNotKnownIsNotRepeated) {
  connect();
  stage_->identify();
  line_.mishaps["1 1 move abs 96000"] = {{.instead = ""}};
  const InstrumentError error = error_of([&] { stage_->move_to(StageAxis::kX, Angle::degrees(90.0)); });
  EXPECT_EQ(error.fault(), Fault::kNoReply);
  EXPECT_THAT(error.what(), HasSubstr("whether it was accepted is unknown"));
  EXPECT_EQ(line_.count("1 1 move abs 96000"), 1U);
}

TEST_F(ZaberAsciiStageTest, GarbageWithoutEndDoesNotHoldTheDriver) {
  connect();
  stage_->identify();
  line_.silent = true;
  for (int i = 1; i < 10000; ++i) line_.say("garbage", i * 1ms);
  const Clock::Instant before = clock_.now();
  EXPECT_EQ(error_of([&] { stage_->encoder_angle(StageAxis::kX); }).fault(), Fault::kBadFrame);
  EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline + 10ms);
}

TEST_F(ZaberAsciiStageTest, MessagesOfOthersWithoutEndDoNotHoldTheDriver) {
  for (const char* bytes : {"!01 1 IDLE --\r\n", "@02 1 01 OK IDLE -- 0\r\n", "#01 0 tea is ready\r\n"}) {
    ZaberAsciiStage stage(std::make_unique<test::EndlessStream>(clock_, bytes), clock_, StageSettings{});
    const Clock::Instant before = clock_.now();
    const InstrumentError error = error_of([&] { stage.identify(); });
    EXPECT_EQ(error.fault(), Fault::kNoReply) << error.what();
    EXPECT_LE(clock_.now() - before, 2 * kReplyDeadline + 10ms) << bytes;
    EXPECT_FALSE(stage.halt()) << bytes;
  }
}

TEST_F(ZaberAsciiStageTest, AnUnpluggedPortIsALostLink) {
  connect();
  stage_->identify();
  line_.unplugged = true;
  EXPECT_EQ(error_of([&] { stage_->motion_state(StageAxis::kX); }).fault(), Fault::kLinkLost);
  EXPECT_FALSE(stage_->halt());
}

// ---- Halt

TEST_F(ZaberAsciiStageTest, HaltIsAcknowledgedByStandstillAndNotOtherwise) {
  connect();
  stage_->identify();
  EXPECT_TRUE(stage_->halt());
  EXPECT_GE(line_.count("0 0 stop"), 1U);
  chain_.devices[1][1].status = "BUSY";
  const Clock::Instant before = clock_.now();
  EXPECT_FALSE(stage_->halt());
  EXPECT_LE(clock_.now() - before, kHaltDeadline);
}

TEST_F(ZaberAsciiStageTest, HaltOfASilentDeviceIsNotAcknowledgedInTime) {
  connect();
  stage_->identify();
  line_.silent = true;
  const Clock::Instant before = clock_.now();
  EXPECT_FALSE(stage_->halt());
  EXPECT_LE(clock_.now() - before, kHaltDeadline);
}

TEST_F(ZaberAsciiStageTest, HaltWorksBeforeAnythingWasAsked) {
  connect();
  EXPECT_TRUE(stage_->halt());
  EXPECT_EQ(line_.commands().front(), "0 0 stop") << "it stops first and asks afterwards";
}

TEST_F(ZaberAsciiStageTest, WhatOneDeviceOfAChainSaysOfAHaltIsHeardWhereTheOtherOneIsSilent) {
  const std::map<int, std::vector<FakeAxis>> both{{1, {FakeAxis{}}}, {2, {FakeAxis{}}}};
  chain_.devices = both;
  connect();
  stage_->identify();
  for (const int silent : {1, 2}) {
    chain_.devices = both;
    chain_.devices.erase(silent);
    const Clock::Instant before = clock_.now();
    const HaltReport report = stage_->halt_axes();
    EXPECT_EQ(report.axes[0], silent == 1 ? AxisHalt::kUnreachable : AxisHalt::kHalted) << silent;
    EXPECT_EQ(report.axes[1], silent == 2 ? AxisHalt::kUnreachable : AxisHalt::kHalted) << silent;
    EXPECT_LE(clock_.now() - before, kHaltDeadline);
  }
}

TEST_F(ZaberAsciiStageTest, EachDeviceOfAChainHasARecipeThatStopsAllOfThem) {
  chain_.devices = {{1, {FakeAxis{}}}, {2, {FakeAxis{}}}};
  connect({.axis_names = {"2 1", "1 1"}, .speed_deg_per_s = {}, .address = {}});
  const auto check = [&] {
    const std::vector<HaltRecipe> recipes = stage_->halt_recipes();
    ASSERT_EQ(recipes.size(), 2U);
    EXPECT_EQ(recipes[0].axes, (std::array{false, true}));
    EXPECT_EQ(recipes[1].axes, (std::array{true, false}));
    EXPECT_EQ(recipes[1].questions.at(0).bytes.substr(0, 8), "/2 1 41:");
    for (const HaltRecipe& recipe : recipes) EXPECT_EQ(recipe.stop.substr(0, 9), "/0 0 stop");
  };
  check();
  stage_->identify();
  check();
}

TEST_F(ZaberAsciiStageTest, TheLineIsAskedForTheRotatingAxesOfAllItsDevices) {
  chain_.devices = {{3, {FakeAxis{}, FakeAxis{}}}, {12, {FakeAxis{}}}};
  chain_.devices[3][1].rejections["get limit.cycle.dist"] = "BADCOMMAND";
  EXPECT_THAT(axes_on_line(std::unique_ptr<wire::ByteStream>(owned_.release()), clock_),
              ::testing::ElementsAre("3 1", "12 1"));
}

TEST_F(ZaberAsciiStageTest, HaltDoesNotWaitForAQueryUnderWay) {
  connect();
  stage_->identify();
  line_.held_until = "1 1 get pos";
  line_.released_by = "0 0 stop";
  auto owner = std::async(std::launch::async, [&] { return stage_->encoder_angle(StageAxis::kX).deg(); });
  line_.await_hold();
  EXPECT_TRUE(stage_->halt());
  EXPECT_NEAR(owner.get(), 14.499375, 1e-9);
}

TEST_F(ZaberAsciiStageTest, ItsRecipeTellsAStandingAxisFromAMovingOneAndFromOtherReplies) {
  using enum test::Verdict;
  connect({.axis_names = {"2 1", "1 2"}, .speed_deg_per_s = {}, .address = {}});
  const std::vector<HaltRecipe> recipes = stage_->halt_recipes();
  ASSERT_EQ(recipes.size(), 2U);
  const HaltRecipe& recipe = recipes[1];
  ASSERT_EQ(recipe.questions.size(), 2U);
  test::expect_verdicts(recipe, recipe.questions[0],
                        {{"@02 1 41 OK IDLE -- 0", kStanding},
                         {"@02 1 41 OK IDLE WR 0:4A", kStanding},
                         {"@02 1 41 OK IDLE ", kStanding},
                         {"@02 1 41 OK BUSY -- 0", kMoving},
                         {"@02 1 41 OK BUSY NI 0:1F", kMoving},
                         {"", kOther},
                         {"@02 1 41 OK IDLE", kOther},
                         {"@02 1 41 OK idle -- 0", kOther},
                         {"@02 1 41 OK PARK -- 0", kOther},
                         {"@02 1 41 RJ IDLE -- BADCOMMAND", kOther},
                         {"@02 1 41 RJ BUSY -- STATUSBUSY", kOther},
                         {"@02 1 42 OK IDLE -- 0", kOther},
                         {"@02 1 83 OK IDLE -- 0", kOther},
                         {"@02 1 OK IDLE -- 0", kOther},
                         {"@02 2 41 OK IDLE -- 0", kOther},
                         {"@02 0 41 OK IDLE -- 0", kOther},
                         {"@01 1 41 OK IDLE -- 0", kOther},
                         {"@2 1 41 OK IDLE -- 0", kOther},
                         {"@12 1 41 OK IDLE -- 0", kOther},
                         {" @02 1 41 OK IDLE -- 0", kOther},
                         {"02 1 41 OK IDLE -- 0", kOther},
                         {"!02 1 IDLE --", kOther},
                         {"#02 1 41 OK IDLE -- 0", kOther},
                         {"@02  1 41 OK IDLE -- 0", kOther}});
  test::expect_verdicts(recipe, recipe.questions[1],
                        {{"@02 1 83 OK IDLE -- 0", kStanding},
                         {"@02 1 83 OK BUSY -- 0", kMoving},
                         {"@02 1 41 OK IDLE -- 0", kOther}});
  test::expect_verdicts(recipes[0], recipes[0].questions.at(0),
                        {{"@01 2 41 OK IDLE -- 0", kStanding},
                         {"@01 2 41 OK BUSY -- 0", kMoving},
                         {"@02 1 41 OK IDLE -- 0", kOther}});
}

TEST_F(ZaberAsciiStageTest, WhereTheDevicesAreNotKnownItsRecipeHearsAllOfThem) {
  using enum test::Verdict;
  connect();
  const std::vector<HaltRecipe> recipes = stage_->halt_recipes();
  ASSERT_EQ(recipes.size(), 1U);
  for (const std::string id : {"41", "83"}) {
    const HaltRecipe::Question& question = recipes[0].questions.at(id == "41" ? 0 : 1);
    EXPECT_GT(question.listen, 0ms);
    test::expect_verdicts(recipes[0], question,
                          {{"@01 0 " + id + " OK IDLE -- 0", kStanding},
                           {"@99 0 " + id + " OK IDLE WR 0:4A", kStanding},
                           {"@07 0 " + id + " OK BUSY -- 0", kMoving},
                           {"", kOther},
                           {"@7 0 " + id + " OK IDLE -- 0", kOther},
                           {"@007 0 " + id + " OK IDLE -- 0", kOther},
                           {"@0a 0 " + id + " OK IDLE -- 0", kOther},
                           {"@01 1 " + id + " OK IDLE -- 0", kOther},
                           {"@01 0 " + id + " RJ IDLE -- BADCOMMAND", kOther},
                           {"@01 0 05 OK IDLE -- 0", kOther},
                           {"@01 0 " + id + " OK IDLE", kOther},
                           {"!01 0 IDLE --", kOther}});
  }
}

}  // namespace
}  // namespace abcal::zaber_ascii
