#include "drivers/xsens_mti/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <memory>

#include "tests/drivers/xsens_mti/reference_decoder.h"
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
using ::testing::ElementsAre;
using ::testing::HasSubstr;
namespace reference = test::xbus_reference;

/// An MTi as a table: the data of the answer to each command; other commands are answered by their own data.
struct Script {
  std::map<unsigned, std::string> answers{{0x00, "\x03\x70\x03\xF8"},
                                          {0x1C, "MTi-300-2A5G4       "},
                                          {0x12, std::string("\x01\x07\x03\0\0\0\x1A\0\0\0\0", 11)},
                                          {0x1E, std::string("\x02\x00", 2)}};
  std::map<unsigned, unsigned> errors;  ///< Codes with which commands are refused.
  bool silent = false;
  /// Shown the id of each command first; true: the script dealt with it.
  std::function<bool(ScriptedPort&, unsigned id, const std::string& data)> on_command;

  void operator()(ScriptedPort& port, const std::string& frame) const {
    const unsigned id = reference::byte_at(frame, 2);
    const std::string data = frame.substr(4, frame.size() - 5);
    if (silent || (on_command && on_command(port, id, data))) return;
    if (const auto error = errors.find(id); error != errors.end()) {
      port.say(reference::message(0x42, reference::bytes_of(error->second, 1)), milliseconds(1));
      return;
    }
    const auto found = answers.find(id);
    port.say(reference::message(id + 1, found == answers.end() ? data : found->second), milliseconds(1));
  }
};

struct Bench : test::AccelerometerBench<XsensMtiAccelerometer> {
  explicit Bench(const Script& script = {}, const AccelerometerSettings& settings = {})
      : AccelerometerBench(settings, script) {}

  std::vector<unsigned> commands() const {
    std::vector<unsigned> ids;
    for (const std::string& frame : port->commands) ids.push_back(reference::byte_at(frame, 2));
    return ids;
  }
};

std::string outputs(std::initializer_list<std::pair<unsigned, unsigned>> list) {
  std::string data;
  for (const auto& [id, rate] : list) data += reference::bytes_of(id, 2) + reference::bytes_of(rate, 2);
  return data;
}

TEST(XsensMtiAccelerometerTest, IdentifiesTheDevice) {
  Bench bench;
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "Xsens");
  EXPECT_EQ(info.model, "MTi-300-2A5G4");
  EXPECT_EQ(info.serial_number, "037003F8");
  EXPECT_EQ(info.firmware, "1.7.3");
  EXPECT_EQ(info.output_unit, "m/s2");
  EXPECT_EQ(info.rate_hz, 100.0);
  EXPECT_THAT(bench.commands(), ElementsAre(0x30, 0x00, 0x1C, 0x12)) << "config first; nothing is set";
}

TEST(XsensMtiAccelerometerTest, SetsTheOutputConfiguration) {
  Bench bench;
  bench.accelerometer->start();
  EXPECT_THAT(bench.commands(), ElementsAre(0x30, 0x00, 0x1C, 0x12, 0xC0, 0x10));
  EXPECT_EQ(
      bench.port->commands[4],
      reference::message(
          0xC0, outputs({{0x1020, 0xFFFF}, {0x1060, 0xFFFF}, {0x4020, 100}, {0x0810, 1}, {0xE020, 0xFFFF}})));
  bench.accelerometer->stop();
  EXPECT_EQ(bench.commands().back(), 0x30U);
}

TEST(XsensMtiAccelerometerTest, DoesWithLessWhereTheDeviceRefusesAll) {
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, unsigned id, const std::string&) {
    if (id != 0xC0 || ++asked > 1) return false;
    port.say(reference::message(0x42, "\x21"), milliseconds(1));
    return true;
  };
  Bench bench(script);
  bench.accelerometer->start();
  EXPECT_EQ(bench.port->commands[5], reference::message(0xC0, outputs({{0x1020, 0xFFFF}, {0x4020, 100}})));
  script.on_command = nullptr;
  script.errors[0xC0] = 0x21;
  EXPECT_THAT(
      error_of([&] { Bench(script).accelerometer->start(); }, Fault::kRefused),
      AllOf(HasSubstr("error 21"), HasSubstr("parameter not valid"), HasSubstr("output configuration")));
}

