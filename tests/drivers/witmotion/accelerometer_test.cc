#include "drivers/witmotion/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <memory>

#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/witmotion_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/witmotion/reference_decoder.h"
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
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;
namespace reference = test::witmotion_reference;
using reference::from_hex;

const std::string kRead = from_hex("FF AA 27");
const std::string kWriteRate = from_hex("FF AA 03");

/// A sensor as a table: four registers from each readable address, and its stream once its rate is set.
struct Script {
  std::map<int, std::array<int, 4>> registers{
      {0x2E, {17202, 0, 0, 0}}, {0x21, {3, 0, 0, 0}}, {0x02, {0x1E, 6, 6, 0}}};
  bool answers = true;
  milliseconds period{10};
  std::string streamed = reference::acceleration(0, 0, 2048);  ///< In each period.
  /// Shown each command first; true: the script dealt with it.
  std::function<bool(ScriptedPort&, const std::string& command)> on_command;

  void operator()(ScriptedPort& port, const std::string& command) const {
    if (on_command && on_command(port, command)) return;
    if (answers && command.starts_with(kRead)) {
      const auto found = registers.find(reference::byte_at(command, 3));
      if (found != registers.end()) port.say(reference::frame(0x5F, found->second), milliseconds(2));
    }
    if (command.starts_with(kWriteRate)) stream(port);
  }

  /// The amount that the driver listens to before it calls the stream started: a second from the first frame
  /// on. A frame of the first 10 ms is discarded before, as it may have the old rate.
  void stream(ScriptedPort& port) const {
    const int thrown_away = static_cast<int>(milliseconds(10) / period);
    const int frames =
        thrown_away + 1 + static_cast<int>(std::ceil(1000.0 / static_cast<double>(period.count())));
    for (int i = 1; i <= frames; ++i) port.say(streamed, i * period);
  }
};

struct Bench : test::AccelerometerBench<WitMotionAccelerometer> {
  explicit Bench(const Script& script = {}, const AccelerometerSettings& settings = {})
      : AccelerometerBench(settings, script) {}
};

TEST(WitMotionAccelerometerTest, IdentifiesADeviceThatAnswers) {
  Bench bench;
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "WitMotion");
  EXPECT_EQ(info.model, "unknown");
  EXPECT_EQ(info.serial_number, "");
  EXPECT_EQ(info.firmware, "17202");
  EXPECT_EQ(info.output_unit, "g");
  EXPECT_EQ(info.full_scale, 16.0);
  EXPECT_EQ(info.resolution, 16.0 / 32768.0);
  EXPECT_EQ(info.rate_hz, 100.0);
  EXPECT_THAT(bench.port->commands, Each(StartsWith(kRead))) << "identify() changes nothing";
}

TEST(WitMotionAccelerometerTest, TakesTheNarrowestFullScaleThatItKnows) {
  Script script;
  script.registers[0x21] = {0, 0, 0, 0};
  EXPECT_EQ(Bench(script).accelerometer->identify().full_scale, 2.0);
  script.registers[0x21] = {77, 0, 0, 0};
  EXPECT_EQ(Bench(script).accelerometer->identify().full_scale, 16.0);
  AccelerometerSettings settings;
  settings.full_scale = 8.0;
  EXPECT_EQ(Bench(script, settings).accelerometer->identify().full_scale, 8.0);
  settings.full_scale = 100.0;
  EXPECT_EQ(Bench(script, settings).accelerometer->identify().full_scale, 16.0) << "all that a word can say";
}

TEST(WitMotionAccelerometerTest, IdentifiesACheapModelByItsFrames) {
  Script script;
  script.answers = false;
  Bench bench(script);
  for (int i = 0; i < 50; ++i)
    bench.port->say(from_hex("55 51 ae ff 0c 00 12 08 78 08 f9 55 52 00 00 00 00 00 00 78 08 27"),
                    milliseconds(100 * i));
  EXPECT_EQ(bench.accelerometer->identify().firmware, "unknown");
  for (int i = 0; i < 50; ++i)  // The angle has the version with it.
    bench.port->say(from_hex("55 53 43 00 87 01 6d 01 6a 42 8d"), milliseconds(100 * i));
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "WitMotion");
  EXPECT_EQ(info.firmware, "17002");
  EXPECT_EQ(info.full_scale, 16.0);
}

