#include "sim/firmware/pi_gcs_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <sstream>
#include <string>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::EndsWith;
using testing::HasSubstr;
using testing::StartsWith;

class PiGcsFirmwareTest : public testing::Test {
 protected:
  explicit PiGcsFirmwareTest(PiGcsSettings settings = {}, BenchTruth truth = {})
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  std::string ask(std::string_view query) { return host.exchange(std::string(query) + "\n"); }
  /// Sends a set command, which has no reply, and queries its error.
  std::string command(std::string_view text) {
    EXPECT_EQ(ask(text), "") << text;
    return ask("ERR?");
  }
  void reference() {
    EXPECT_EQ(command("SVO 1 1 2 1"), "0\n");
    EXPECT_EQ(command("FRF"), "0\n");
    host.listen(seconds(1));
    EXPECT_EQ(ask("FRF?"), "1=1 \n2=1\n");
  }
  void wait_until_stopped() {
    for (int n = 0; n < 1000 && host.exchange("\x05") != "0\n"; ++n) host.listen(milliseconds(20));
    EXPECT_EQ(host.exchange("\x05"), "0\n");
  }

  std::shared_ptr<SimBench> bench;
  PiGcsFirmware firmware;
  FirmwareHost host;
};

TEST_F(PiGcsFirmwareTest, SaysWhatItIs) {
  EXPECT_EQ(ask("*IDN?"), "(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 118001234, 1.2.3.4\n");
  EXPECT_EQ(ask("CSV?"), "2.0\n");
  EXPECT_EQ(ask("SAI?"), "1 \n2\n");
  EXPECT_EQ(ask("SAI? ALL"), "1 \n2\n");
  EXPECT_EQ(ask("CST?"), "1=M-060.PD \n2=M-060.PD\n");
  EXPECT_EQ(ask("CST? 1"), "1=M-060.PD\n");
  EXPECT_EQ(ask("PUN? 1"), "1=DEG\n");
  EXPECT_EQ(ask("TRS? 1"), "1=1\n");
  EXPECT_EQ(ask("LIM? 2"), "2=1\n");
  EXPECT_EQ(ask("HAR? 1"), "1=0\n");
  EXPECT_EQ(ask("ERR?"), "0\n");
}

TEST_F(PiGcsFirmwareTest, ListsItsCommandsUpToEndOfHelp) {
  const std::string help = ask("HLP?");
  for (const char* name :
       {"#4 ", "#5 ", "#7 ", "#24 ", "MOV ", "MOV? ", "ONT? ", "FRF ", "EAX ", "SPA? ", "ERR? "})
    EXPECT_THAT(help, HasSubstr(std::string("\n") + name)) << name;
  EXPECT_THAT(help, EndsWith(" \nend of help\n"));
}

TEST_F(PiGcsFirmwareTest, EveryCommandOfTheHelpIsKnown) {
  std::istringstream help(ask("HLP?"));
  int known = 0;
  for (std::string line; std::getline(help, line);) {
    const std::string name = line.substr(0, line.find(' '));
    if (name.empty() || name[0] == '#' || name == "The" || name == "end" || name == "RBT") continue;
    ask(name);
    if (name != "ERR?") {
      EXPECT_NE(ask("ERR?"), "2\n") << name;
    }
    ++known;
  }
  EXPECT_GE(known, 35);
}

TEST_F(PiGcsFirmwareTest, AnAxislessQueryAnswersAllAxesOnePerLine) {
  for (const char* query :
       {"POS?", "MOV?", "ONT?", "SVO?", "VEL?", "TMN?", "TMX?", "FRF?", "EAX?", "RON?", "PUN?"}) {
    const std::string answer = ask(query);
    EXPECT_THAT(answer, StartsWith("1=")) << query;
    EXPECT_THAT(answer, HasSubstr(" \n2=")) << query;
    EXPECT_THAT(answer, EndsWith("\n")) << query;
  }
  EXPECT_EQ(ask("TMN?"), "1=-360.000000 \n2=-360.000000\n");
  EXPECT_EQ(ask("TMX? 2 1"), "2=360.000000 \n1=360.000000\n");
}

