#include "drivers/text_line/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>

#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/text_line_firmware.h"
#include "sim/sim_clock.h"
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

struct Bench : test::AccelerometerBench<TextLineAccelerometer> {
  explicit Bench(const AccelerometerSettings& settings = {})
      : AccelerometerBench(settings, [](ScriptedPort&, const std::string&) {
          ADD_FAILURE() << "nothing is sent to a board";
        }) {}

  /// Output of the board from now on: the end of a line, then a line in each period.
  void print(const std::string& line, milliseconds period, int lines) {
    port->say(".99\r\n", milliseconds(1));
    for (int i = 1; i <= lines; ++i) port->say(line + "\r\n", i * period);
  }

  /// Started, with nothing more to come. A hundred lines a second: the first begins the second of time during
  /// which the driver counts.
  void start() {
    print("0,0,1", milliseconds(10), 101);
    accelerometer->start();
  }
};

TEST(TextLineAccelerometerTest, IdentifiesABoardByItsLines) {
  AccelerometerSettings settings;
  settings.unit = "LSB";
  settings.full_scale = 2048.0;
  Bench bench(settings);
  bench.print("1,2,3", milliseconds(10), 10);
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "unknown");
  EXPECT_EQ(info.model, "unknown");
  EXPECT_EQ(info.serial_number, "");
  EXPECT_EQ(info.firmware, "unknown");
  EXPECT_EQ(info.output_unit, "LSB");
  EXPECT_EQ(info.full_scale, 2048.0);
  EXPECT_EQ(info.resolution, std::nullopt);
  EXPECT_EQ(info.rate_hz, 100.0);
}

TEST(TextLineAccelerometerTest, WaitsForABoardThatRestartsWhenItsPortIsOpened) {
  Bench bench;
  bench.port->say("\x80\x01", milliseconds(5));
  bench.port->say("ADXL355 sample program\r\nu,v,w\r\n", milliseconds(2000));
  for (int i = 0; i < 10; ++i) bench.port->say("0,0,1\r\n", milliseconds(2100 + 10 * i));
  EXPECT_EQ(bench.accelerometer->identify().output_unit, "R");
}

// "0,01" is 0.01 to half of the world: read as two columns it would be an output of 0 and one of 1.
TEST(TextLineAccelerometerTest, ADecimalCommaIsRefusedRatherThanReadAsShiftedColumns) {
  for (const char* line : {"0,01,0,02,1,00", "-0,01,0,02,1,00", "0,5,0,02,9,81"}) {
    Bench bench;
    bench.print(line, milliseconds(10), 101);
    EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kImplausible),
                AllOf(HasSubstr("decimal mark"), HasSubstr(line)));
  }
  for (const char* line : {"1,2,3,4,5,6", "10,20,30,40,50,60", "0,01,5", "0.5,0.01,1.0,0,0,0"}) {
    Bench bench;
    bench.print(line, milliseconds(10), 101);
    EXPECT_NO_THROW(bench.accelerometer->identify()) << line;
  }
}

TEST(TextLineAccelerometerTest, GivesOutputsInTheUnitOfTheBenchFile) {
  AccelerometerSettings settings;
  settings.columns = {4, 2, 3};
  settings.separator = " ";
  settings.scale = {2.0, 4.0, -0.5};
  settings.bias = {1.0, 0.0, 0.25};
  Bench bench(settings);
  bench.print("17 0 0 0", milliseconds(10), 101);
  bench.accelerometer->start();
  const Clock::Instant began = bench.clock.now();
  bench.port->say("18 1.0 0.5 3\r\n", milliseconds(3));
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d((3.0 - 1.0) / 2.0, 1.0 / 4.0, (0.5 - 0.25) / -0.5));
  EXPECT_EQ(readings[0].sequence, 0U);
  EXPECT_EQ(readings[0].arrival, began + milliseconds(3));
  EXPECT_FALSE(readings[0].temperature_degc);
  EXPECT_EQ(bench.accelerometer->health().readings, 1U) << "those before the start do not count";
}

TEST(TextLineAccelerometerTest, ReadingsThatWaitedHaveTheTimesAtWhichTheyCame) {
  sim::SimClock clock;
  const auto bench = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  sim::TextLineSettings printed;
  printed.rate_hz = 200.0;
  const auto board = std::make_shared<sim::TextLineFirmware>(bench, printed);
  AccelerometerSettings settings;
  settings.rate_hz = 200.0;
  TextLineAccelerometer accelerometer(std::make_unique<sim::FirmwareStream>(board, clock), clock, settings);
  accelerometer.start();
  accelerometer.discard_pending();
  const Clock::Instant begin = clock.now();
  clock.sleep_until(begin + seconds(1));
  const Clock::Instant end = clock.now();
  Clock::Instant last = begin;
  for (int n = 1; n <= 200; ++n) {
    const auto reading = accelerometer.next(end);
    ASSERT_TRUE(reading) << n;
    EXPECT_EQ(reading->arrival, n == 1 ? reading->arrival : last + milliseconds(5)) << n;
    last = reading->arrival;
  }
  EXPECT_GT(last, end - milliseconds(5));
}