TEST(WitMotionAccelerometerTest, HearsOneThatStreamsOnceInFiveSeconds) {
  Script script;
  script.answers = false;
  Bench bench(script);
  bench.port->say(reference::acceleration(0, 0, 2048), milliseconds(4900));
  EXPECT_EQ(bench.accelerometer->identify().maker, "WitMotion");
}

TEST(WitMotionAccelerometerTest, SetsOutputAndRateAfterTheUnlockAndSavesNothing) {
  Bench bench;
  bench.accelerometer->start();
  EXPECT_THAT(bench.port->commands, ElementsAre(from_hex("FF AA 27 2E 00"), from_hex("FF AA 27 21 00"),
                                                from_hex("FF AA 27 02 00"), from_hex("FF AA 69 88 B5"),
                                                from_hex("FF AA 02 02 00"), from_hex("FF AA 03 09 00")));
  bench.accelerometer->stop();
  EXPECT_EQ(bench.port->commands.size(), 6U);
  error_of([&] { bench.read_all(); }, Fault::kNotReady);
}

TEST(WitMotionAccelerometerTest, RefusesARateThatItDoesNotHave) {
  AccelerometerSettings settings;
  settings.rate_hz = 300.0;
  Bench bench({}, settings);
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 300"), HasSubstr("nearest is 200")));
  EXPECT_TRUE(bench.port->commands.empty());
  for (const double rate_hz : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    settings.rate_hz = rate_hz;
    EXPECT_THROW(Bench({}, settings), std::invalid_argument) << rate_hz;
  }
}

TEST(WitMotionAccelerometerTest, RefusesARateThatTheLinkCannotCarry) {
  const auto message = AllOf(HasSubstr("1100 bytes/s"), HasSubstr("960"), HasSubstr("rate_hz to 87"));
  AccelerometerSettings settings;
  settings.link_bytes_per_s = 960.0;
  Bench told({}, settings);
  EXPECT_THAT(error_of([&] { told.accelerometer->start(); }, Fault::kRefused), message);
  Script script;
  script.registers[0x02] = {0x1E, 6, 2, 0};  // 9600 baud, says the device
  Bench asked(script);
  EXPECT_THAT(error_of([&] { asked.accelerometer->start(); }, Fault::kRefused), message);
  EXPECT_THAT(asked.port->commands, Each(StartsWith(kRead)));
  error_of([&] { asked.accelerometer->next(asked.clock.now()); }, Fault::kNotReady);
}

TEST(WitMotionAccelerometerTest, SaysSoWhenTheDeviceKeepsItsOwnRate) {
  Script script;
  script.period = milliseconds(100);
  Bench bench(script);
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kImplausible),
              AllOf(HasSubstr("rate_hz is 100"), HasSubstr("10 readings")));
  EXPECT_EQ(std::count(bench.port->commands.begin(), bench.port->commands.end(), from_hex("FF AA 03 09 00")),
            3);
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kNotReady);
  script.on_command = [](ScriptedPort&, const std::string& command) {
    return command.starts_with(kWriteRate);
  };
  Bench mute(script);
  EXPECT_THAT(error_of([&] { mute.accelerometer->start(); }, Fault::kNoReply),
              HasSubstr("no readings arrived"));
}

TEST(WitMotionAccelerometerTest, SendsAgainWhatWasLost) {
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort&, const std::string& command) {
    return command.starts_with(kWriteRate) && ++asked == 1;
  };
  Bench bench(script);
  EXPECT_NO_THROW(bench.accelerometer->start());
  EXPECT_EQ(asked, 2);
}

