#include "drivers/vectornav/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <memory>

#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/vectornav/reference_decoder.h"
#include "tests/support/accelerometer_bench.h"
#include "tests/support/error_of.h"
#include "tests/support/scripted_port.h"

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::error_of;
using test::ScriptedPort;
using test::sequences;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;
namespace reference = test::vectornav_reference;

constexpr std::uint64_t kPeriodNs = 10'000'000;  // 100 Hz

/// A VN-100 as a table: the answer to each command, without frame; other commands are echoed, as writes are.
struct Script {
  std::map<std::string, std::string> answers{{"VNRRG,01", "VNRRG,01,VN-100T-CR"},
                                             {"VNRRG,02", "VNRRG,02,7"},
                                             {"VNRRG,03", "VNRRG,03,0100012345"},
                                             {"VNRRG,04", "VNRRG,04,2.1.0.0"},
                                             {"VNRRG,05", "VNRRG,05,115200"}};
  bool silent = false;
  /// Shown each command first; true: the script dealt with it.
  std::function<bool(ScriptedPort&, const std::string& command)> on_command;

  void operator()(ScriptedPort& port, const std::string& frame) const {
    const std::string command = frame.substr(1, frame.rfind('*') - 1);
    if (silent || (on_command && on_command(port, command))) return;
    const auto found = answers.find(command);
    port.say(reference::text_message(found == answers.end() ? command : found->second, true),
             milliseconds(1));
  }
};

struct Bench : test::AccelerometerBench<VectorNavAccelerometer> {
  explicit Bench(const Script& script = {}, const AccelerometerSettings& settings = {})
      : AccelerometerBench(settings, script) {}

  /// The commands without their frame.
  std::vector<std::string> commands() const {
    std::vector<std::string> texts;
    for (const std::string& frame : port->commands) texts.push_back(frame.substr(1, frame.rfind('*') - 1));
    return texts;
  }
};

TEST(VectorNavAccelerometerTest, IdentifiesTheDevice) {
  Bench bench;
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "VectorNav");
  EXPECT_EQ(info.model, "VN-100T-CR");
  EXPECT_EQ(info.serial_number, "0100012345");
  EXPECT_EQ(info.firmware, "2.1.0.0");
  EXPECT_EQ(info.output_unit, "m/s2");
  EXPECT_EQ(info.rate_hz, 100.0);
  EXPECT_EQ(bench.port->commands.front(),
            "$VNASY,0*" + reference::hex(reference::crc("VNASY,0"), 4) + "\r\n");
  EXPECT_THAT(bench.commands(), Not(Contains(StartsWith("VNWRG")))) << "identify() changes nothing";
}

TEST(VectorNavAccelerometerTest, SetsTheBinaryOutputAndNothingElseOnTheLine) {
  Bench bench;
  bench.accelerometer->start();
  EXPECT_THAT(bench.commands(), ElementsAre("VNASY,0", "VNRRG,01", "VNRRG,03", "VNRRG,04", "VNRRG,05",
                                            "VNWRG,06,0", "VNWRG,75,3,8,05,0101,0010", "VNWRG,76,0,8,01,0001",
                                            "VNWRG,77,0,8,01,0001", "VNASY,1"));
  bench.accelerometer->stop();
  EXPECT_EQ(bench.commands().back(), "VNASY,0");
}

TEST(VectorNavAccelerometerTest, DividesTheRateOfItsFamily) {
  Script script;
  script.answers["VNRRG,01"] = "VNRRG,01,VN-200T-CR";
  Bench bench(script);
  bench.accelerometer->start();
  EXPECT_THAT(bench.commands(), Contains("VNWRG,75,3,4,05,0101,0010"));
}

