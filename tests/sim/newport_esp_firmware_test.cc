#include "sim/firmware/newport_esp_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::EndsWith;
using testing::HasSubstr;
using testing::StartsWith;

class NewportEspFirmwareTest : public testing::Test {
 protected:
  explicit NewportEspFirmwareTest(NewportEspSettings settings = {}, BenchTruth truth = {})
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  std::string ask(std::string_view query) {
    host.send(std::string(query) + "\r");
    return host.listen(milliseconds(2));
  }
  /// Sends a set command, which has no reply, and queries its error.
  std::string command(std::string_view text) {
    EXPECT_EQ(ask(text), "") << text;
    return ask("TE?");
  }
  void home_both() {
    EXPECT_EQ(command("1MO;2MO"), "0\r\n");
    EXPECT_EQ(command("1OR1;2OR1"), "0\r\n");
    wait_until_done();
  }
  void wait_until_done() {
    for (int n = 0; n < 1000 && ask("1MD?") + ask("2MD?") != "1\r\n1\r\n"; ++n) host.listen(milliseconds(20));
    EXPECT_EQ(ask("1MD?"), "1\r\n");
  }
  Clock::Instant now() { return host.clock().now(); }

  std::shared_ptr<SimBench> bench;
  NewportEspFirmware firmware;
  FirmwareHost host;
};

TEST_F(NewportEspFirmwareTest, TheRecordedDialogueHolds) {
  EXPECT_EQ(ask("VE?"), "ESP301 Version 3.0.1 6/1/99\r\n");
  EXPECT_EQ(ask("01ST"), "");
  EXPECT_THAT(ask("TB?"), testing::AllOf(StartsWith("0, "), EndsWith(", NO ERROR DETECTED\r\n")));
  EXPECT_EQ(ask("04ST"), "");
  EXPECT_THAT(ask("TB?"), StartsWith("9, "));  // how a host counts the axes
  EXPECT_EQ(ask("01SN?"), "7\r\n");
  EXPECT_EQ(ask("01ZB?"), "300H\r\n");
  EXPECT_EQ(ask("01SU?"), "0.0001\r\n");
  EXPECT_EQ(ask("01MD"), "1\r\n");
  EXPECT_EQ(ask("01TP?"), "0.00000\r\n");
  EXPECT_EQ(ask("01ZH?"), "24H\r\n");
  EXPECT_EQ(ask("01MO?"), "0\r\n");
  EXPECT_EQ(ask("TE?"), "0\r\n");
  EXPECT_EQ(ask("1ID?"), "URS100BCC, SN12345\r\n");
  EXPECT_EQ(ask("PH"), "0H, 3H\r\n");  // both stand on their home switch
}

TEST_F(NewportEspFirmwareTest, AcceptsTheStylesOfDifferentHosts) {
  home_both();
  for (const char* move : {"01PA5.000000", "1PA5", "1 PA 5.000000", "1pa+5", "  1PA 5e0 "}) {
    EXPECT_EQ(command(move), "0\r\n") << move;
    wait_until_done();
    EXPECT_EQ(ask("1TP"), "5.00000\r\n") << move;
    EXPECT_EQ(command("1PA0"), "0\r\n");
    wait_until_done();
  }
  host.send("1T");
  host.send("P?\r\n2TP\r");
  EXPECT_EQ(host.listen(milliseconds(2)), "0.00000\r\n0.00000\r\n");
  EXPECT_EQ(ask("1TP;2TP?;VE"), "0.00000\r\n0.00000\r\nESP301 Version 3.0.1 6/1/99\r\n");
}

TEST_F(NewportEspFirmwareTest, MovesForAsLongAsTheMotionLasts) {
  home_both();
  ask("1PA90;2PA-45");
  EXPECT_EQ(ask("1MD?"), "0\r\n");
  EXPECT_EQ(ask("1DP?"), "90.00000\r\n");
  host.listen(seconds(3));  // at 20 deg/s and 80 deg/s2 45 degrees take 2.5 s, 90 take 4.75 s
  EXPECT_EQ(ask("1MD?") + ask("2MD?"), "0\r\n1\r\n");
  EXPECT_EQ(ask("1TV"), "20.00000\r\n");
  host.listen(seconds(2));
  EXPECT_EQ(ask("1MD?"), "1\r\n");
  EXPECT_EQ(ask("1TP?") + ask("2TP?"), "90.00000\r\n-45.00000\r\n");
  EXPECT_EQ(bench->target(StageAxis::kZ, now()).deg(), -45.0);
  EXPECT_EQ(command("1PR-5.5"), "0\r\n");
  wait_until_done();
  EXPECT_EQ(ask("1TP"), "84.50000\r\n");
}