TEST(XsensMtiAccelerometerTest, BelievesTheRateThatTheDeviceSets) {
  AccelerometerSettings settings;
  settings.rate_hz = 99.6;
  Bench bench({}, settings);
  bench.accelerometer->start();
  EXPECT_EQ(bench.accelerometer->identify().rate_hz, 100.0);
  Script script;
  script.answers[0xC0] = outputs({{0x1020, 0xFFFF}, {0x4020, 50}});
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 100"), HasSubstr("50")));
  script.answers[0xC0] = outputs({{0x1020, 0xFFFF}});
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->start(); }, Fault::kWrongIdentity),
              HasSubstr("4020"));
  script.answers[0xC0] = "xyz";
  error_of([&] { Bench(script).accelerometer->start(); }, Fault::kBadFrame);
}

TEST(XsensMtiAccelerometerTest, RefusesARateOrALinkThatCannotBe) {
  AccelerometerSettings settings;
  settings.rate_hz = 12.5;
  EXPECT_THAT(error_of([&] { Bench({}, settings).accelerometer->start(); }, Fault::kRefused),
              HasSubstr("rate_hz is 12.5"));
  settings.rate_hz = 400.0;
  settings.link_bytes_per_s = 11520.0;
  // 39 bytes a reading: frame 5, counter 5, time 7, acceleration 15, status 7; and 7 a second of temperature.
  EXPECT_THAT(error_of([&] { Bench({}, settings).accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("15607 bytes/s"), HasSubstr("11520"), HasSubstr("rate_hz to 295")));
  settings.link_bytes_per_s = 92160.0;
  EXPECT_NO_THROW(Bench({}, settings).accelerometer->start());
  for (const double rate_hz : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    settings.rate_hz = rate_hz;
    EXPECT_THROW(Bench({}, settings), std::invalid_argument) << rate_hz;
  }
}

TEST(XsensMtiAccelerometerTest, GivesReadingsWithTemperatureAndClipping) {
  Bench bench;
  bench.accelerometer->start();
  const Clock::Instant began = bench.clock.now();
  bench.port->say(reference::data_message(1, 0.25F, -9.75F, 1.0F));
  bench.port->say(
      reference::data_message(2, 0, 0, 1, 0x80203, reference::item(0x0810, reference::float_bytes(31.5F))),
      milliseconds(10));
  bench.port->say(reference::data_message(3, 0, 0, 1), milliseconds(20));
  bench.port->say(reference::data_message(4, 0, 0, 1), milliseconds(10'020));
  const auto readings = bench.read_all(seconds(11));
  ASSERT_EQ(readings.size(), 4U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d(0.25, -9.75, 1.0));
  EXPECT_FALSE(readings[0].temperature_degc);
  EXPECT_FALSE(readings[0].over_range);
  EXPECT_EQ(readings[0].arrival, began);
  EXPECT_TRUE(readings[1].over_range);
  EXPECT_EQ(readings[1].temperature_degc, 31.5);
  EXPECT_EQ(readings[2].temperature_degc, 31.5) << "comes once a second";
  EXPECT_FALSE(readings[3].temperature_degc) << "too old";
}

TEST(XsensMtiAccelerometerTest, CountsAGapInThePacketCounterAsLostAlsoWhereItBeginsAnew) {
  Bench bench;
  bench.accelerometer->start();
  using reference::item;
  const auto without_time = [](unsigned counter) {
    return reference::message(0x36, item(0x1020, reference::bytes_of(counter, 2)) +
                                        item(0x4020, reference::float_bytes(0) + reference::float_bytes(0) +
                                                         reference::float_bytes(1)));
  };
  for (const unsigned counter : {65530U, 65531U, 65534U, 65535U, 0U, 1U, 5U})
    bench.port->say(without_time(counter));
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 1, 4, 5, 6, 7, 11));
  EXPECT_EQ(bench.accelerometer->health().readings, 7U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 5U);
}

TEST(XsensMtiAccelerometerTest, CountsPacketsWithoutAccelerationAsNoReading) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::data_message(1, 0, 0, 1));
  bench.port->say(reference::message(0x36, reference::item(0x1020, reference::bytes_of(2, 2))));
  bench.port->say(reference::data_message(3, 0, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 1));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(XsensMtiAccelerometerTest, TakesNoPacketTwiceAndNoneWithoutItsCounter) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::data_message(1, 0, 0, 1) + reference::data_message(1, 0, 0, 1));
  bench.port->say(reference::message(0x36, reference::item(0x4020, std::string(12, '\0'))));
  bench.port->say(reference::message(0x36, reference::item(0x1020, reference::bytes_of(2, 2)) +
                                               reference::item(0x4020, std::string(11, '\0'))));
  EXPECT_EQ(bench.read_all().size(), 1U);
  EXPECT_EQ(bench.accelerometer->health().bad_frames, 3U);
}