TEST_F(PiGcsFirmwareTest, TheRecordedDialogueHolds) {
  reference();
  EXPECT_EQ(command("SVO 1 1"), "0\n");
  EXPECT_EQ(ask("SVO? 1"), "1=1\n");
  EXPECT_EQ(command("MOV 1 14.5"), "0\n");
  wait_until_stopped();
  host.listen(milliseconds(10));
  EXPECT_EQ(ask("ONT? 1"), "1=1\n");
  EXPECT_EQ(ask("POS? 1"), "1=14.500000\n");
  EXPECT_EQ(command("MOV 9 1"), "15\n");
  EXPECT_EQ(ask("ERR?"), "0\n");  // asking clears it
}

TEST_F(PiGcsFirmwareTest, AcceptsTheStylesOfDifferentHosts) {
  reference();
  EXPECT_EQ(host.exchange("pos? 1\r\n"), "1=0.000000\n");
  EXPECT_EQ(host.exchange("  POS?   1  \n"), "1=0.000000\n");
  EXPECT_EQ(host.exchange("\n\n"), "");
  EXPECT_EQ(ask("ERR?"), "0\n");
  for (const char* move : {"MOV 1 5.000000", "mov 1 +5", "MOV 1 5e0"})
    EXPECT_EQ(command(move), "0\n") << move;
  host.send("PO");
  host.send("S? ");
  EXPECT_EQ(host.exchange("2\n"), "2=0.000000\n");
  EXPECT_EQ(host.exchange("MOV? 1\nMOV? 2\n"), "1=5.000000\n2=0.000000\n");
}

TEST_F(PiGcsFirmwareTest, OneMoveIsEnoughAndTheStateSaysSoAtOnce) {
  reference();
  ask("MOV 1 90 2 -45");
  EXPECT_EQ(host.exchange("\x05"), "3\n");
  EXPECT_EQ(host.exchange("\x04"), "0x30003000\n");  // servo on, moving
  EXPECT_EQ(ask("ONT?"), "1=0 \n2=0\n");
  host.listen(seconds(3));  // 45 degrees take 2.5 s, 90 take 4.75 s
  EXPECT_EQ(host.exchange("\x05"), "1\n");
  EXPECT_EQ(host.exchange("\x04"), "0x30001000\n");
  host.listen(seconds(2));
  EXPECT_EQ(host.exchange("\x05"), "0\n");
  EXPECT_EQ(ask("ONT?"), "1=1 \n2=1\n");
  EXPECT_EQ(ask("POS?"), "1=90.000000 \n2=-45.000000\n");
  EXPECT_EQ(host.exchange("\x03"), "1=90.000000 \n2=-45.000000\n");
  EXPECT_EQ(bench->target(StageAxis::kZ, host.clock().now()).deg(), -45.0);
}

TEST_F(PiGcsFirmwareTest, OnTargetWaitsForTheSettleTime) {
  reference();
  EXPECT_EQ(command("SPA 1 0x3F 0.5"), "0\n");
  EXPECT_EQ(ask("SPA? 1 0x3F"), "1 0x3F=0.5\n");
  ask("MOV 1 5");
  wait_until_stopped();
  EXPECT_EQ(ask("ONT? 1"), "1=0\n");
  host.listen(milliseconds(500));
  EXPECT_EQ(ask("ONT? 1"), "1=1\n");
}

TEST_F(PiGcsFirmwareTest, RelativeMovesAddToTheTarget) {
  reference();
  ask("MOV 1 10");
  ask("MVR 1 -5");
  EXPECT_EQ(ask("MOV? 1"), "1=5.000000\n");
  wait_until_stopped();
  EXPECT_EQ(ask("POS? 1"), "1=5.000000\n");
}