TEST(VectorNavAccelerometerTest, RefusesARateOrALinkThatCannotBe) {
  AccelerometerSettings settings;
  settings.rate_hz = 300.0;
  EXPECT_THAT(error_of([&] { Bench({}, settings).accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 300"), HasSubstr("266.667")));
  settings.rate_hz = 400.0;
  // 32 bytes a reading: FA, groups, two masks, 24 of fields, CRC.
  EXPECT_THAT(error_of([&] { Bench({}, settings).accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("12800 bytes/s"), HasSubstr("11520"), HasSubstr("rate_hz to 360")));
  settings.link_bytes_per_s = 92160.0;
  EXPECT_NO_THROW(Bench({}, settings).accelerometer->start());
  for (const double rate_hz : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    settings.rate_hz = rate_hz;
    EXPECT_THROW(Bench({}, settings), std::invalid_argument) << rate_hz;
  }
}

TEST(VectorNavAccelerometerTest, SaysTheDevicesOwnRefusalForTheBaudRateInWords) {
  Script script;
  script.answers["VNWRG,75,3,8,05,0101,0010"] = "VNERR,0C";
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("error 0C"), HasSubstr("baud rate is insufficient"), HasSubstr("VNWRG,75")));
}

TEST(VectorNavAccelerometerTest, GivesReadingsWithTemperature) {
  Bench bench;
  bench.accelerometer->start();
  const Clock::Instant began = bench.clock.now();
  bench.port->say(reference::data_message(kPeriodNs, 0.25F, -9.75F, 1.0F, 31.5F), milliseconds(3));
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d(0.25, -9.75, 1.0));
  EXPECT_EQ(readings[0].temperature_degc, 31.5);
  EXPECT_EQ(readings[0].arrival, began + milliseconds(3));
  EXPECT_FALSE(readings[0].over_range);
}

TEST(VectorNavAccelerometerTest, CountsAGapInTheDevicesTimeAsLost) {
  Bench bench;
  bench.accelerometer->start();
  for (const std::uint64_t period : {100U, 101U, 104U, 105U, 175U})
    bench.port->say(reference::data_message(period * kPeriodNs, 0, 0, -9.8F));
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 1, 4, 5, 75));
  EXPECT_EQ(bench.accelerometer->health().readings, 5U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 71U);
}

TEST(VectorNavAccelerometerTest, CountsDamageAndKeepsItsFiguresAfterTheStop) {
  Bench bench;
  bench.accelerometer->start();
  std::string damaged = reference::data_message(2 * kPeriodNs, 1, 2, 3);
  damaged[20] = static_cast<char>(damaged[20] ^ 4);
  bench.port->say(reference::data_message(kPeriodNs, 0, 0, 1) + damaged + "xx" +
                  reference::data_message(3 * kPeriodNs, 0, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 2));
  bench.accelerometer->stop();
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 2U);
  EXPECT_EQ(health.lost_readings, 1U);
  EXPECT_EQ(health.bad_frames, 1U);
  EXPECT_EQ(health.skipped_bytes, 34U);
}

TEST(VectorNavAccelerometerTest, DiscardsWhatArrivedBeforeAndCountsNoneOfItAsLost) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::data_message(1 * kPeriodNs, 1, 0, 0) +
                  reference::data_message(2 * kPeriodNs, 2, 0, 0));
  ASSERT_TRUE(bench.accelerometer->next(bench.clock.now()));  // The second waits in the driver.
  const std::string fourth = reference::data_message(4 * kPeriodNs, 4, 0, 0);
  bench.port->say(reference::data_message(3 * kPeriodNs, 3, 0, 0) + fourth.substr(0, 10));
  bench.port->say(fourth.substr(10), milliseconds(1));
  bench.port->say(reference::data_message(5 * kPeriodNs, 5, 0, 0), milliseconds(10));
  bench.accelerometer->discard_pending();
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 5.0);
  EXPECT_EQ(readings[0].sequence, 4U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(VectorNavAccelerometerTest, ReassemblesAFrameThatComesByteByByte) {
  Bench bench;
  bench.accelerometer->start();
  const std::string frame = reference::data_message(kPeriodNs, 0.5F, 0, 0);
  for (std::size_t i = 0; i < frame.size(); ++i) bench.port->say(frame.substr(i, 1), milliseconds(i));
  EXPECT_EQ(bench.read_all(seconds(1)).size(), 1U);
}

TEST(VectorNavAccelerometerTest, SaysSoWhenTheDeviceWasRestarted) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::data_message(500 * kPeriodNs, 0, 0, 1) +
                  reference::data_message(2 * kPeriodNs, 0, 0, 1));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("restarted"));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("before it was started"));
}