TEST(WitMotionAccelerometerTest, GivesReadingsWithTemperatureAndTheirClipping) {
  Bench bench;
  bench.accelerometer->start();
  const Clock::Instant began = bench.clock.now();
  bench.port->say(reference::acceleration(512, -2048, 1, 3150), milliseconds(3));
  bench.port->say(reference::acceleration(0, -32768, 0), milliseconds(13));
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 2U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d(0.25, -1.0, 16.0 / 32768.0));
  EXPECT_EQ(readings[0].temperature_degc, 31.5);
  EXPECT_EQ(readings[0].arrival, began + milliseconds(3));
  EXPECT_FALSE(readings[0].over_range);
  EXPECT_TRUE(readings[1].over_range);
  EXPECT_EQ(bench.accelerometer->health().readings, 2U) << "those before the start do not count";
}

TEST(WitMotionAccelerometerTest, CountsDamagedFramesAsLostAndKeepsItsFiguresAfterTheStop) {
  Bench bench;
  bench.accelerometer->start();
  const std::string good = reference::acceleration(0, 0, 2048);
  std::string damaged = good;
  damaged[6] = static_cast<char>(damaged[6] ^ 4);
  std::string headless = good;
  headless[0] = 'x';
  bench.port->say(good + damaged + good + damaged + headless + good + "x" + good);
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 2, 5, 6));
  bench.accelerometer->stop();
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 4U);
  EXPECT_EQ(health.lost_readings, 3U);
  EXPECT_EQ(health.bad_frames, 2U);
  EXPECT_EQ(health.skipped_bytes, 34U);
}

TEST(WitMotionAccelerometerTest, CountsWhatAFullQueueDroppedAsLost) {
  Bench bench;
  bench.accelerometer->start();
  const std::string good = reference::acceleration(0, 0, 2048);
  bench.port->say(good);
  EXPECT_EQ(bench.read_all().size(), 1U);
  bench.port->dropped += 5 * good.size();
  bench.port->say(good);
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(6));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 5U);
}

TEST(WitMotionAccelerometerTest, DoesNotInventALossFromALateArrival) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::acceleration(0, 0, 2048), milliseconds(10));
  bench.port->say(reference::acceleration(0, 0, 2048), milliseconds(500));
  EXPECT_THAT(sequences(bench.read_all(seconds(1))), ElementsAre(0, 1));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(WitMotionAccelerometerTest, DiscardsWhatArrivedBeforeAndCountsNoneOfItAsLost) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::acceleration(1, 0, 0) + reference::acceleration(2, 0, 0));
  ASSERT_TRUE(bench.accelerometer->next(bench.clock.now()));  // The second waits in the driver.
  const std::string fourth = reference::acceleration(4, 0, 0);
  bench.port->say(reference::acceleration(3, 0, 0) + fourth.substr(0, 5));
  bench.port->say(fourth.substr(5), milliseconds(1));
  bench.port->say(reference::acceleration(5, 0, 0), milliseconds(10));
  bench.accelerometer->discard_pending();
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 5.0 * 16.0 / 32768.0);
  EXPECT_EQ(readings[0].sequence, 4U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(WitMotionAccelerometerTest, ReassemblesAFrameThatComesByteByByte) {
  Bench bench;
  bench.accelerometer->start();
  const std::string frame = reference::acceleration(512, 0, 0);
  for (std::size_t i = 0; i < frame.size(); ++i) bench.port->say(frame.substr(i, 1), milliseconds(i));
  EXPECT_EQ(bench.read_all(seconds(1)).size(), 1U);
}

TEST(WitMotionAccelerometerTest, SaysSoWhenTheDeviceWasRestarted) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->say(reference::acceleration(0, 0, 2048) + reference::frame(0x52, {0, 0, 0, 2500}));
  EXPECT_EQ(bench.read_all().size(), 1U) << "one may be chance";
  bench.port->say(reference::acceleration(0, 0, 2048) + reference::frame(0x53, {0, 0, 0, 17202}));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady),
              AllOf(HasSubstr("restarted"), HasSubstr("53")));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("before it was started"));
}