TEST(XsensMtiAccelerometerTest, JudgesLossesByTheDamagedBytesWhereThereIsNoCounter) {
  Script script;
  script.answers[0xC0] = outputs({{0x4020, 100}});
  Bench bench(script);
  bench.accelerometer->start();
  const std::string packet = reference::message(0x36, reference::item(0x4020, std::string(12, '\0')));
  std::string damaged = packet;
  damaged[9] = 'x';
  bench.port->say(packet + damaged + packet + "xx" + packet);
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 2, 3));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 1U);
}

TEST(XsensMtiAccelerometerTest, CountsDamageAndKeepsItsFiguresAfterTheStop) {
  Bench bench;
  bench.accelerometer->start();
  std::string damaged = reference::data_message(2, 1, 2, 3);
  damaged[20] = static_cast<char>(damaged[20] ^ 4);
  bench.port->say(reference::data_message(1, 0, 0, 1) + damaged + "xx" + reference::data_message(3, 0, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 2));
  bench.accelerometer->stop();
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 2U);
  EXPECT_EQ(health.lost_readings, 1U);
  EXPECT_EQ(health.bad_frames, 1U);
  EXPECT_EQ(health.skipped_bytes, 41U);
}

TEST(XsensMtiAccelerometerTest, DiscardsWhatArrivedBeforeAndCountsNoneOfItAsLost) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::data_message(1, 1, 0, 0) + reference::data_message(2, 2, 0, 0));
  ASSERT_TRUE(bench.accelerometer->next(bench.clock.now()));  // The second waits in the driver.
  const std::string fourth = reference::data_message(4, 4, 0, 0);
  bench.port->say(reference::data_message(3, 3, 0, 0) + fourth.substr(0, 10));
  bench.port->say(fourth.substr(10), milliseconds(1));
  bench.port->say(reference::data_message(5, 5, 0, 0), milliseconds(10));
  bench.accelerometer->discard_pending();
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 5.0);
  EXPECT_EQ(readings[0].sequence, 4U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(XsensMtiAccelerometerTest, BlamesADwellForNothingThatAnOverfullQueueLostBeforeIt) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::data_message(1, 1, 0, 0));
  bench.port->dropped = 1000;
  bench.accelerometer->discard_pending();
  bench.port->say(reference::data_message(50, 1, 0, 0) + reference::data_message(53, 1, 0, 0));
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(49, 52));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 2U);
  EXPECT_EQ(bench.accelerometer->health().skipped_bytes, 1000U);
}