TEST_F(PiGcsFirmwareTest, MovesAreRefusedWithoutServoOrReference) {
  EXPECT_EQ(ask("FRF? 1"), "1=0\n");
  EXPECT_EQ(command("MOV 1 5"), "5\n");
  EXPECT_EQ(command("FRF 1"), "5\n");  // servo off
  EXPECT_EQ(command("SVO 1 1"), "0\n");
  EXPECT_EQ(command("MOV 1 5"), "5\n");  // not referenced
  EXPECT_EQ(command("FRF 1"), "0\n");
  EXPECT_EQ(host.exchange("\x07"), "\xB0\n");  // busy
  EXPECT_EQ(host.exchange("\x04"), "0x70000000\n");
  host.listen(seconds(1));
  EXPECT_EQ(host.exchange("\x07"), "\xB1\n");
  EXPECT_EQ(command("MOV 1 5"), "0\n");
  wait_until_stopped();
  EXPECT_EQ(command("SVO 1 0"), "0\n");
  EXPECT_EQ(command("MOV 1 6"), "5\n");
}

TEST_F(PiGcsFirmwareTest, RefusesWithTheCodesOfTheManual) {
  reference();
  EXPECT_EQ(command("MOV 1 400"), "7\n");
  EXPECT_EQ(command("MOV 1 -360.001"), "7\n");
  EXPECT_EQ(command("MVR 1 361"), "7\n");
  EXPECT_EQ(command("VEL 1 100000"), "8\n");
  EXPECT_EQ(command("VEL 1 0"), "8\n");
  EXPECT_EQ(command("MOV 1 5 1 6"), "22\n");
  EXPECT_EQ(command("MOV 1"), "24\n");
  EXPECT_EQ(command("MOV 1 abc"), "25\n");
  EXPECT_EQ(command("MOV 1 nan"), "25\n");
  EXPECT_EQ(command("MOV"), "26\n");
  EXPECT_EQ(command("POS? 7"), "15\n");  // a refused query does not answer
  EXPECT_EQ(command("XYZ?"), "2\n");
  EXPECT_EQ(command("SVO 1 5"), "17\n");
  EXPECT_EQ(command("SPA? 1 0x999"), "54\n");
  EXPECT_EQ(command("SPA 1 14 5"), "60\n");
  EXPECT_EQ(command(std::string(2000, 'A')), "3\n");
  // All or nothing: nothing has moved.
  EXPECT_EQ(command("MOV 2 5 1 400"), "7\n");
  EXPECT_EQ(host.exchange("\x05"), "0\n");
  EXPECT_EQ(ask("MOV?"), "1=0.000000 \n2=0.000000\n");
}

TEST_F(PiGcsFirmwareTest, HaltAndStopEndTheMotionAndSayError10) {
  for (const char* stop : {"HLT\n", "HLT 1 2\n", "STP\n", "\x18"}) {
    if (ask("FRF? 1") != "1=1\n") reference();
    ask("MOV 1 0 2 0");
    wait_until_stopped();
    ask("MOV 1 90 2 90");
    host.listen(seconds(1));
    EXPECT_EQ(host.exchange(stop), "");
    EXPECT_EQ(ask("ERR?"), "10\n");
    host.listen(milliseconds(300));
    EXPECT_EQ(host.exchange("\x05"), "0\n");
    const double stopped_at = bench->commanded_angle(StageAxis::kX, host.clock().now()).deg();
    EXPECT_GT(stopped_at, 10.0);
    EXPECT_LT(stopped_at, 25.0);
    EXPECT_EQ(ask("ONT? 1"), "1=1\n");
  }
}

TEST_F(PiGcsFirmwareTest, OneAxisIsHaltedAlone) {
  reference();
  ask("MOV 1 90 2 90");
  host.listen(seconds(1));
  EXPECT_EQ(command("HLT 2"), "10\n");
  host.listen(milliseconds(500));
  EXPECT_EQ(host.exchange("\x05"), "1\n");
}

TEST_F(PiGcsFirmwareTest, AHaltedSearchFindsNoReference) {
  ask("SVO 1 1");
  ask("FRF 1");
  EXPECT_EQ(command("HLT"), "10\n");
  host.listen(seconds(1));
  EXPECT_EQ(ask("FRF? 1"), "1=0\n");
}