TEST(VectorNavAccelerometerTest, FindsOutThatTheDevicesRateIsNotWhatItBelieves) {
  Bench bench;
  bench.accelerometer->start();
  for (std::uint64_t i = 1; i <= 9; ++i)  // 50 Hz, as of a 400 Hz IMU
    bench.port->say(reference::data_message(i * 2 * kPeriodNs, 0, 0, 1));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kImplausible),
              AllOf(HasSubstr("0.02"), HasSubstr("800")));
}

TEST(VectorNavAccelerometerTest, SaysAnErrorOfTheDeviceWhileItStreams) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::text_message("VNERR,0B"));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kRefused), HasSubstr("output buffer overflow"));
}

// Text output, where there is no register 75.

Script without_binary() {
  Script script;
  script.answers["VNWRG,75,3,8,05,0101,0010"] = "VNERR,08";
  return script;
}

TEST(VectorNavAccelerometerTest, FallsBackToTheTextOutput) {
  Bench bench(without_binary());
  bench.accelerometer->start();
  EXPECT_THAT(bench.commands(), AllOf(Contains("VNWRG,07,100"), Contains("VNWRG,06,19")));
  bench.port->say(reference::text_message("VNIMU,1,2,3,+00.250,-09.750,+01.000,7,8,9,+31.5,+101.3"));
  const auto readings = bench.read_all();
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d(0.25, -9.75, 1.0));
  EXPECT_EQ(readings[0].temperature_degc, 31.5);
}

TEST(VectorNavAccelerometerTest, FallsBackToAccelerationAloneAndJudgesLossesByTheDamagedBytes) {
  Script script = without_binary();
  script.answers["VNWRG,06,19"] = "VNERR,07";
  Bench bench(script);
  bench.accelerometer->start();
  EXPECT_EQ(bench.commands()[bench.commands().size() - 2], "VNWRG,06,11");
  const std::string line = reference::text_message("VNACC,+00.250,-09.750,+01.000");
  std::string damaged = line;
  damaged[10] = '7';
  bench.port->say(line + damaged + line + "xx" + line);
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 2, 3));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 1U);
}

TEST(VectorNavAccelerometerTest, TakesTheShorterTextWhereTheLinkCannotCarryTheLongerOne) {
  Script script = without_binary();
  script.answers["VNRRG,05"] = "VNRRG,05,57600";
  Bench bench(script);
  bench.accelerometer->start();
  EXPECT_THAT(bench.commands(), AllOf(Contains("VNWRG,06,11"), Not(Contains("VNWRG,06,19"))));
}