TEST(XsensMtiAccelerometerTest, CountsWhatAFullQueueLost) {
  Bench bench;
  bench.accelerometer->start();
  std::string bytes;
  for (unsigned i = 1; i <= 10'000; ++i) bytes += reference::data_message(i, 0, 0, 1);
  bench.port->say(bytes);
  EXPECT_EQ(bench.read_all().size(), 8192U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 10'000U - 8192U);
}

TEST(XsensMtiAccelerometerTest, ReassemblesAFrameThatComesByteByByte) {
  Bench bench;
  bench.accelerometer->start();
  const std::string frame = reference::data_message(1, 0.5F, 0, 0);
  for (std::size_t i = 0; i < frame.size(); ++i) bench.port->say(frame.substr(i, 1), milliseconds(i));
  EXPECT_EQ(bench.read_all(seconds(1)).size(), 1U);
}

TEST(XsensMtiAccelerometerTest, SaysSoWhenTheDeviceWasRestarted) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::message(0x3E));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("woke up"));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("before it was started"));
  bench.accelerometer->start();
  bench.port->say(reference::data_message(5000, 0, 0, 1) + reference::data_message(3, 0, 0, 1));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("sample time went back"));
}

TEST(XsensMtiAccelerometerTest, SaysAnErrorOfTheDeviceWhileItStreams) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::message(0x42, "\x1E"));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kRefused), HasSubstr("timer overflow"));
}

// Failures of the communication.

TEST(XsensMtiAccelerometerTest, SaysThatASilentPortIsSilentAfterTwoTries) {
  Script script;
  script.silent = true;
  Bench bench(script);
  const Clock::Instant began = bench.clock.now();
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply),
              AllOf(HasSubstr("go to config"), HasSubstr("not one byte"), HasSubstr("baud rate")));
  EXPECT_EQ(bench.clock.now() - began, seconds(4));  // twice the answer time
  bench.accelerometer->stop();                       // Must not throw.
}

TEST(XsensMtiAccelerometerTest, TellsAnotherInstrumentByItsBytes) {
  Script script;
  script.on_command = [](ScriptedPort& port, unsigned, const std::string&) {
    port.say("$VNRRG,01,VN-100*0A\r\n", milliseconds(5));
    return true;
  };
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("24 56 4E"), HasSubstr("another instrument")));
  Script other_model;
  other_model.answers[0x1C] = "AW-A2               ";
  EXPECT_THAT(error_of([&] { Bench(other_model).accelerometer->identify(); }, Fault::kWrongIdentity),
              HasSubstr("AW-A2"));
}

TEST(XsensMtiAccelerometerTest, TellsALineOnWhichEveryMessageIsDamaged) {
  Script script;
  script.on_command = [](ScriptedPort& port, unsigned id, const std::string&) {
    std::string answer = reference::message(id + 1);
    answer.back() = static_cast<char>(answer.back() ^ 1);
    port.say(answer, milliseconds(1));
    return true;
  };
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kBadFrame),
              HasSubstr("damaged"));
}

TEST(XsensMtiAccelerometerTest, RefusesAnswersWithoutTheirContent) {
  for (const unsigned id : {0x00U, 0x12U}) {
    Script script;
    script.answers[id] = "x";
    EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kBadFrame),
                HasSubstr("1 bytes"));
  }
}

TEST(XsensMtiAccelerometerTest, FindsItsAnswersWhileDataStreams) {
  Bench bench;
  bench.port->say(reference::data_message(1, 0, 0, 1).substr(9));
  for (unsigned i = 1; i < 200; ++i)
    bench.port->say(reference::data_message(i, 0, 0, 1), milliseconds(10 * i));
  EXPECT_EQ(bench.accelerometer->identify().model, "MTi-300-2A5G4");
  EXPECT_EQ(bench.port->commands.size(), 4U) << "nothing had to be repeated";
}