TEST_F(PiGcsFirmwareTest, SpeedAndAccelerationsAreSetAndUsed) {
  reference();
  EXPECT_EQ(ask("VEL? 1"), "1=20.000000\n");
  EXPECT_EQ(command("VEL 1 40 2 10"), "0\n");
  EXPECT_EQ(ask("VEL?"), "1=40.000000 \n2=10.000000\n");
  EXPECT_EQ(command("ACC 1 80"), "0\n");
  EXPECT_EQ(command("DEC 1 160"), "0\n");
  EXPECT_EQ(ask("ACC? 1"), "1=80.000000\n");
  EXPECT_EQ(ask("DEC? 1"), "1=160.000000\n");
  const Clock::Instant start = host.clock().now();
  host.send("MOV 1 55\n");
  // 0.5 s and 10 degrees up, 0.25 s and 5 degrees down, 40 degrees at 40 degrees/s.
  EXPECT_EQ(bench->motion_end(StageAxis::kX, start) - start, milliseconds(1750));
}

TEST_F(PiGcsFirmwareTest, ReferencesToItsLimitsAndByDefinition) {
  ask("SVO 1 1 2 1");
  EXPECT_EQ(command("FNL 1"), "0\n");
  wait_until_stopped();
  EXPECT_EQ(ask("POS? 1"), "1=-360.000000\n");
  EXPECT_EQ(ask("FRF? 1"), "1=1\n");
  EXPECT_EQ(command("POS 2 12.5"), "34\n");  // the reference mode is on
  EXPECT_EQ(command("RON 2 0"), "0\n");
  EXPECT_EQ(command("POS 2 12.5"), "0\n");
  EXPECT_EQ(ask("POS? 2"), "2=12.500000\n");
  EXPECT_EQ(ask("FRF? 2"), "2=1\n");
  EXPECT_EQ(ask("TMX? 2"), "2=372.500000\n");
}

TEST_F(PiGcsFirmwareTest, GivesTheParametersFromWhichHostsCountSteps) {
  EXPECT_EQ(ask("SPA? 1 14"), "1 0xE=10000\n");
  EXPECT_EQ(ask("SPA? 1 15"), "1 0xF=1\n");
  EXPECT_EQ(ask("SPA? 1 0x0E"), "1 0xE=10000\n");
  EXPECT_EQ(ask("SPA? 1 0x406"), "1 0x406=10\n");
  EXPECT_EQ(ask("SPA? 1 0x407 2 0x407"), "1 0x407=12 \n2 0x407=12\n");
}

// The order in which the EPICS module asks before every move; the numbers are decimal on the wire.
TEST_F(PiGcsFirmwareTest, AnswersWhatEpicsAsksBeforeAMove) {
  EXPECT_EQ(ask("SPA? 1 74"), "1 0x4A=100000\n");
  EXPECT_EQ(ask("SPA? 1 75"), "1 0x4B=100000\n");
  EXPECT_EQ(command("SPA 1 11 160"), "0\n");
  EXPECT_EQ(command("SPA 1 12 40"), "0\n");
  EXPECT_EQ(ask("SPA? 1 11"), "1 0xB=160\n");
  EXPECT_EQ(ask("SPA? 1 0xC"), "1 0xC=40\n");
  EXPECT_EQ(ask("ACC? 1"), "1=160.000000\n");
  EXPECT_EQ(ask("DEC? 1"), "1=40.000000\n");
  EXPECT_EQ(bench->motion_limits(StageAxis::kX).acceleration_deg_per_s2, 160.0);
  EXPECT_EQ(command("SPA 1 0x50 5"), "0\n");
  EXPECT_EQ(command("SPA 1 11 0"), "17\n");
  EXPECT_EQ(command("SPA 1 0x49 1e9"), "8\n");
}