TEST_F(NewportEspFirmwareTest, RefusesWithTheCodesOfTheManual) {
  EXPECT_EQ(command("1PA5"), "113\r\n");  // motor not enabled
  home_both();
  EXPECT_EQ(command("1YY5"), "6\r\n");
  EXPECT_EQ(command("hello"), "6\r\n");
  EXPECT_EQ(command("7"), "6\r\n");
  EXPECT_EQ(command("1PA5x"), "7\r\n");
  EXPECT_EQ(command("1PAnan"), "7\r\n");
  EXPECT_EQ(command("9TP?"), "9\r\n");
  EXPECT_EQ(command("TP?"), "37\r\n");
  EXPECT_EQ(command("1PA"), "38\r\n");
  EXPECT_EQ(command("1PA361"), "106\r\n");
  EXPECT_EQ(command("2PA-361"), "207\r\n");
  EXPECT_EQ(command("3TP?"), "308\r\n");  // no stage there
  EXPECT_EQ(command("1VA1000"), "110\r\n");
  EXPECT_EQ(command("1VA0"), "7\r\n");
  EXPECT_EQ(command("1AC1000000"), "111\r\n");
  EXPECT_EQ(command("1SN2"), "7\r\n");  // millimetres
  EXPECT_EQ(command(std::string(200, 'A')), "6\r\n");
  EXPECT_EQ(ask("1MD?") + ask("1TP"), "1\r\n0.00000\r\n") << "nothing has moved";
}

TEST_F(NewportEspFirmwareTest, RemembersErrorsInTheirOrderAndTheOldestAreLost) {
  ask("1YY");
  ask("TP");
  EXPECT_EQ(ask("TE?"), "6\r\n");
  EXPECT_EQ(ask("TE?"), "37\r\n");
  EXPECT_EQ(ask("TE?"), "0\r\n");
  for (int n = 0; n < 12; ++n) ask(n < 2 ? "1YY" : "TP");
  for (int n = 0; n < 10; ++n) EXPECT_EQ(ask("TE?"), "37\r\n");
  EXPECT_EQ(ask("TE?"), "0\r\n");
}

TEST_F(NewportEspFirmwareTest, StopsOneAxisOrAll) {
  for (const char* stop : {"ST", "1ST;2ST", "AB"}) {
    home_both();
    ask("1PA90;2PA90");
    host.listen(seconds(1));
    EXPECT_EQ(command(stop), "0\r\n");
    host.listen(milliseconds(400));
    EXPECT_EQ(ask("1MD?") + ask("2MD?"), "1\r\n1\r\n") << stop;
    const double at = bench->commanded_angle(StageAxis::kX, now()).deg();
    EXPECT_GT(at, 10.0);
    EXPECT_LT(at, 25.0);
  }
  ask("1PA0;2PA0");
  ask("2ST");
  host.listen(milliseconds(400));
  EXPECT_EQ(ask("1MD?") + ask("2MD?"), "0\r\n1\r\n");
}

TEST_F(NewportEspFirmwareTest, RefusesMovesWhileItHomesAndForgetsAHomingCutShort) {
  ask("1MO");
  ask("1OR");
  EXPECT_EQ(ask("1MD?"), "0\r\n");
  EXPECT_EQ(command("1PA5"), "130\r\n");
  EXPECT_EQ(command("1OR"), "130\r\n");
  EXPECT_EQ(command("1ST"), "120\r\n");  // homing aborted
  host.listen(milliseconds(300));
  EXPECT_EQ(ask("1MD?"), "1\r\n");
  EXPECT_EQ(command("2OR"), "213\r\n");
}

TEST_F(NewportEspFirmwareTest, RunsIntoAHardwareLimitAndFallsSilent) {
  home_both();
  EXPECT_EQ(command("1SR400"), "0\r\n");
  EXPECT_EQ(command("1PA390"), "0\r\n");
  host.listen(seconds(20));
  EXPECT_EQ(ask("1MD?"), "") << "silent after a limit";
  EXPECT_EQ(host.listen(seconds(3)), "1\r\n");
  EXPECT_EQ(ask("TE?"), "104\r\n");
  EXPECT_EQ(ask("1TP"), "360.00000\r\n");
  EXPECT_EQ(ask("1MO?"), "0\r\n");
}