TEST(VectorNavAccelerometerTest, RefusesATextRateThatIsNone) {
  AccelerometerSettings settings;
  settings.rate_hz = 80.0;  // 800 / 10, yet no rate of register 7
  Script script;
  script.answers["VNWRG,75,3,10,05,0101,0010"] = "VNERR,08";
  EXPECT_THAT(error_of([&] { Bench(script, settings).accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 80"), HasSubstr("no binary output")));
}

// Failures of the communication.

TEST(VectorNavAccelerometerTest, SaysThatASilentPortIsSilentAfterTwoTries) {
  Script script;
  script.silent = true;
  Bench bench(script);
  const Clock::Instant began = bench.clock.now();
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply),
              AllOf(HasSubstr("VNASY,0"), HasSubstr("not one byte"), HasSubstr("baud rate")));
  EXPECT_EQ(bench.clock.now() - began, seconds(4));  // twice the answer time
  bench.accelerometer->stop();                       // Must not throw.
}

TEST(VectorNavAccelerometerTest, TellsAnotherInstrumentByItsBytes) {
  Script script;
  script.on_command = [](ScriptedPort& port, const std::string&) {
    port.say("ue\x01\x02 something else", milliseconds(5));
    return true;
  };
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("ue\\x01\\x02"), HasSubstr("another instrument")));
  Script other_model;
  other_model.answers["VNRRG,01"] = "VNRRG,01,XY-1";
  EXPECT_THAT(error_of([&] { Bench(other_model).accelerometer->identify(); }, Fault::kWrongIdentity),
              HasSubstr("XY-1"));
}

TEST(VectorNavAccelerometerTest, TellsALineOnWhichEveryMessageIsDamaged) {
  Script script;
  script.on_command = [](ScriptedPort& port, const std::string& command) {
    std::string answer = reference::text_message(command, true);
    answer[2] = 'x';
    port.say(answer, milliseconds(1));
    return true;
  };
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kBadFrame),
              HasSubstr("wrong checksum"));
}

TEST(VectorNavAccelerometerTest, FindsItsAnswersWhileDataStreams) {
  Bench bench;
  bench.port->say("00.0706,+00.7482*55\r\n");
  for (int i = 0; i < 200; ++i) {
    bench.port->say(reference::text_message("VNYMR,1,2,3,4,5,6,7,8,9,10,11,12"), milliseconds(10 * i));
    bench.port->say(reference::data_message(static_cast<unsigned>(i) * kPeriodNs, 0, 0, 1),
                    milliseconds(10 * i + 5));
  }
  EXPECT_EQ(bench.accelerometer->identify().model, "VN-100T-CR");
  EXPECT_EQ(bench.port->commands.size(), 5U) << "nothing had to be repeated";
}

TEST(VectorNavAccelerometerTest, RepeatsACommandThatDrownedWhileDataStreams) {
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort&, const std::string& command) {
    return command == "VNASY,0" && ++asked < 4;
  };
  Bench bench(script);
  for (int i = 0; i < 1000; ++i)
    bench.port->say(reference::text_message("VNACC,1,2,3"), milliseconds(10 * i));
  EXPECT_EQ(bench.accelerometer->identify().model, "VN-100T-CR");
  EXPECT_EQ(asked, 4);
}

TEST(VectorNavAccelerometerTest, NeverTakesALateErrorForTheAnswerToTheNextCommand) {
  // "VNRRG,03" is refused, too late: the refusal arrives behind the answer to the second try.
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, const std::string& command) {
    if (command != "VNRRG,03" || ++asked > 1) return false;
    port.say(reference::text_message("VNERR,04", true), milliseconds(2'001) + std::chrono::microseconds(500));
    return true;
  };
  Bench bench(script);
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "0100012345");
  EXPECT_THAT(bench.commands(), Contains("VNRRG,02")) << "asks until nothing is outstanding";
}

TEST(VectorNavAccelerometerTest, CountsNoErrorWhileAnEarlierTryIsOutstanding) {
  // The refusal of the first try arrives before the answer to the second.
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, const std::string& command) {
    if (command != "VNRRG,03" || ++asked > 1) return false;
    port.say(reference::text_message("VNERR,04", true), milliseconds(2'000) + std::chrono::microseconds(500));
    return true;
  };
  Bench bench(script);
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "0100012345");
  EXPECT_EQ(asked, 2);
}

TEST(VectorNavAccelerometerTest, CountsNoErrorOfAnEarlierProgram) {
  Bench bench;
  bench.port->say(reference::text_message("VNERR,08"), std::chrono::microseconds(500));
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "0100012345");
}