TEST_F(PiGcsFirmwareTest, AnswersWhatOdemisAsksOfAClosedLoopAxis) {
  EXPECT_EQ(ask("SPA? 1 117442049"), "1 0x7000601=DEG\n");
  EXPECT_EQ(ask("SPA? 1 0x7000601"), "1 0x7000601=DEG\n");
  EXPECT_EQ(ask("SEP? 1 1"), "1 0x1=40\n");
  EXPECT_EQ(ask("SPA? 1 10"), "1 0xA=720\n");
  EXPECT_EQ(ask("SPA? 1 60"), "1 0x3C=M-060.PD\n");
  EXPECT_EQ(ask("SPA? 2 0x15 2 0x30"), "2 0x15=360 \n2 0x30=-360\n");
  EXPECT_EQ(command("CCL 1 advanced"), "0\n");
  EXPECT_EQ(ask("CCL?"), "1\n");
  EXPECT_EQ(command("CCL 1 wrong"), "56\n");
  EXPECT_EQ(command("CCL 0"), "0\n");
  EXPECT_EQ(ask("CCL?"), "0\n");
}

// PIPython asks it before the first SPA? and takes the fourth word of a line for the type.
TEST_F(PiGcsFirmwareTest, ListsItsParametersAsPiPythonReadsThem) {
  std::istringstream list(ask("HPA?"));
  std::string line;
  std::getline(list, line);
  int parameters = 0;
  while (std::getline(list, line) && !line.starts_with("end of help")) {
    std::istringstream words(line);
    std::string id, level, items, type;
    words >> id >> level >> items >> type;
    EXPECT_THAT(id, testing::MatchesRegex("0x[0-9A-F]+=")) << line;
    EXPECT_THAT(type, testing::AnyOf("INT", "FLOAT", "CHAR")) << line;
    EXPECT_THAT(ask("SPA? 1 " + id.substr(0, id.size() - 1)), StartsWith("1 " + id)) << line;
    ++parameters;
  }
  EXPECT_EQ(line, "end of help");
  EXPECT_GE(parameters, 25);
}

TEST_F(PiGcsFirmwareTest, ParametersInMemoryOutlastAReboot) {
  EXPECT_EQ(command("SEP 99 1 0x3F 0.25"), "56\n");
  EXPECT_EQ(command("SEP 100 1 0x3F 0.25"), "0\n");
  EXPECT_EQ(ask("SPA? 1 0x3F"), "1 0x3F=0.01\n");
  EXPECT_EQ(command("VEL 2 33"), "0\n");
  EXPECT_EQ(command("WPA 100 2 0x49"), "0\n");
  EXPECT_EQ(command("VEL 2 44"), "0\n");
  EXPECT_EQ(command("VEL 1 55"), "0\n");
  ask("RBT");
  EXPECT_EQ(ask("SPA? 1 0x3F"), "1 0x3F=0.25\n");
  EXPECT_EQ(ask("VEL?"), "1=20.000000 \n2=33.000000\n");
}

TEST_F(PiGcsFirmwareTest, AnswersForTheJoystickAndTheAxisThatAreAskedFor) {
  EXPECT_EQ(ask("JON? 2"), "2=0\n");
  EXPECT_EQ(ask("JON?"), "1=0 \n2=0\n");
  EXPECT_EQ(command("JON? 3"), "17\n");
  EXPECT_EQ(command("JON 2 0"), "0\n");
  EXPECT_EQ(ask("HIN? 2"), "2=0\n");
  EXPECT_EQ(ask("HIN?"), "1=0 \n2=0\n");
  EXPECT_EQ(command("HIN 1 0"), "0\n");
  EXPECT_EQ(command("HIN 1 1"), "34\n") << "no device is connected";
  EXPECT_EQ(ask("TPC?"), "0\n");
  EXPECT_TRUE(firmware.unserved().all().empty());
}

TEST_F(PiGcsFirmwareTest, WhatItDoesNotKnowIsNotedOnce) {
  EXPECT_EQ(command("SPA? 1 0x123"), "54\n");
  EXPECT_EQ(command("SPA? 1 0x123"), "54\n");
  EXPECT_EQ(command("WGO 1 1"), "2\n");
  EXPECT_EQ(command("MOV 1 400"), "5\n");  // refused, yet known
  const auto unserved = firmware.unserved().all();
  ASSERT_EQ(unserved.size(), 2U);
  EXPECT_EQ(unserved[0].command, "SPA? 1 0x123");
  EXPECT_EQ(unserved[0].count, 2U);
  EXPECT_EQ(unserved[1].command, "WGO");
  EXPECT_THAT(unserved[1].reaction, HasSubstr("error 2"));
}