TEST(WitMotionAccelerometerTest, TakesAModelThatPutsOutMoreThanItWasTold) {
  Script script;
  script.streamed += reference::frame(0x52, {0, 0, 0, 2500});
  Bench bench(script);
  bench.accelerometer->start();
  for (int i = 0; i < 3; ++i) bench.port->say(script.streamed);
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 1, 2));
}

// Failures of the communication.

TEST(WitMotionAccelerometerTest, SaysThatASilentPortIsSilent) {
  Script script;
  script.answers = false;
  Bench bench(script);
  const Clock::Instant began = bench.clock.now();
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply),
              AllOf(HasSubstr("not one byte"), HasSubstr("baud rate")));
  EXPECT_EQ(bench.clock.now() - began, seconds(6));  // once the slowest stream, with a second to spare
  bench.accelerometer->stop();                       // Must not throw.
}

TEST(WitMotionAccelerometerTest, TellsAnotherInstrumentByItsBytes) {
  Script script;
  script.answers = false;
  Bench bench(script);
  // One frame in a line that is full of something else is chance.
  for (int i = 0; i < 100; ++i)
    bench.port->say("$VNACC,+00.100,-09.807,+00.002*55\r\n" +
                        (i == 50 ? reference::acceleration(0, 0, 2048) : std::string()),
                    milliseconds(10 * i));
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("24 56 4E 41"), HasSubstr("another instrument")));
}

TEST(WitMotionAccelerometerTest, TellsALineOnWhichEveryFrameIsDamaged) {
  Script script;
  script.answers = false;
  Bench bench(script);
  std::string damaged = reference::acceleration(0, 0, 2048);
  damaged.back() = static_cast<char>(damaged.back() ^ 1);
  for (int i = 1; i <= 20; ++i) bench.port->say(damaged, milliseconds(90 * i));
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kBadFrame),
              HasSubstr("20 of them with a wrong sum"));
}

TEST(WitMotionAccelerometerTest, FindsItsAnswersWhileDataStreams) {
  Bench bench;
  bench.port->say(reference::acceleration(0, 0, 2048).substr(4));
  for (int i = 0; i < 200; ++i)
    bench.port->say(reference::acceleration(0, 0, 2048) + reference::frame(0x52, {0, 0, 0, 2500}),
                    milliseconds(10 * i));
  EXPECT_EQ(bench.accelerometer->identify().firmware, "17202");
  EXPECT_EQ(bench.port->commands.size(), 3U) << "nothing had to be repeated";
}

TEST(WitMotionAccelerometerTest, NeverTakesALateAnswerForAnother) {
  // The answer to the question for the version comes a second and a half late: it would pass for a range.
  Script script;
  script.on_command = [](ScriptedPort& port, const std::string& command) {
    if (command == from_hex("FF AA 27 2E 00"))
      port.say(reference::frame(0x5F, {0, 0, 0, 0}), milliseconds(2500));
    return true;
  };
  Bench bench(script);
  for (int i = 0; i < 100; ++i) bench.port->say(reference::acceleration(0, 0, 2048), milliseconds(100 * i));
  for (int attempt = 0; attempt < 3; ++attempt) {
    const AccelerometerInfo info = bench.accelerometer->identify();
    EXPECT_EQ(info.firmware, "unknown");
    EXPECT_EQ(info.full_scale, 16.0);
  }
  EXPECT_THAT(bench.port->commands, Each(from_hex("FF AA 27 2E 00")));
}