TEST(VectorNavAccelerometerTest, TakesNoErrorOfACommandForAFaultOfTheStream) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::text_message("VNERR,05") + reference::data_message(kPeriodNs, 0, 0, 1));
  EXPECT_EQ(bench.read_all().size(), 1U);
}

TEST(VectorNavAccelerometerTest, NeverTakesALateAnswerAfterAFailure) {
  Script script;
  bool dead = true;
  script.on_command = [&dead](ScriptedPort&, const std::string& command) {
    return dead && command == "VNRRG,03";
  };
  Bench bench(script);
  error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply);
  // Both answers come while the next attempt is under way, before its own (a device answers in order).
  for (int i = 0; i < 2; ++i)
    bench.port->say(reference::text_message("VNRRG,03,STALE", true), std::chrono::microseconds(500));
  dead = false;
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "0100012345");
}

TEST(VectorNavAccelerometerTest, GoesOnWithoutTheCommandThatPausesTheOutput) {
  Script script;
  script.answers["VNASY,0"] = script.answers["VNASY,1"] = "VNERR,04";
  Bench bench(script);
  EXPECT_NO_THROW(bench.accelerometer->start());
  script.answers["VNASY,0"] = "VNERR,01";  // A device's own fault answers no command.
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kNoReply),
              HasSubstr("VNASY,0"));
}

TEST(VectorNavAccelerometerTest, ReportsAnUnpluggedDevice) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->unplugged = true;
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->discard_pending(); }, Fault::kLinkLost);
  bench.accelerometer->stop();  // Must not throw.
  bench.port->unplugged = false;
  EXPECT_NO_THROW(bench.accelerometer->start());
}

TEST(VectorNavAccelerometerTest, ReadsTheSimulatedDevice) {
  sim::SimClock clock;
  sim::BenchTruth truth;
  truth.sensitivity_matrix *= 9.8;
  auto world = std::make_shared<sim::SimBench>(truth, clock.now());
  auto stream = std::make_unique<sim::FirmwareStream>(std::make_shared<sim::VectorNavFirmware>(world), clock);
  VectorNavAccelerometer accelerometer(std::move(stream), clock, AccelerometerSettings());
  accelerometer.start();
  for (std::uint64_t i = 0; i < 500; ++i) {
    const auto reading = accelerometer.next(clock.now() + seconds(1));
    ASSERT_TRUE(reading);
    EXPECT_EQ(reading->sequence, i);
    EXPECT_NEAR(reading->output.z(), 9.8, 1e-6);  // float32 of 9.8: half a step is 4.8e-7
    EXPECT_TRUE(reading->temperature_degc);
  }
  EXPECT_EQ(accelerometer.health().lost_readings, 0U);
  EXPECT_EQ(accelerometer.health().skipped_bytes, 0U);
}

TEST(VectorNavAccelerometerTest, TellsTheCorrectionsThatTheDeviceApplies) {
  sim::SimClock clock;
  auto world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  const auto device = std::make_shared<sim::VectorNavFirmware>(world);
  device->receive("$VNWRG,25,1,0,0,0,1,0,0,0,1,0.5,0,0*XX\r\n", clock.now());
  VectorNavAccelerometer accelerometer(std::make_unique<sim::FirmwareStream>(device, clock), clock,
                                       AccelerometerSettings());
  accelerometer.identify();
  const auto registers = accelerometer.correction_registers();
  ASSERT_EQ(registers.size(), 2U);
  EXPECT_EQ(registers.at("acceleration compensation (25)"),
            "+1.000000,+0.000000,+0.000000,+0.000000,+1.000000,+0.000000,+0.000000,+0.000000,+1.000000,"
            "+0.500000,+0.000000,+0.000000");
  accelerometer.start();
  EXPECT_TRUE(accelerometer.next(clock.now() + seconds(1)));
}

}  // namespace
}  // namespace abcal