TEST_F(PiGcsFirmwareTest, ANewSessionStartsWithAnEmptyLine) {
  reference();
  host.send("MOV 1 1");
  firmware.session_starts();
  EXPECT_EQ(host.exchange("20\n"), "");
  EXPECT_EQ(ask("MOV? 1"), "1=0.000000\n");
  EXPECT_EQ(host.exchange("\x05"), "0\n");
}

TEST_F(PiGcsFirmwareTest, GoesToTheHomeThatWasDefined) {
  reference();
  EXPECT_EQ(ask("DFH? 1"), "1=0.000000\n");
  ask("MOV 1 5");
  wait_until_stopped();
  EXPECT_EQ(command("DFH 1"), "0\n");
  ask("MOV 1 0");
  wait_until_stopped();
  EXPECT_EQ(command("GOH 1"), "0\n");
  wait_until_stopped();
  EXPECT_EQ(ask("POS? 1"), "1=5.000000\n");
}

TEST_F(PiGcsFirmwareTest, ARebootForgetsReferenceAndServo) {
  reference();
  EXPECT_EQ(ask("RBT"), "");
  EXPECT_EQ(ask("FRF?"), "1=0 \n2=0\n");
  EXPECT_EQ(ask("SVO?"), "1=0 \n2=0\n");
  EXPECT_EQ(ask("ERR?"), "0\n");
}

TEST_F(PiGcsFirmwareTest, ScriptedFaultsOfTheStageShowOnTheWire) {
  reference();
  const Clock::Instant now = host.clock().now();
  bench->inject(
      {.kind = FaultKind::kRefusedMove, .at = now, .until = now + seconds(10), .axis = StageAxis::kZ});
  EXPECT_EQ(command("MOV 2 5"), "34\n");
  EXPECT_EQ(command("MOV 1 5"), "0\n");
  host.listen(seconds(10));
  EXPECT_EQ(command("MOV 2 5"), "0\n");
  wait_until_stopped();
  bench->inject({.kind = FaultKind::kLostReference, .at = host.clock().now(), .axis = StageAxis::kX});
  EXPECT_EQ(ask("FRF? 1"), "1=0\n");
  EXPECT_EQ(command("MOV 1 10"), "5\n");
  bench->inject(
      {.kind = FaultKind::kStalledAxis, .at = host.clock().now() + seconds(1), .axis = StageAxis::kZ});
  EXPECT_EQ(command("MOV 2 90"), "0\n");
  host.listen(seconds(1000));
  EXPECT_EQ(host.exchange("\x05"), "2\n");
  EXPECT_EQ(ask("ONT? 2"), "2=0\n");
}

class PiGcsMountedTest : public PiGcsFirmwareTest {
 protected:
  PiGcsMountedTest()
      : PiGcsFirmwareTest({.axis_names = {"A", "B"},
                           .sign = {-1, +1},
                           .zero = {Angle::degrees(30), Angle::degrees(-10)},
                           .serial_number = "42",
                           .has_enable = false}) {}
};

TEST_F(PiGcsMountedTest, TheControllerCountsFromItsOwnZeroInItsOwnSense) {
  EXPECT_EQ(ask("SAI?"), "A \nB\n");
  EXPECT_EQ(ask("TMN?"), "A=-330.000000 \nB=-370.000000\n");
  EXPECT_EQ(ask("TMX?"), "A=390.000000 \nB=350.000000\n");
  ask("SVO A 1 B 1");
  ask("FRF");
  wait_until_stopped();
  EXPECT_EQ(ask("POS?"), "A=0.000000 \nB=0.000000\n");  // the reference switch is the controller's zero
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, host.clock().now()).deg(), 30.0);
  EXPECT_EQ(bench->commanded_angle(StageAxis::kZ, host.clock().now()).deg(), 10.0);
  ask("MOV A 120 B -100");
  wait_until_stopped();
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, host.clock().now()).deg(), -90.0);
  EXPECT_EQ(bench->commanded_angle(StageAxis::kZ, host.clock().now()).deg(), -90.0);
  EXPECT_EQ(ask("POS?"), "A=120.000000 \nB=-100.000000\n");
}

