#include "sim/firmware/zaber_ascii_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <stdexcept>
#include <string>

#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/zaber_ascii/stage.h"
#include "sim/firmware/firmware_stream.h"
#include "tests/sim/firmware_host.h"
#include "tests/support/error_of.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::error_of;
using testing::HasSubstr;
using testing::StartsWith;

constexpr double kStepsPerDegree = 384000.0 / 360.0;

class ZaberAsciiFirmwareTest : public testing::Test {
 protected:
  explicit ZaberAsciiFirmwareTest(ZaberAsciiSettings settings = {}, BenchTruth truth = {})
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  std::string ask(std::string_view command) {
    host.send(std::string(command) + "\n");
    return host.listen(milliseconds(2));
  }
  void home_all() {
    ask("/home");
    host.listen(milliseconds(300));
    ask("/warnings clear");
  }
  Clock::Instant now() { return host.clock().now(); }
  double angle_deg(StageAxis axis) { return bench->commanded_angle(axis, now()).deg(); }

  std::shared_ptr<SimBench> bench;
  ZaberAsciiFirmware firmware;
  FirmwareHost host;
};

TEST_F(ZaberAsciiFirmwareTest, AnswersWhatAHostOfARotaryStageAsks) {
  EXPECT_EQ(ask("/"), "@01 0 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/get deviceid"), "@01 0 OK IDLE WR 30222\r\n");
  EXPECT_EQ(ask("/1 get system.serial"), "@01 0 OK IDLE WR 54321\r\n");
  EXPECT_EQ(ask("/1 get system.axiscount"), "@01 0 OK IDLE WR 2\r\n");
  EXPECT_EQ(ask("/1 get version"), "@01 0 OK IDLE WR 7.38\r\n");
  EXPECT_EQ(ask("/1 get limit.cycle.dist"), "@01 0 OK IDLE WR 384000 384000\r\n");
  EXPECT_EQ(ask("/1 2 get limit.cycle.dist"), "@01 2 OK IDLE WR 384000\r\n");
  EXPECT_EQ(ask("/1 get resolution"), "@01 0 OK IDLE WR 64 64\r\n");
  EXPECT_EQ(ask("/1 1 get limit.min"), "@01 1 OK IDLE WR -384000\r\n");
  EXPECT_EQ(ask("/1 1 get limit.max"), "@01 1 OK IDLE WR 384000\r\n");
  EXPECT_EQ(ask("/1 1 get pos"), "@01 1 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/1 1 get encoder.pos"), "@01 1 OK IDLE WR 0.00\r\n");
  // 20 degrees/s and 80 degrees/s2: 21333.3 and 85333.3 microsteps.
  EXPECT_EQ(ask("/1 1 get maxspeed"), "@01 1 OK IDLE WR 34953\r\n");
  EXPECT_EQ(ask("/1 1 get accel"), "@01 1 OK IDLE WR 14\r\n");
  EXPECT_EQ(ask("/1 get system.temperature"), "@01 0 OK IDLE WR 23.0\r\n");
  EXPECT_EQ(ask("/1 system reset"), "@01 0 OK IDLE WR 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, AnswersWhatZabersOwnProgramsAsk) {
  EXPECT_EQ(ask("/1 get device.id"), "@01 0 OK IDLE WR 30222\r\n");
  EXPECT_EQ(ask("/1 get peripheral.id"), "@01 0 OK IDLE WR 70009 70009\r\n");
  EXPECT_EQ(ask("/1 1 get peripheralid"), "@01 1 OK IDLE WR 70009\r\n");
  EXPECT_EQ(ask("/1 get version.build"), "@01 0 OK IDLE WR 16432\r\n");
  EXPECT_EQ(ask("/1 get system.access"), "@01 0 OK IDLE WR 1\r\n");
  EXPECT_EQ(ask("/1 set system.access 2"), "@01 0 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/1 get system.access"), "@01 0 OK IDLE WR 2\r\n");
  EXPECT_EQ(ask("/1 set system.access 3"), "@01 0 RJ IDLE WR BADDATA\r\n");
  EXPECT_THAT(ask("/1 get system.voltage"), testing::MatchesRegex("@01 0 OK IDLE WR [0-9]+\\.[0-9]\r\n"));
  EXPECT_EQ(ask("/1 1 get system.voltage"), "@01 1 RJ IDLE WR DEVICEONLY\r\n");
  EXPECT_EQ(ask("/1 set system.voltage 5"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 get comm.packet.size.max"), "@01 0 OK IDLE WR 80\r\n");
  EXPECT_EQ(ask("/1 get motion.busy"), "@01 0 OK IDLE WR 0 0\r\n");
  EXPECT_EQ(ask("/1 get cloop.enable"), "@01 0 OK IDLE WR 1 1\r\n");
  EXPECT_EQ(ask("/1 2 set cloop.enable 0"), "@01 2 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/1 get cloop.enable"), "@01 0 OK IDLE WR 1 0\r\n");
  EXPECT_EQ(ask("/1 io info"), "@01 0 OK IDLE WR 0 0 0 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, GetsSeveralSettingsAtOnce) {
  EXPECT_EQ(ask("/1 1 get pos resolution limit.cycle.dist"), "@01 1 OK IDLE WR 0; 64; 384000\r\n");
  EXPECT_EQ(ask("/1 get pos deviceid"), "@01 0 OK IDLE WR 0 0; 30222\r\n");
  EXPECT_EQ(ask("/1 1 get pos nonsense"), "@01 1 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 1 get pos pos pos pos pos pos pos pos pos pos pos"), "@01 1 RJ IDLE WR BADDATA\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, TellsItsSpeedOnTheWay) {
  home_all();
  ask("/1 1 move abs 192000");
  host.listen(seconds(1));
  EXPECT_EQ(ask("/1 1 get vel"), "@01 1 OK BUSY -- 34953\r\n");  // that of maxspeed
  EXPECT_EQ(ask("/1 1 get motion.busy"), "@01 1 OK BUSY -- 1\r\n");
  host.listen(seconds(20));
  EXPECT_EQ(ask("/1 1 get vel"), "@01 1 OK IDLE -- 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, NumbersAreDigits) {
  home_all();
  for (const char* number : {"1e3", "+1000", "0x10", "inf", "nan", "1,5", "--5", "", "5-"})
    EXPECT_EQ(ask(std::string("/1 1 move abs ") + number), "@01 1 RJ IDLE -- BADDATA\r\n") << number;
  EXPECT_EQ(angle_deg(StageAxis::kX), 0.0);
  EXPECT_EQ(ask("/1 1 move abs 1000"), "@01 1 OK BUSY -- 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, StoresPositions) {
  home_all();
  EXPECT_EQ(ask("/1 1 tools storepos 3 9600"), "@01 1 OK IDLE -- 0\r\n");
  EXPECT_EQ(ask("/1 1 tools storepos 3"), "@01 1 OK IDLE -- 9600\r\n");
  EXPECT_EQ(ask("/1 1 move stored 3"), "@01 1 OK BUSY -- 0\r\n");
  host.listen(seconds(5));
  EXPECT_EQ(ask("/1 1 get pos"), "@01 1 OK IDLE -- 9600\r\n");
  EXPECT_EQ(ask("/1 1 move stored 17"), "@01 1 RJ IDLE -- BADDATA\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, WhatItDoesNotKnowIsNotedOnce) {
  EXPECT_EQ(ask("/1 pvt 1 setup disable"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 pvt buffer 1 erase"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 get motor.inductance"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  const auto unserved = firmware.unserved().all();
  ASSERT_EQ(unserved.size(), 2U);
  EXPECT_EQ(unserved[0].command, "pvt");
  EXPECT_EQ(unserved[0].count, 2U);
  EXPECT_EQ(unserved[1].command, "get motor.inductance");
}

TEST_F(ZaberAsciiFirmwareTest, ANewSessionStartsWithAnEmptyLine) {
  home_all();
  host.send("/1 1 move abs 1");
  firmware.session_starts();
  EXPECT_EQ(ask("20"), "");
  EXPECT_EQ(angle_deg(StageAxis::kX), 0.0);
}

TEST(ZaberAsciiFirmware6Test, KnowsTheNamesOfItsTime) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  ZaberAsciiFirmware firmware(bench, {.axis_names = {"1", ""}, .version = "6.28"});
  FirmwareHost host(firmware);
  const auto ask = [&](const std::string& command) {
    host.send(command + "\n");
    return host.listen(milliseconds(2));
  };
  EXPECT_EQ(ask("/1 get deviceid"), "@01 0 OK IDLE WR 50009\r\n");
  EXPECT_EQ(ask("/1 get system.voltage"), "@01 0 OK IDLE WR 48.1\r\n");
  for (const char* newer : {"device.id", "cloop.enable", "motion.busy", "peripheral.id", "peripheralid"})
    EXPECT_EQ(ask(std::string("/1 get ") + newer), "@01 0 RJ IDLE WR BADCOMMAND\r\n") << newer;
  EXPECT_EQ(ask("/1 get pos resolution"), "@01 0 RJ IDLE WR BADDATA\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, TakesTheHeadersAndLineEndsOfDifferentHosts) {
  for (const char* command : {"/1 2 get pos", "/01 2 get pos", "/0 2 get pos", "/ 1  2   get  pos ",
                              "noise/1 2 get pos", "/1 2 -- get pos"})
    EXPECT_EQ(ask(command), "@01 2 OK IDLE WR 0\r\n") << command;
  EXPECT_EQ(ask("/1 2 7 get pos"), "@01 2 07 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/1 0 0"), "@01 0 00 OK IDLE WR 0\r\n");
  host.send("/1 1 ");
  host.send("get pos\r\n/1\r");
  EXPECT_EQ(host.listen(milliseconds(2)), "@01 1 OK IDLE WR 0\r\n@01 0 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/2 get pos"), "") << "no such device";
  EXPECT_EQ(ask("get pos"), "");
  EXPECT_EQ(ask("/1 get\x01 pos"), "");
  EXPECT_EQ(ask("/1 tools echo " + std::string(3000, 'A')), "");
  EXPECT_EQ(ask("/1"), "@01 0 OK IDLE WR 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, TakesTheChecksumsOfThePublishedVectorsAndAnswersWithOne) {
  // The LRC of "01 0 OK IDLE WR tools" and so on is not published: it must sum to 0 with its bytes.
  const auto sum_of = [](const std::string& reply) {
    const std::size_t colon = reply.find(':');
    unsigned sum = static_cast<unsigned>(std::stoi(reply.substr(colon + 1, 2), nullptr, 16));
    for (const char c : reply.substr(1, colon - 1)) sum += static_cast<unsigned char>(c);
    return sum % 256;
  };
  for (const char* command : {"/1 tools echo:BF", "/get maxspeed:49", "/1:CF", "/0 1:7F"}) {
    const std::string reply = ask(command);
    ASSERT_THAT(reply, testing::ContainsRegex("^@01 . OK IDLE WR .*:[0-9A-F][0-9A-F]\r\n$")) << command;
    EXPECT_EQ(sum_of(reply), 0U) << reply;
  }
  EXPECT_EQ(ask("/1 tools echo:BE"), "") << "damaged";
  EXPECT_EQ(ask("/1 tools echo:B"), "");
  EXPECT_EQ(ask("/1 tools echo:xy"), "");
  EXPECT_EQ(ask("/1"), "@01 0 OK IDLE WR 0\r\n") << "without one there is none";
  ask("/1 set comm.checksum 1");
  EXPECT_EQ(sum_of(ask("/1")), 0U) << "now there is one";
  ask("/1 set comm.checksum 0");
  EXPECT_EQ(ask("/1"), "@01 0 OK IDLE WR 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, TakesTheContinuedCommandOfThePublishedVectorAndContinuesItsReply) {
  EXPECT_EQ(ask("/1 tools echo aaaaaaaaaa bbbbbbbbbb ccccccccc dddddddddd eeeeeeeeee\\:D0"), "");
  const std::string reply = ask("/1 cont 1 ffffffffff gggggggggg hhhhhhhhhh iiiiiiiiii jjjjjjjjj:24");
  const std::size_t second = reply.find('\n') + 1;
  EXPECT_THAT(reply, StartsWith("@01 0 OK IDLE WR aaaaaaaaaa bbbbbbbbbb ccccccccc dddddddddd eeeeeeeeee\\:"));
  EXPECT_THAT(reply.substr(second), StartsWith("#01 0 cont 1 ffffffffff gggggggggg"));
  EXPECT_LE(second, 80U);
  EXPECT_LE(reply.size() - second, 80U);
  // A part that is missing: the command is not run.
  ask("/1 tools echo a\\");
  EXPECT_EQ(ask("/1 cont 2 b"), "");
}

TEST_F(ZaberAsciiFirmwareTest, RejectsWithTheReasonsOfTheManual) {
  EXPECT_EQ(ask("/1 3 home"), "@01 3 RJ IDLE -- BADAXIS\r\n");
  EXPECT_EQ(ask("/1 dance"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 get dance"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 set version 1"), "@01 0 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 1 move sideways 1"), "@01 1 RJ IDLE WR BADCOMMAND\r\n");
  EXPECT_EQ(ask("/1 1 get deviceid"), "@01 1 RJ IDLE WR DEVICEONLY\r\n");
  EXPECT_EQ(ask("/1 1 renumber"), "@01 1 RJ IDLE WR DEVICEONLY\r\n");
  for (const char* data : {"move abs", "move abs x", "move abs 1.5", "move abs 1 2", "move abs 384001",
                           "move abs -384001", "move abs 1e300", "move vel 99999999", "set maxspeed 0",
                           "set limit.min 500000", "set knob.enable 2", "home now"})
    EXPECT_EQ(ask("/1 1 " + std::string(data)), "@01 1 RJ IDLE WR BADDATA\r\n") << data;
  EXPECT_EQ(ask("/1 1 100 get pos"), "@01 1 RJ IDLE WR BADMESSAGEID\r\n");
  EXPECT_EQ(ask("/1 renumber 100"), "@01 0 RJ IDLE WR BADDATA\r\n");
  ask("/1 1 driver disable");
  EXPECT_EQ(ask("/1 1 home"), "@01 1 RJ IDLE FD DRIVERDISABLED\r\n");
  ask("/1 1 driver enable");
  ask("/1 1 tools parking park");
  EXPECT_EQ(ask("/1 1 home"), "@01 1 RJ IDLE WR PARKED\r\n");
  ask("/1 1 tools parking unpark");
  ask("/1 1 move abs 100000");
  EXPECT_EQ(ask("/1 1 set pos 0"), "@01 1 RJ BUSY WR STATUSBUSY\r\n");
  EXPECT_EQ(ask("/1 1 set resolution 32"), "@01 1 RJ BUSY WR STATUSBUSY\r\n");
  EXPECT_EQ(ask("/1 renumber"), "@01 0 RJ BUSY WR STATUSBUSY\r\n");
  EXPECT_EQ(bench->target(StageAxis::kZ, now()).deg(), 0.0) << "nothing of this has moved Z";
}

TEST_F(ZaberAsciiFirmwareTest, IsBusyExactlyAsLongAsTheMotionLasts) {
  home_all();
  EXPECT_EQ(ask("/1"), "@01 0 OK IDLE -- 0\r\n");
  const Clock::Instant start = now();
  EXPECT_EQ(ask("/1 1 move abs 96000"), "@01 1 OK BUSY -- 0\r\n");  // 90 degrees
  const Clock::Duration lasts = bench->motion_end(StageAxis::kX, start) - start;
  EXPECT_EQ(lasts, milliseconds(4750));  // at 20 deg/s and 80 deg/s2
  host.listen(lasts - milliseconds(2) - Clock::Duration(1));
  host.send("/1 1\n/1 2\n");
  host.listen(Clock::Duration(1));
  host.send("/1 1\n/1 1 get pos\n");
  EXPECT_EQ(host.listen(milliseconds(2)),
            "@01 1 OK BUSY -- 0\r\n@01 2 OK IDLE -- 0\r\n@01 1 OK IDLE -- 0\r\n@01 1 OK IDLE -- 96000\r\n");
  EXPECT_EQ(angle_deg(StageAxis::kX), 90.0);
  EXPECT_EQ(angle_deg(StageAxis::kZ), 0.0);
}

TEST_F(ZaberAsciiFirmwareTest, MovesInAllTheWaysThatThereAre) {
  home_all();
  ask("/1 move abs 10667");  // both axes, to 10 degrees or so
  host.listen(seconds(2));
  EXPECT_EQ(ask("/1 get pos"), "@01 0 OK IDLE -- 10667 10667\r\n");
  ask("/1 2 move rel -667");
  host.listen(seconds(1));
  EXPECT_EQ(ask("/1 get pos"), "@01 0 OK IDLE -- 10667 10000\r\n");
  // 10 degrees/s: microsteps per second times 1.6384.
  ask("/1 1 move vel 17476");
  host.listen(seconds(1));
  const double before = angle_deg(StageAxis::kX);
  host.listen(seconds(1));
  EXPECT_NEAR(angle_deg(StageAxis::kX) - before, 10.0, 1e-3);
  EXPECT_EQ(ask("/1 1 get maxspeed"), "@01 1 OK BUSY -- 34953\r\n") << "that of the other moves stays";
  ask("/1 1 move vel 0");
  host.listen(seconds(1));
  EXPECT_EQ(ask("/1 1"), "@01 1 OK IDLE NI 0\r\n");
  ask("/1 1 move min");
  ask("/1 2 move max");
  host.listen(seconds(30));
  EXPECT_EQ(ask("/1 get pos"), "@01 0 OK IDLE -- -384000 384000\r\n");
  EXPECT_EQ(angle_deg(StageAxis::kX), -360.0);
}

TEST_F(ZaberAsciiFirmwareTest, StopsAnAxisOrAllAndSaysThatTheMoveWasInterrupted) {
  for (const char* stop : {"/stop", "/1 stop", "/0 0 estop"}) {
    home_all();
    host.listen(seconds(3));
    ask("/1 move abs 96000");
    host.listen(seconds(1));
    EXPECT_EQ(ask(stop), "@01 0 OK BUSY NI 0\r\n");
    host.listen(milliseconds(300));  // 20 deg/s at 80 deg/s2: 250 ms
    EXPECT_EQ(ask("/1"), "@01 0 OK IDLE NI 0\r\n") << stop;
    EXPECT_GT(angle_deg(StageAxis::kX), 15.0);
    EXPECT_LT(angle_deg(StageAxis::kZ), 21.0);
    EXPECT_EQ(ask("/1 warnings"), "@01 0 OK IDLE NI 01 NI\r\n");
    EXPECT_EQ(ask("/1 warnings clear"), "@01 0 OK IDLE -- 01 NI\r\n");
    EXPECT_EQ(ask("/1 warnings"), "@01 0 OK IDLE -- 00\r\n");
    EXPECT_EQ(ask("/1 stop"), "@01 0 OK IDLE -- 0\r\n") << "there is nothing to interrupt";
  }
  ask("/1 move abs 0");
  ask("/1 2 stop");
  host.listen(milliseconds(300));
  EXPECT_EQ(ask("/1 1") + ask("/1 2"), "@01 1 OK BUSY -- 0\r\n@01 2 OK IDLE NI 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, AHomingCutShortFindsNothing) {
  ask("/1 2 move abs 20000");
  host.listen(seconds(3));
  EXPECT_EQ(ask("/1 2 home"), "@01 2 OK BUSY WR 0\r\n");
  host.listen(milliseconds(300));
  ask("/1 2 stop");
  host.listen(seconds(1));
  EXPECT_EQ(ask("/1 2 warnings"), "@01 2 OK IDLE WR 02 WR NI\r\n");
  ask("/1 2 home");
  host.listen(seconds(3));
  EXPECT_EQ(ask("/1 2 warnings"), "@01 2 OK IDLE -- 00\r\n");
  EXPECT_EQ(ask("/1 2 get limit.home.triggered"), "@01 2 OK IDLE -- 1\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, SettingsAreWrittenAndUsed) {
  home_all();
  EXPECT_EQ(ask("/1 1 set maxspeed 69905"), "@01 1 OK IDLE -- 0\r\n");  // 40 degrees/s
  EXPECT_EQ(ask("/1 get maxspeed"), "@01 0 OK IDLE -- 69905 34953\r\n");
  EXPECT_EQ(ask("/1 1 set motion.accelonly 28"), "@01 1 OK IDLE -- 0\r\n");
  EXPECT_EQ(ask("/1 1 get accel") + ask("/1 1 get motion.decelonly"),
            "@01 1 OK IDLE -- 28\r\n@01 1 OK IDLE -- 14\r\n");
  EXPECT_EQ(bench->motion_limits(StageAxis::kX).speed_deg_per_s, 69905 / 1.6384 / kStepsPerDegree);
  EXPECT_NEAR(bench->motion_limits(StageAxis::kX).acceleration_deg_per_s2, 160.0, 1.0);
  ask("/1 set limit.max 1000");
  EXPECT_EQ(ask("/1 1 move abs 1001"), "@01 1 RJ IDLE -- BADDATA\r\n");
  EXPECT_EQ(ask("/1 1 move abs 1000"), "@01 1 OK BUSY -- 0\r\n");
  host.listen(seconds(1));
  ask("/1 1 set resolution 128");
  EXPECT_EQ(ask("/1 1 get pos") + ask("/1 1 get limit.max") + ask("/1 1 get limit.cycle.dist"),
            "@01 1 OK IDLE -- 2000\r\n@01 1 OK IDLE -- 2000\r\n@01 1 OK IDLE -- 768000\r\n");
  ask("/1 1 set pos 0");
  EXPECT_EQ(ask("/1 1 get pos"), "@01 1 OK IDLE -- 0\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, ListsItsCommandsAsInfoBehindTheReply) {
  const std::string reply = ask("/1 0 42 help");
  EXPECT_THAT(reply, StartsWith("@01 0 42 OK IDLE WR 0\r\n#01 0 42 driver "));
  EXPECT_THAT(reply, HasSubstr("#01 0 42 renumber (device)\r\n"));
}

TEST_F(ZaberAsciiFirmwareTest, AlertsComeBetweenTheReplies) {
  home_all();
  EXPECT_EQ(ask("/1 set comm.alert 1"), "@01 0 OK IDLE -- 0\r\n");
  ask("/1 1 move abs 96000");
  ask("/1 2 move abs 21333");  // 20 degrees: 1.25 s
  EXPECT_EQ(host.listen(milliseconds(1247)), "");
  host.send("/1 2\n");
  EXPECT_EQ(host.listen(milliseconds(2)), "@01 2 OK BUSY -- 0\r\n!01 2 IDLE --\r\n");
  EXPECT_EQ(host.listen(seconds(5)), "!01 1 IDLE --\r\n");
  ask("/1 set comm.checksum 1");
  ask("/1 2 move abs 0");
  EXPECT_EQ(host.listen(seconds(5)), "!01 2 IDLE --:95\r\n");
}

TEST_F(ZaberAsciiFirmwareTest, ShowsTheFaultsOfTheWorld) {
  home_all();
  bench->inject(
      {.kind = FaultKind::kRefusedMove, .at = now(), .until = now() + seconds(1), .axis = StageAxis::kZ});
  EXPECT_EQ(ask("/1 2 move abs 5"), "@01 2 RJ IDLE -- PARKED\r\n");
  EXPECT_EQ(ask("/1 1 move abs 5"), "@01 1 OK BUSY -- 0\r\n");
  host.listen(seconds(1));
  bench->inject(
      {.kind = FaultKind::kLostReference, .at = now(), .until = now() + seconds(1), .axis = StageAxis::kX});
  EXPECT_EQ(ask("/1 1") + ask("/1 2"), "@01 1 OK IDLE WR 0\r\n@01 2 OK IDLE -- 0\r\n");
  ask("/1 set comm.alert 1");
  ask("/1 2 move abs 96000");
  bench->inject({.kind = FaultKind::kStalledAxis, .at = now() + seconds(1), .axis = StageAxis::kZ});
  EXPECT_EQ(host.listen(milliseconds(990)), "");
  EXPECT_EQ(host.listen(milliseconds(100)), "!01 2 IDLE FS\r\n");
  const double there = angle_deg(StageAxis::kZ);
  EXPECT_EQ(ask("/1 2"), "@01 2 OK IDLE FS 0\r\n");
  EXPECT_EQ(ask("/1 2 warnings clear"), "@01 2 OK IDLE -- 01 FS\r\n");
  host.listen(seconds(10));
  EXPECT_EQ(angle_deg(StageAxis::kZ), there);
}

class ZaberWithoutEncoderTest : public ZaberAsciiFirmwareTest {
 protected:
  ZaberWithoutEncoderTest()
      : ZaberAsciiFirmwareTest(
            {.version = "6.28", .keeps_position_without_power = true, .detects_stalls = false}) {}
};

TEST_F(ZaberWithoutEncoderTest, DoesNotNoticeAStallAndKnowsNoDriverCommand) {
  EXPECT_EQ(ask("/1 1"), "@01 1 OK IDLE WH 0\r\n");
  EXPECT_EQ(ask("/1 1 driver enable"), "@01 1 RJ IDLE WH BADCOMMAND\r\n");
  bench->inject({.kind = FaultKind::kStalledAxis, .at = now() + seconds(1), .axis = StageAxis::kX});
  ask("/1 1 move abs 96000");
  host.listen(seconds(100));
  EXPECT_EQ(ask("/1 1"), "@01 1 OK BUSY WH 0\r\n");
  ask("/1 1 stop");
  EXPECT_EQ(ask("/1 1"), "@01 1 OK IDLE WH 0\r\n");
}

class ZaberChainTest : public ZaberAsciiFirmwareTest {
 protected:
  ZaberChainTest()
      : ZaberAsciiFirmwareTest({.axis_names = {"2 1", "1 1"},
                                .sign = {-1, +1},
                                .zero = {Angle::degrees(30), Angle::degrees(-10)}}) {}
};

TEST_F(ZaberChainTest, AllDevicesAnswerABroadcast) {
  EXPECT_EQ(ask("/0 0 9 get deviceid"), "@01 0 09 OK IDLE WR 50009\r\n@02 0 09 OK IDLE WR 50009\r\n");
  EXPECT_EQ(ask("/get system.serial"), "@01 0 OK IDLE WR 54322\r\n@02 0 OK IDLE WR 54321\r\n");
  EXPECT_EQ(ask("/get system.axiscount"), "@01 0 OK IDLE WR 1\r\n@02 0 OK IDLE WR 1\r\n");
  EXPECT_EQ(ask("/2 2 get pos"), "@02 2 RJ IDLE -- BADAXIS\r\n");
  EXPECT_EQ(ask("/2 renumber 5"), "@05 0 OK IDLE WR 0\r\n");
  EXPECT_EQ(ask("/2"), "");
  EXPECT_EQ(ask("/renumber"), "@01 0 OK IDLE WR 0\r\n@02 0 OK IDLE WR 0\r\n");
}

TEST_F(ZaberChainTest, OneThatIsCutOffNeitherHearsNorAnswersAndMovesOn) {
  ask("/home");
  host.listen(seconds(5));
  ask("/1 set comm.alert 1");
  ask("/1 1 move rel 10000");
  ask("/2 1 move rel 10000");
  const Clock::Instant now = host.clock().now();
  bench->inject(
      {.kind = FaultKind::kLostController, .at = now, .until = now + seconds(5), .axis = StageAxis::kZ});
  EXPECT_EQ(ask("/get system.axiscount"), "@02 0 OK BUSY -- 1\r\n");
  EXPECT_EQ(ask("/1 1"), "");
  ask("/stop");
  EXPECT_EQ(host.listen(seconds(6)), "") << "nor does it send an alert";
  EXPECT_EQ(ask("/1 1 warnings"), "@01 1 OK IDLE -- 00\r\n") << "it was not stopped";
  EXPECT_EQ(ask("/2 1 warnings"), "@02 1 OK IDLE NI 01 NI\r\n");
}

TEST_F(ZaberChainTest, CountsFromItsOwnZeroInItsOwnSenseOnceHomed) {
  EXPECT_EQ(ask("/get pos"), "@01 0 OK IDLE WR 0\r\n@02 0 OK IDLE WR 0\r\n") << "wherever they are";
  ask("/home");
  host.listen(seconds(3));
  EXPECT_EQ(ask("/get pos"), "@01 0 OK IDLE -- 0\r\n@02 0 OK IDLE -- 0\r\n");
  EXPECT_EQ(angle_deg(StageAxis::kX), 30.0);
  EXPECT_EQ(angle_deg(StageAxis::kZ), 10.0);
  ask("/2 move abs 32000");
  ask("/1 1 move abs -10667");
  host.listen(seconds(5));
  EXPECT_EQ(angle_deg(StageAxis::kX), 0.0);
  EXPECT_NEAR(angle_deg(StageAxis::kZ), 0.0, 0.5 / kStepsPerDegree);
}

class ZaberHalfAControllerTest : public ZaberAsciiFirmwareTest {
 protected:
  ZaberHalfAControllerTest() : ZaberAsciiFirmwareTest({.axis_names = {"2", ""}, .address = 4}) {}
};

TEST_F(ZaberHalfAControllerTest, AnAxisThatIsNotConnectedIsNotThere) {
  EXPECT_EQ(ask("/get pos"), "@04 0 OK IDLE WR NA 0\r\n");
  EXPECT_EQ(ask("/4 get peripheralid"), "@04 0 OK IDLE WR 0 70009\r\n");
  EXPECT_EQ(ask("/4 1 home"), "@04 1 RJ IDLE -- INACTIVE\r\n");
  EXPECT_EQ(ask("/4 home"), "@04 0 OK BUSY WR 0\r\n");
}

TEST(ZaberAsciiSettingsTest, RefusesWhatCannotBe) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  EXPECT_THROW(ZaberAsciiFirmware(bench, {.sign = {1, 0}}), std::invalid_argument);
  for (const char* name : {"1 1", "01 1", "1", "0", "1 10", "100 1", "A", "1 2 3", "1 0", " "})
    EXPECT_THROW(ZaberAsciiFirmware(bench, {.axis_names = {"1 1", name}}), std::invalid_argument) << name;
}

// End to end with the driver, which was written independently.

struct DriverCase {
  const char* name;
  ZaberAsciiSettings firmware;
};

class ZaberDriverTest : public testing::TestWithParam<DriverCase> {
 protected:
  ZaberDriverTest() {
    StageSettings settings;
    settings.axis_names = GetParam().firmware.axis_names;
    settings.speed_deg_per_s = {40.0, std::nullopt};
    stage = std::make_unique<zaber_ascii::ZaberAsciiStage>(std::make_unique<FirmwareStream>(firmware, clock),
                                                           clock, settings);
  }
  void home_both() {
    for (const StageAxis axis : kStageAxes) {
      stage->home(axis);
      EXPECT_EQ(stage->motion_state(axis), MotionState::kMoving);
      wait(axis);
    }
  }
  /// How long it has moved, to 10 ms.
  Clock::Duration wait(StageAxis axis) {
    const Clock::Instant start = clock.now();
    while (stage->motion_state(axis) == MotionState::kMoving && clock.now() - start < seconds(100))
      clock.sleep_until(clock.now() + milliseconds(10));
    return clock.now() - start;
  }
  SimClock clock;
  std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(BenchTruth{}, clock.now());
  std::shared_ptr<Firmware> firmware = std::make_shared<ZaberAsciiFirmware>(bench, GetParam().firmware);
  std::unique_ptr<RotationStage> stage;
};

TEST_P(ZaberDriverTest, IdentifiesHomesAndMovesBothAxes) {
  StageInfo info = stage->identify();
  EXPECT_EQ(info.maker, "Zaber");
  EXPECT_THAT(info.serial_number, HasSubstr("54321"));
  EXPECT_FALSE(info.axes[0].referenced || info.axes[1].referenced);
  home_both();
  info = stage->identify();
  EXPECT_TRUE(info.axes[0].referenced && info.axes[1].referenced);
  EXPECT_EQ(info.axes[0].travel_min.deg(), -360.0);
  EXPECT_EQ(info.axes[1].travel_max.deg(), 360.0);
  EXPECT_EQ(info.axes[0].resolution.deg(), 360.0 / 384000.0);
  EXPECT_NEAR(info.axes[1].speed_deg_per_s, 20.0, 1e-3);

  stage->move_to(StageAxis::kX, Angle::degrees(90));
  stage->move_to(StageAxis::kZ, Angle::degrees(-33.3));
  EXPECT_NEAR(to_seconds(wait(StageAxis::kX)), 2.75, 0.1);  // 40 degrees/s, as the settings ask for
  wait(StageAxis::kZ);
  EXPECT_EQ(stage->encoder_angle(StageAxis::kX).deg(), 90.0);
  EXPECT_NEAR(stage->encoder_angle(StageAxis::kZ).deg(), -33.3, 0.5 / kStepsPerDegree);
  EXPECT_EQ(bench->commanded_angle(StageAxis::kX, clock.now()).deg(), 90.0);
  EXPECT_NEAR(bench->commanded_angle(StageAxis::kZ, clock.now()).deg(), -33.3, 0.5 / kStepsPerDegree);
}

TEST_P(ZaberDriverTest, HaltsInTheMiddleOfAMoveAndGoesOnAfterwards) {
  home_both();
  stage->move_to(StageAxis::kX, Angle::degrees(180));
  stage->move_to(StageAxis::kZ, Angle::degrees(180));
  clock.sleep_until(clock.now() + seconds(2));
  EXPECT_TRUE(stage->halt());
  for (const StageAxis axis : kStageAxes) {
    EXPECT_FALSE(bench->moving(axis, clock.now()));
    EXPECT_GT(bench->commanded_angle(axis, clock.now()).deg(), 20.0);
    EXPECT_LT(bench->commanded_angle(axis, clock.now()).deg(), 120.0);
    EXPECT_EQ(stage->motion_state(axis), MotionState::kStopped);
  }
  stage->move_to(StageAxis::kX, Angle::degrees(10));
  wait(StageAxis::kX);
  EXPECT_NEAR(stage->encoder_angle(StageAxis::kX).deg(), 10.0, 0.5 / kStepsPerDegree);
}

TEST_P(ZaberDriverTest, RefusesAMoveOutOfTravelOrWithoutReference) {
  EXPECT_THAT(error_of([&] { stage->move_to(StageAxis::kX, Angle::degrees(1)); }, Fault::kNotReady),
              HasSubstr("WR"));
  home_both();
  error_of([&] { stage->move_to(StageAxis::kZ, Angle::degrees(361)); }, Fault::kOutOfTravel);
  EXPECT_EQ(bench->target(StageAxis::kZ, clock.now()).deg(), 0.0);
  bench->inject({.kind = FaultKind::kRefusedMove, .at = clock.now(), .axis = StageAxis::kX});
  EXPECT_THAT(error_of([&] { stage->move_to(StageAxis::kX, Angle::degrees(1)); }, Fault::kRefused),
              HasSubstr("PARKED"));
}

TEST_P(ZaberDriverTest, TellsAStallInWords) {
  home_both();
  stage->move_to(StageAxis::kX, Angle::degrees(90));
  bench->inject({.kind = FaultKind::kStalledAxis, .at = clock.now() + seconds(1), .axis = StageAxis::kX});
  EXPECT_THAT(error_of([&] { wait(StageAxis::kX); }, Fault::kRefused), HasSubstr("FS (stalled and stopped)"));
}

INSTANTIATE_TEST_SUITE_P(
    Lines, ZaberDriverTest,
    testing::Values(DriverCase{"Controller", {}}, DriverCase{"ControllerWithAlerts", {.alerts = true}},
                    DriverCase{"ControllerWithChecksumsAndAlerts", {.alerts = true, .checksums = true}},
                    DriverCase{"Chain", {.axis_names = {"1 1", "2 1"}, .alerts = true}},
                    DriverCase{"ChainTheOtherWayRound", {.axis_names = {"2", "1"}, .address = 1}}),
    [](const auto& each) { return std::string(each.param.name); });

TEST_F(ZaberAsciiFirmwareTest, WithoutPowerItStopsAndHasNoReferenceThen) {
  home_all();
  ask("/1 1 set maxspeed 10000");
  ask("/1 1 move abs 384000");
  host.listen(seconds(1));
  firmware.power(false, now());
  host.listen(seconds(2));
  firmware.power(true, now());
  EXPECT_EQ(ask("/1 1 get pos"), "@01 1 OK IDLE WR 0\r\n");
  EXPECT_GT(angle_deg(StageAxis::kX), 1.0);
  EXPECT_LT(angle_deg(StageAxis::kX), 300.0);
  EXPECT_EQ(firmware.line_speed(), 115200U);
}

}  // namespace
}  // namespace abcal::sim