TEST(TextLineAccelerometerTest, DeliversNumbersThatAreNone) {
  Bench bench;
  bench.start();
  bench.port->say("nan,0,1\n0,inf,1\n");
  const auto readings = bench.read_all();
  ASSERT_EQ(readings.size(), 2U);
  EXPECT_TRUE(std::isnan(readings[0].output.x()));
  EXPECT_TRUE(std::isinf(readings[1].output.y()));
  EXPECT_THAT(sequences(readings), ElementsAre(0, 1));
}

TEST(TextLineAccelerometerTest, CountsDamagedLinesAsLostAndKeepsItsFiguresAfterTheStop) {
  Bench bench;
  bench.start();
  bench.port->say("0.01,0.02,1.00\n");
  bench.port->say("0.01,x.02,1.00\n");
  bench.port->say("0.01,0.02,1.00\n");
  bench.port->say("0.01,0.02,1.000.01,0.02,1.00\n");  // The end between two was lost.
  bench.port->say("0.01,0.02,1.00\n");
  bench.port->say("0.01,0\n.02,1.00\n");  // A byte became the end of a line.
  bench.port->say("0.01,0.02,1.00\n# a comment\n\n");
  bench.port->say("0\n");  // All that was left of a line.
  bench.port->say("0.01,0.02,1.00\n");
  EXPECT_THAT(sequences(bench.read_all()), ElementsAre(0, 2, 5, 7, 9));
  bench.accelerometer->stop();
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 5U);
  EXPECT_EQ(health.lost_readings, 5U);
  EXPECT_EQ(health.bad_frames, 5U);
  EXPECT_EQ(health.skipped_bytes, 15U + 29U + 16U + 2U);
}

TEST(TextLineAccelerometerTest, NeverJoinsWhatAFullQueueSeparated) {
  Bench bench;
  bench.start();
  bench.port->say("0.01,0.02,1.00\n0.01,0.");
  EXPECT_EQ(bench.read_all().size(), 1U);
  bench.port->dropped += 10 * 15;
  bench.port->say("99,7.77\n0.01,0.02,1.00\n0.01,0.");  // "0.01,0.99,7.77" was never printed.
  EXPECT_TRUE(bench.read_all().size() == 1U);
  bench.port->say("02,1.00\n0.01,0.02,1.00\n");
  const auto readings = bench.read_all();
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d(0.01, 0.02, 1.00));
  EXPECT_EQ(bench.accelerometer->health().bad_frames, 0U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 12U)
      << "ten, one half of which came, another likewise";
}

TEST(TextLineAccelerometerTest, DoesNotInventALossFromALateArrival) {
  Bench bench;
  bench.start();
  bench.port->say("0,0,1\n", milliseconds(10));
  bench.port->say("0,0,1\n", milliseconds(500));
  EXPECT_THAT(sequences(bench.read_all(seconds(1))), ElementsAre(0, 1));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(TextLineAccelerometerTest, DiscardsWhatArrivedBeforeAndCountsNoneOfItAsLost) {
  Bench bench;
  bench.start();
  bench.port->say("1,0,0\n2,0,0\n");
  ASSERT_TRUE(bench.accelerometer->next(bench.clock.now()));  // The second waits in the driver.
  bench.port->say("3,0,0\n4,0");
  bench.port->say(",0\n", milliseconds(1));
  bench.port->say("5,0,0\n", milliseconds(10));
  bench.accelerometer->discard_pending();
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 5.0);
  EXPECT_EQ(readings[0].sequence, 4U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(TextLineAccelerometerTest, ReassemblesALineThatComesByteByByte) {
  Bench bench;
  bench.start();
  const std::string line = "0.5,0,0\r\n";
  for (std::size_t i = 0; i < line.size(); ++i) bench.port->say(line.substr(i, 1), milliseconds(i));
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 0.5);
}

TEST(TextLineAccelerometerTest, CountsTheLinesOfABoardThatRestarts) {
  Bench bench;
  bench.start();
  bench.port->say("0,0,1\n0,0\nADXL355 sample program\nu,v,w\n0,0,1\n");
  EXPECT_EQ(bench.read_all().size(), 2U);
  EXPECT_EQ(bench.accelerometer->health().bad_frames, 3U);
  EXPECT_GE(bench.accelerometer->health().lost_readings, 1U);
}

// Failures.

TEST(TextLineAccelerometerTest, SaysThatASilentPortIsSilent) {
  Bench bench;
  const Clock::Instant began = bench.clock.now();
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply), HasSubstr("not one byte"));
  EXPECT_EQ(bench.clock.now() - began, seconds(5) + milliseconds(30));  // And three periods.
  bench.accelerometer->stop();                                          // Must not throw.
}