TEST_F(PiGcsMountedTest, AControllerWithoutEnableSaysUnknownCommand) {
  EXPECT_EQ(command("EAX A 1"), "2\n");
  EXPECT_THAT(ask("HLP?"), testing::Not(HasSubstr("EAX")));
}

class PiGcsChainTest : public PiGcsFirmwareTest {
 protected:
  PiGcsChainTest() : PiGcsFirmwareTest({.address = 3}) {}
};

TEST_F(PiGcsChainTest, AnswersItsOwnAddressOnly) {
  EXPECT_EQ(ask("3 CSV?"), "0 3 2.0\n");
  EXPECT_EQ(ask("3 0 POS? 1"), "0 3 1=0.000000\n");
  EXPECT_EQ(ask("3 SAI?"), "0 3 1 \n2\n");
  EXPECT_EQ(host.exchange("3 \x05"), "0 3 0\n");
  EXPECT_EQ(host.exchange("3 \x07"), "0 3 \xB1\n");
  EXPECT_EQ(host.exchange("3 ERR?\n3 \x05"), "0 3 0\n0 3 0\n");  // as odemis: two commands in one write
  EXPECT_EQ(ask("CSV?"), "");
  EXPECT_EQ(ask("2 CSV?"), "");
  EXPECT_EQ(host.exchange("\x05"), "");
  EXPECT_EQ(ask("3 ERR?"), "0 3 0\n");
}

class PiGcsOneAxisTest : public PiGcsFirmwareTest {
 protected:
  PiGcsOneAxisTest() : PiGcsFirmwareTest({.axis_names = {"", "1"}, .model = "C-863.11"}) {}
};

TEST_F(PiGcsOneAxisTest, AControllerMayHaveOneOfTheAxes) {
  EXPECT_EQ(ask("SAI?"), "1\n");
  EXPECT_EQ(ask("POS?"), "1=0.000000\n");
  ask("SVO 1 1");
  ask("FRF 1");
  wait_until_stopped();
  ask("MOV 1 7");
  EXPECT_EQ(host.exchange("\x05"), "1\n");
  wait_until_stopped();
  EXPECT_EQ(bench->commanded_angle(StageAxis::kZ, host.clock().now()).deg(), 7.0);
}

TEST(PiGcsSettingsTest, RefusesASignThatIsNone) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  EXPECT_THROW(PiGcsFirmware(bench, {.sign = {1, 0}}), std::invalid_argument);
  EXPECT_THROW(PiGcsFirmware(bench, {.axis_names = {"1", "1"}}), std::invalid_argument);
}

TEST(PiGcsSettingsTest, AnE861TellsItsUnitByAParameterOnly) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  PiGcsFirmware firmware(bench, {.model = "E-861",
                                 .firmware_version = "7.2.0",
                                 .has_enable = false,
                                 .has_unit_query = false,
                                 .short_identity = true});
  FirmwareHost host(firmware);
  EXPECT_EQ(host.exchange("*IDN?\n"), "(c)2013 Physik Instrumente(PI) Karlsruhe, E-861 Version 7.2.0\n");
  EXPECT_EQ(host.exchange("PUN? 1\n"), "");
  EXPECT_EQ(host.exchange("ERR?\n"), "2\n");
  EXPECT_EQ(host.exchange("SPA? 1 0x7000601\n"), "1 0x7000601=DEG\n");
  EXPECT_THAT(host.exchange("HLP?\n"), testing::Not(HasSubstr("PUN?")));
}