TEST_F(NewportEspFirmwareTest, SetsSpeedAndAccelerationsAndUsesThem) {
  home_both();
  EXPECT_EQ(ask("1VA?") + ask("1AC?") + ask("1AG?") + ask("1VU?"),
            "20.00000\r\n80.00000\r\n80.00000\r\n720.00000\r\n");
  EXPECT_EQ(command("1VA40;1AC80;1AG160"), "0\r\n");
  EXPECT_EQ(ask("1VA?"), "40.00000\r\n");
  const Clock::Instant start = now();
  host.send("1PA55\r");
  // 0.5 s and 10 degrees up, 0.25 s and 5 degrees down, 40 degrees at 40 degrees/s.
  EXPECT_EQ(bench->motion_end(StageAxis::kX, start) - start, milliseconds(1750));
}

TEST_F(NewportEspFirmwareTest, CountsInTheUnitThatIsSet) {
  home_both();
  EXPECT_EQ(command("1SN9"), "0\r\n");
  EXPECT_EQ(ask("1SN?"), "9\r\n");
  EXPECT_EQ(command("1PA1"), "0\r\n");
  wait_until_done();
  EXPECT_EQ(command("1SN7"), "0\r\n");
  EXPECT_EQ(ask("1TP"), "57.29580\r\n");  // one radian to the encoder's 1e-4 degrees
}

TEST_F(NewportEspFirmwareTest, DefinesPositions) {
  EXPECT_EQ(command("1DH12.5"), "0\r\n");
  EXPECT_EQ(ask("1TP"), "12.50000\r\n");
  EXPECT_EQ(command("1SH3;1MO;1OR"), "0\r\n");
  EXPECT_EQ(ask("1DH?"), "3.00000\r\n");
  wait_until_done();
  EXPECT_EQ(ask("1TP"), "3.00000\r\n");
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, now()).deg(), 0.0);
}

TEST_F(NewportEspFirmwareTest, WaitsWithTheLinesBehindAWait) {
  home_both();
  host.send("1PA20;1WS500;1TP\r2TP\r");  // 20 degrees take 1.25 s
  EXPECT_EQ(host.listen(milliseconds(1700)), "");
  EXPECT_EQ(host.listen(milliseconds(100)), "20.00000\r\n0.00000\r\n");
}

TEST_F(NewportEspFirmwareTest, ShowsTheFaultsOfTheWorld) {
  home_both();
  bench->inject(
      {.kind = FaultKind::kRefusedMove, .at = now(), .until = now() + seconds(10), .axis = StageAxis::kZ});
  EXPECT_EQ(command("2PA5"), "27\r\n");
  EXPECT_EQ(command("1PA5"), "0\r\n");
  host.listen(seconds(10));
  bench->inject(
      {.kind = FaultKind::kLostReference, .at = now(), .until = now() + seconds(1), .axis = StageAxis::kX});
  EXPECT_EQ(command("1PA10"), "109\r\n");
}

// EPICS counts the axes by ST and TB?: any error but 9 ends its start.
TEST_F(NewportEspFirmwareTest, StoppingAnAxisWithoutAStageIsNoError) {
  EXPECT_EQ(command("03ST"), "0\r\n");
  EXPECT_EQ(command("04ST"), "9\r\n");
}

TEST_F(NewportEspFirmwareTest, JogsUntilItIsStopped) {
  home_both();
  EXPECT_EQ(command("01MV+;"), "0\r\n");  // as EPICS writes it
  host.listen(seconds(2));
  EXPECT_EQ(ask("1MD?"), "0\r\n");
  EXPECT_EQ(ask("1DV"), "20.00000\r\n");
  EXPECT_EQ(ask("TS"), "Q\r\n");  // axis 1 in motion, motors on
  EXPECT_EQ(command("1ST"), "0\r\n");
  wait_until_done();
  EXPECT_GT(bench->commanded_angle(StageAxis::kX, now()).deg(), 30.0);
  EXPECT_EQ(ask("1DV") + ask("TS"), "0.00000\r\nP\r\n");
  EXPECT_EQ(command("2MV-"), "0\r\n");
  host.listen(seconds(60));
  EXPECT_EQ(ask("2TP") + ask("2MO?"), "-360.00000\r\n1\r\n") << "the software limit ends it";
  EXPECT_EQ(command("1MV"), "38\r\n");
  EXPECT_EQ(command("1MV5"), "7\r\n");
  EXPECT_EQ(command("1MT+"), "0\r\n");
  EXPECT_EQ(ask("1MT?"), "0\r\n");
  host.listen(seconds(60));
  EXPECT_EQ(ask("1TP") + ask("TE?"), "360.00000\r\n0\r\n");
}