TEST(XsensMtiAccelerometerTest, RepeatsGoToConfigWhileDataStreams) {
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort&, unsigned id, const std::string&) {
    return id == 0x30 && ++asked < 4;
  };
  Bench bench(script);
  for (unsigned i = 1; i < 1000; ++i)
    bench.port->say(reference::data_message(i, 0, 0, 1), milliseconds(10 * i));
  EXPECT_EQ(bench.accelerometer->identify().model, "MTi-300-2A5G4");
  EXPECT_EQ(asked, 4);
}

TEST(XsensMtiAccelerometerTest, NeverTakesALateErrorForTheAnswerToTheNextCommand) {
  // The device id is refused, too late: the refusal arrives behind the answer to the second try.
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, unsigned id, const std::string&) {
    if (id != 0x00 || ++asked > 1) return false;
    port.say(reference::message(0x42, "\x04"), milliseconds(2'001) + std::chrono::microseconds(500));
    return true;
  };
  Bench bench(script);
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "037003F8");
  EXPECT_THAT(bench.commands(), ElementsAre(0x30, 0x00, 0x00, 0x1E, 0x1C, 0x12));
}

TEST(XsensMtiAccelerometerTest, CountsNoErrorWhileAnEarlierTryIsOutstanding) {
  // The refusal of the first try arrives before the answer to the second.
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, unsigned id, const std::string&) {
    if (id != 0x00 || ++asked > 1) return false;
    port.say(reference::message(0x42, "\x04"), milliseconds(2'000) + std::chrono::microseconds(500));
    return true;
  };
  Bench bench(script);
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "037003F8");
  EXPECT_THAT(bench.commands(), ElementsAre(0x30, 0x00, 0x00, 0x1E, 0x1C, 0x12));
}

TEST(XsensMtiAccelerometerTest, AsksAgainToSeeWhoseAnErrorIs) {
  // The first try is lost, the second refused: only a third, with nothing else outstanding, is conclusive.
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, unsigned id, const std::string&) {
    if (id != 0x00) return false;
    if (++asked > 1) port.say(reference::message(0x42, "\x04"), milliseconds(1));
    return true;
  };
  Bench bench(script);
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kRefused), HasSubstr("device id"));
  EXPECT_THAT(bench.commands(), ElementsAre(0x30, 0x00, 0x00, 0x1E, 0x00));
}

TEST(XsensMtiAccelerometerTest, CountsNoErrorOfAnEarlierProgram) {
  Bench bench;
  bench.port->say(reference::message(0x42, "\x04"), std::chrono::microseconds(500));
  EXPECT_EQ(bench.accelerometer->identify().serial_number, "037003F8");
  EXPECT_THAT(bench.commands(), ElementsAre(0x30, 0x00, 0x1C, 0x12));
}

TEST(XsensMtiAccelerometerTest, TakesNoErrorOfACommandForAFaultOfTheStream) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::message(0x42, "\x04") + reference::data_message(1, 0, 0, 1));
  EXPECT_EQ(bench.read_all().size(), 1U);
}

TEST(XsensMtiAccelerometerTest, NeverTakesALateAnswerAfterAFailure) {
  Script script;
  bool dead = true;
  script.on_command = [&dead](ScriptedPort&, unsigned id, const std::string&) { return dead && id == 0x1C; };
  Bench bench(script);
  error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply);
  // Both answers come while the next attempt is under way, before its own (a device answers in order).
  for (int i = 0; i < 2; ++i)
    bench.port->say(reference::message(0x1D, "MTi-STALE           "), std::chrono::microseconds(500));
  dead = false;
  EXPECT_EQ(bench.accelerometer->identify().model, "MTi-300-2A5G4");
}

TEST(XsensMtiAccelerometerTest, ReportsAnUnpluggedDevice) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->unplugged = true;
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->discard_pending(); }, Fault::kLinkLost);
  bench.accelerometer->stop();  // Must not throw.
  bench.port->unplugged = false;
  EXPECT_NO_THROW(bench.accelerometer->start());
}

}  // namespace
}  // namespace abcal