TEST(WitMotionAccelerometerTest, AsksNothingElseOnceAnAnswerMayStillCome) {
  // The first question is lost, the second try is answered, and then the first is as well.
  Script script;
  int asked = 0;
  script.on_command = [&asked](ScriptedPort& port, const std::string& command) {
    if (command != from_hex("FF AA 27 2E 00")) return false;
    port.say(reference::frame(0x5F, {2, 0, 0, 0}), ++asked == 1 ? milliseconds(1003) : milliseconds(2));
    return true;
  };
  Bench bench(script);
  bench.port->say(reference::acceleration(0, 0, 2048));
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.firmware, "2");
  EXPECT_EQ(info.full_scale, 16.0) << "not the 8 g that a late answer would say";
  EXPECT_EQ(bench.port->commands.size(), 2U);
}

TEST(WitMotionAccelerometerTest, ReportsAnUnpluggedDevice) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->unplugged = true;
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->discard_pending(); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->identify(); }, Fault::kLinkLost);
  bench.accelerometer->stop();  // Must not throw.
  bench.port->unplugged = false;
  EXPECT_NO_THROW(bench.accelerometer->start());
}

// Over the simulated device.

struct SimulatedBench {
  SimulatedBench(const sim::BenchTruth& truth, const sim::WitMotionSettings& device, double rate_hz) {
    AccelerometerSettings settings;
    settings.rate_hz = rate_hz;
    auto firmware =
        std::make_shared<sim::WitMotionFirmware>(std::make_shared<sim::SimBench>(truth, clock.now()), device);
    accelerometer = std::make_unique<WitMotionAccelerometer>(
        std::make_unique<sim::FirmwareStream>(std::move(firmware), clock), clock, settings);
  }

  sim::SimClock clock;
  std::unique_ptr<WitMotionAccelerometer> accelerometer;
};

TEST(WitMotionAccelerometerTest, ReadsTheTruthFromTheSimulatedDevice) {
  sim::BenchTruth truth;
  truth.offset = Eigen::Vector3d(0.0123, -0.0234, 0.0345);
  truth.noise = 0.002;
  truth.temperature_degc = 21.5;
  for (const double rate_hz : {1.0, 20.0, 100.0, 200.0}) {
    SimulatedBench bench(truth, {}, rate_hz);
    EXPECT_EQ(bench.accelerometer->identify().firmware, "17202");
    bench.accelerometer->start();
    constexpr std::uint64_t kReadings = 1000;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::uint64_t i = 0; i < kReadings; ++i) {
      const auto reading = bench.accelerometer->next(bench.clock.now() + seconds(2));
      ASSERT_TRUE(reading);
      ASSERT_EQ(reading->sequence, i);
      EXPECT_EQ(reading->temperature_degc, 21.5);
      EXPECT_FALSE(reading->over_range);
      sum += reading->output;
    }
    const Eigen::Vector3d expected = Eigen::Vector3d(0, 0, 1) + truth.offset;
    // Four standard deviations of the mean, of noise and of steps of 16/32768 g.
    const double tolerance =
        4.0 * std::hypot(truth.noise, 16.0 / 32768.0 / std::sqrt(12.0)) / std::sqrt(kReadings);
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(sum(i) / kReadings, expected(i), tolerance) << rate_hz;
    EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
    EXPECT_EQ(bench.accelerometer->health().bad_frames, 0U);
    EXPECT_EQ(bench.accelerometer->health().skipped_bytes, 0U);
  }
}

TEST(WitMotionAccelerometerTest, SeesTheSimulatedDeviceClip) {
  sim::BenchTruth truth;
  truth.offset = Eigen::Vector3d(0.0, 20.0, 0.0);
  SimulatedBench bench(truth, {}, 100.0);
  bench.accelerometer->start();
  const auto reading = bench.accelerometer->next(bench.clock.now() + seconds(1));
  ASSERT_TRUE(reading);
  EXPECT_TRUE(reading->over_range);
}

TEST(WitMotionAccelerometerTest, IsToldByTheSimulatedDeviceThatItsLineIsTooSlow) {
  sim::WitMotionSettings device;
  device.baud = 9600;
  SimulatedBench bench({}, device, 100.0);
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused), HasSubstr("rate_hz to 87"));
}

}  // namespace
}  // namespace abcal