TEST(TextLineAccelerometerTest, TellsAnotherInstrumentByItsBytes) {
  Bench bench;
  for (int i = 0; i < 1000; ++i) bench.port->say("\x75\x65\x80\x0E\x0E\x04>", milliseconds(10 * i + 1));
  EXPECT_THAT(
      error_of([&] { bench.accelerometer->identify(); }, Fault::kWrongIdentity),
      AllOf(HasSubstr("beginning \"ue\\x80"), HasSubstr("columns 1, 2, 3"), HasSubstr("another instrument")));
  Bench other_separator;
  other_separator.print("1;2;3", milliseconds(10), 1000);
  EXPECT_THAT(error_of([&] { other_separator.accelerometer->start(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("separated by \",\""), HasSubstr("1;2;3")));
  error_of([&] { other_separator.accelerometer->next(other_separator.clock.now()); }, Fault::kNotReady);
}

TEST(TextLineAccelerometerTest, RefusesABoardThatPrintsAtAnotherRate) {
  Bench slow;
  slow.print("0,0,1", milliseconds(100), 100);
  EXPECT_THAT(error_of([&] { slow.accelerometer->start(); }, Fault::kImplausible),
              AllOf(HasSubstr("rate_hz is 100"), HasSubstr("10 a second"), HasSubstr("baud rate")));
  Bench fast;
  fast.print("0,0,1", milliseconds(5), 1000);
  EXPECT_THAT(error_of([&] { fast.accelerometer->start(); }, Fault::kImplausible), HasSubstr("200 a second"));
  Bench stops;
  stops.print("0,0,1", milliseconds(10), 3);
  EXPECT_THAT(error_of([&] { stops.accelerometer->start(); }, Fault::kImplausible),
              HasSubstr("less than three"));
}

TEST(TextLineAccelerometerTest, ReportsAnUnpluggedBoard) {
  Bench bench;
  bench.start();
  bench.port->unplugged = true;
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->discard_pending(); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->identify(); }, Fault::kLinkLost);
  bench.accelerometer->stop();  // Must not throw.
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kNotReady);
  bench.port->unplugged = false;
  EXPECT_NO_THROW(bench.start());
}

TEST(TextLineAccelerometerTest, RefusesSettingsThatCannotBe) {
  const auto refuses = [](auto change) {
    AccelerometerSettings settings;
    change(settings);
    EXPECT_THROW(Bench{settings}, std::invalid_argument);
  };
  const double nan = std::nan("");
  for (const double rate_hz : {0.0, -1.0, nan, std::numeric_limits<double>::infinity()})
    refuses([rate_hz](AccelerometerSettings& settings) { settings.rate_hz = rate_hz; });
  refuses([](AccelerometerSettings& settings) { settings.scale[1] = 0.0; });
  refuses([nan](AccelerometerSettings& settings) { settings.scale[2] = nan; });
  refuses([nan](AccelerometerSettings& settings) { settings.bias[0] = nan; });
  refuses([](AccelerometerSettings& settings) { settings.columns = {1, 1, 2}; });
  refuses([](AccelerometerSettings& settings) { settings.columns = {0, 1, 2}; });
  refuses([](AccelerometerSettings& settings) { settings.separator = ""; });
  test::FakeClock clock;
  EXPECT_THROW(TextLineAccelerometer(nullptr, clock, {}), std::invalid_argument);
}

// Over the simulated board.

TEST(TextLineAccelerometerTest, ReadsTheTruthFromTheSimulatedBoard) {
  sim::BenchTruth truth;
  truth.offset = Eigen::Vector3d(0.0123, -0.0234, 0.0345);
  truth.noise = 0.002;
  for (const bool with_time : {false, true}) {
    sim::TextLineSettings board;
    board.header = "# u,v,w in 1/4096 g";
    board.time_column = with_time;
    board.crlf = with_time;
    board.scale = {4096.0, 4096.0, -4096.0};
    board.bias = {10.0, 0.0, 7.5};
    board.decimals = 1;
    board.separator = with_time ? ";" : ",";
    AccelerometerSettings settings;
    settings.scale = board.scale;
    settings.bias = board.bias;
    settings.unit = "g";
    settings.separator = board.separator;
    if (with_time) settings.columns = {2, 3, 4};
    sim::SimClock clock;
    auto firmware =
        std::make_shared<sim::TextLineFirmware>(std::make_shared<sim::SimBench>(truth, clock.now()), board);
    TextLineAccelerometer accelerometer(std::make_unique<sim::FirmwareStream>(firmware, clock), clock,
                                        settings);
    accelerometer.start();
    constexpr std::uint64_t kReadings = 1000;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::uint64_t i = 0; i < kReadings; ++i) {
      const auto reading = accelerometer.next(clock.now() + seconds(1));
      ASSERT_TRUE(reading);
      ASSERT_EQ(reading->sequence, i);
      sum += reading->output;
    }
    const Eigen::Vector3d expected = Eigen::Vector3d(0, 0, 1) + truth.offset;
    // Four standard deviations of the mean; the tenth that is printed, 1/40960 g, is far below the noise.
    const double tolerance = 4.0 * truth.noise / std::sqrt(kReadings);
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(sum(i) / kReadings, expected(i), tolerance);
    EXPECT_EQ(accelerometer.health().lost_readings, 0U);
    EXPECT_EQ(accelerometer.health().bad_frames, 0U);
    EXPECT_EQ(accelerometer.health().skipped_bytes, 0U);
  }
}

}  // namespace
}  // namespace abcal