TEST_F(NewportEspFirmwareTest, WaitsForAPosition) {
  home_both();
  host.send("1PA40;1WP20;1TP\r");
  // 20 deg/s at 80 deg/s2: 2.5 degrees in 0.25 s, then 17.5 degrees in 0.875 s.
  EXPECT_EQ(host.listen(milliseconds(1120)), "");
  EXPECT_THAT(host.listen(milliseconds(10)), StartsWith("20.0"));
  host.listen(seconds(3));
  EXPECT_EQ(ask("1WP20;1TP"), "40.00000\r\n") << "not on its way: nothing to wait for";
  host.send("1PA0;1WP0;1TP\r");  // as InstrumentKit: up to the target itself
  EXPECT_EQ(host.listen(seconds(5)), "0.00000\r\n");
}

TEST_F(NewportEspFirmwareTest, KeepsTheSettingsThatHostsReadAndWrite) {
  for (const char* name : {"AF", "FE", "JH", "JW", "KD", "KI", "KP", "KS", "OH", "QI", "QV"}) {
    const std::string setting = std::string("1") + name;
    EXPECT_THAT(ask(setting + "?"), testing::MatchesRegex("[0-9]+\\.[0-9]{5}\r\n")) << name;
    EXPECT_EQ(command(setting + "2.5"), "0\r\n") << name;
    EXPECT_EQ(ask(setting + "?"), "2.50000\r\n") << name;
    EXPECT_EQ(command(setting + "-1"), "7\r\n") << name;
  }
  for (const char* name : {"FP", "QM", "TJ"}) {
    const std::string setting = std::string("1") + name;
    EXPECT_EQ(command(setting + "3"), "0\r\n") << name;
    EXPECT_EQ(ask(setting + "?"), "3\r\n") << name;
    EXPECT_EQ(command(setting + "2.5"), "7\r\n") << name;
  }
  EXPECT_EQ(command("1QR1000,50"), "0\r\n");
  EXPECT_EQ(ask("1QR?"), "1000,50\r\n");
  EXPECT_EQ(command("1QD;UF"), "0\r\n");
  EXPECT_EQ(ask("ZU?"), "0H\r\n");
  EXPECT_EQ(command("1SU0.001"), "27\r\n") << "what is set is not answered";
}

TEST_F(NewportEspFirmwareTest, KeepsAndRunsPrograms) {
  home_both();
  EXPECT_EQ(command("1EX"), "35\r\n");
  EXPECT_EQ(ask("1EP"), "");
  EXPECT_EQ(ask("1PA5;1WS"), "");
  EXPECT_EQ(ask("2PA-5"), "");
  EXPECT_EQ(ask("QP"), "");
  EXPECT_EQ(ask("1MD?"), "1\r\n") << "nothing moves while it is entered";
  EXPECT_EQ(ask("1EX"), "");
  EXPECT_EQ(bench->target(StageAxis::kX, now()).deg(), 5.0);
  EXPECT_EQ(bench->target(StageAxis::kZ, now()).deg(), 0.0) << "waits for the first";
  host.listen(seconds(3));
  EXPECT_EQ(ask("1TP") + ask("2TP"), "5.00000\r\n-5.00000\r\n");
  for (const char* line : {"2EP", "1EX", "QP"}) EXPECT_EQ(ask(line), "") << line;
  EXPECT_EQ(command("2EX"), "27\r\n") << "programs that run programs might never end";
  EXPECT_EQ(command("1XX"), "0\r\n");
  EXPECT_EQ(command("1EX"), "35\r\n");
}