TEST_F(PiGcsFirmwareTest, WithoutPowerItStopsAndStartsWithoutReference) {
  reference();
  EXPECT_EQ(command("VEL 1 5"), "0\n");
  EXPECT_EQ(command("MOV 1 90"), "0\n");
  host.listen(seconds(1));
  firmware.power(false, host.clock().now());
  const double there = bench->commanded_angle(StageAxis::kX, host.clock().now() + seconds(1)).deg();
  EXPECT_GT(there, 1.0);
  EXPECT_LT(there, 10.0);
  host.listen(seconds(5));
  firmware.power(true, host.clock().now());
  EXPECT_EQ(ask("FRF?"), "1=0 \n2=0\n");
  EXPECT_EQ(ask("SVO?"), "1=0 \n2=0\n");
  EXPECT_EQ(ask("VEL? 1"), "1=20.000000\n") << "not saved";
  EXPECT_EQ(ask("ERR?"), "0\n");
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, host.clock().now()).deg(), there);
}

class PiGcsTwoInAChainTest : public PiGcsFirmwareTest {
 protected:
  PiGcsTwoInAChainTest() : PiGcsFirmwareTest({.axis_names = {"1 1", "3 1"}, .model = "C-863.12"}) {}
};

TEST_F(PiGcsTwoInAChainTest, EachControllerAnswersToItsAddress) {
  EXPECT_THAT(ask("*IDN?"), HasSubstr("118001234")) << "the first one also without an address";
  EXPECT_THAT(ask("1 *IDN?"), StartsWith("0 1 (c)"));
  EXPECT_THAT(ask("3 *IDN?"), testing::AllOf(StartsWith("0 3 (c)"), HasSubstr("118001235")));
  EXPECT_EQ(ask("2 *IDN?"), "");
  EXPECT_EQ(ask("3 SAI?"), "0 3 1\n");
  EXPECT_EQ(ask("3 NOPE"), "");
  EXPECT_EQ(ask("1 ERR?"), "0 1 0\n") << "the other one's errors are not its own";
  EXPECT_EQ(ask("3 ERR?"), "0 3 2\n");
}

TEST_F(PiGcsTwoInAChainTest, OneThatIsCutOffNeitherHearsNorAnswersAndMovesOn) {
  for (const std::string address : {"1 ", "3 "}) {
    ask(address + "SVO 1 1");
    ask(address + "FRF 1");
  }
  host.listen(seconds(1));
  ask("1 MOV 1 10");
  ask("3 MOV 1 10");
  const Clock::Instant now = host.clock().now();
  bench->inject(
      {.kind = FaultKind::kLostController, .at = now, .until = now + seconds(5), .axis = StageAxis::kZ});
  EXPECT_EQ(ask("3 POS?"), "");
  ask("1 STP");
  ask("3 STP");
  EXPECT_EQ(ask("1 ERR?"), "0 1 10\n") << "the other one is there";
  host.listen(seconds(5));
  EXPECT_EQ(ask("3 POS?"), "0 3 1=10.000000\n");
  EXPECT_EQ(ask("3 ERR?"), "0 3 0\n");
  EXPECT_LT(bench->commanded_angle(StageAxis::kX, host.clock().now()).deg(), 5.0);
}

TEST_F(PiGcsTwoInAChainTest, TheirAxesAreTheTwoOfTheWorld) {
  for (const std::string address : {"1 ", "3 "}) {
    ask(address + "SVO 1 1");
    ask(address + "FRF 1");
  }
  host.listen(seconds(1));
  ask("3 MOV 1 10");
  EXPECT_EQ(host.exchange("3 \x05\n"), "0 3 1\n");
  EXPECT_EQ(host.exchange("1 \x05\n"), "0 1 0\n");
  host.listen(seconds(5));
  EXPECT_EQ(bench->commanded_angle(StageAxis::kZ, host.clock().now()).deg(), 10.0);
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, host.clock().now()).deg(), 0.0);
  // Alone #24 stops the first one only.
  ask("1 MOV 1 90");
  ask("3 MOV 1 90");
  host.send("\x18");
  EXPECT_EQ(ask("1 ERR?"), "0 1 10\n");
  EXPECT_EQ(ask("3 ERR?"), "0 3 0\n");
  host.listen(seconds(1));
  EXPECT_EQ(host.exchange("3 \x05\n"), "0 3 1\n");
  ask("3 STP");
  host.listen(milliseconds(100));
  EXPECT_EQ(host.exchange("3 \x05\n"), "0 3 0\n");
}

}  // namespace
}  // namespace abcal::sim