TEST_F(NewportEspFirmwareTest, AResetIsASwitchingOffAndOn) {
  home_both();
  ask("1PA5");
  wait_until_done();
  ask("1YY");
  EXPECT_EQ(ask("RS"), "");
  EXPECT_EQ(ask("1TP") + ask("1MO?") + ask("TE?"), "0.00000\r\n0\r\n0\r\n");
}

// InstrumentKit asks TB? after every command and cuts the reply at its commas into three.
TEST_F(NewportEspFirmwareTest, ErrorTextsHaveNoComma) {
  for (const char* wrong : {"1YY", "TP", "1PA", "1PA5x", "9TP", "3PA1", "1EX", "1PA5", "1VA1000", "1AC1e7"}) {
    ask(wrong);
    const std::string message = ask("TB?");
    EXPECT_EQ(std::count(message.begin(), message.end(), ','), 2) << wrong << " " << message;
  }
}

TEST_F(NewportEspFirmwareTest, WhatItDoesNotKnowIsNotedOnce) {
  ask("1YY");
  ask("1YY");
  ASSERT_EQ(firmware.unserved().all().size(), 1U);
  EXPECT_EQ(firmware.unserved().all()[0].command, "YY");
  EXPECT_EQ(firmware.unserved().all()[0].count, 2U);
}

class NewportEspMountedTest : public NewportEspFirmwareTest {
 protected:
  NewportEspMountedTest()
      : NewportEspFirmwareTest({.axis_names = {"2", "1"},
                                .sign = {-1, +1},
                                .zero = {Angle::degrees(30), Angle::degrees(-10)},
                                .line_end = "\r",
                                .unsolicited_errors = true}) {}
};

TEST_F(NewportEspMountedTest, CountsFromItsOwnZeroInItsOwnSenseOnceHomed) {
  EXPECT_EQ(ask("2TP") + ask("1TP"), "0.00000\r0.00000\r") << "wherever it is when it is switched on";
  EXPECT_EQ(ask("2MO;1MO;2OR;1OR"), "");
  for (int n = 0; n < 1000 && ask("1MD") + ask("2MD") != "1\r1\r"; ++n) host.listen(milliseconds(20));
  EXPECT_EQ(ask("2TP") + ask("1TP"), "0.00000\r0.00000\r");
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, now()).deg(), 30.0);
  EXPECT_EQ(bench->commanded_angle(StageAxis::kZ, now()).deg(), 10.0);
  EXPECT_EQ(ask("2SL?") + ask("2SR?"), "-330.00000\r390.00000\r");
  ask("2PA120;1PA-100");
  host.listen(seconds(20));
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, now()).deg(), -90.0);
  EXPECT_EQ(bench->commanded_angle(StageAxis::kZ, now()).deg(), -90.0);
}

TEST_F(NewportEspMountedTest, SaysSomeErrorsUnasked) {
  EXPECT_EQ(ask("TP"), "E37\r");
  EXPECT_EQ(ask("TE?"), "37\r");
}

TEST(NewportEspSettingsTest, RefusesWhatCannotBe) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  EXPECT_THROW(NewportEspFirmware(bench, {.sign = {1, 0}}), std::invalid_argument);
  EXPECT_THROW(NewportEspFirmware(bench, {.axis_names = {"1", "1"}}), std::invalid_argument);
  EXPECT_THROW(NewportEspFirmware(bench, {.axis_names = {"1", "4"}}), std::invalid_argument);
  EXPECT_THROW(NewportEspFirmware(bench, {.axis_names = {"A", "2"}}), std::invalid_argument);
}

TEST_F(NewportEspFirmwareTest, WithoutPowerItStopsAndReadsZeroThen) {
  home_both();
  EXPECT_EQ(command("1VA5;1PA90"), "0\r\n");
  host.listen(seconds(2));
  firmware.power(false, now());
  host.listen(seconds(2));
  firmware.power(true, now());
  EXPECT_NEAR(std::stod(ask("1TP?")), 0.0, 1e-4) << "one step of the encoder";
  EXPECT_EQ(ask("1MO?"), "0\r\n");
  EXPECT_EQ(ask("TE?"), "0\r\n");
  const double angle = bench->commanded_angle(StageAxis::kX, now()).deg();
  EXPECT_GT(angle, 1.0);
  EXPECT_LT(angle, 20.0);
  EXPECT_EQ(firmware.line_speed(), 19200U);
}

}  // namespace
}  // namespace abcal::sim
