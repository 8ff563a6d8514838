#include "drivers/text_line/environment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/text_line_firmware.h"
#include "sim/sim_clock.h"
#include "tests/support/error_of.h"
#include "tests/support/scripted_port.h"

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::ScriptedPort;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr EnvironmentSettings all_three() {
  return {.temperature_column = 1, .humidity_column = 2, .pressure_column = 3};
}

struct Bench {
  explicit Bench(const EnvironmentSettings& settings = all_three()) {
    auto owned = std::make_unique<ScriptedPort>(
        clock, [](ScriptedPort&, const std::string&) { ADD_FAILURE() << "nothing is sent to a sensor"; });
    port = owned.get();
    sensor = std::make_unique<TextLineEnvironment>(std::move(owned), clock, settings);
  }
  EnvironmentReading read(Clock::Duration patience = seconds(3)) {
    return sensor->read(clock.now() + patience);
  }

  test::FakeClock clock;
  ScriptedPort* port = nullptr;
  std::unique_ptr<TextLineEnvironment> sensor;
};

std::string error_of(Bench& bench, Fault fault) {
  return test::error_of([&] { bench.read(); }, fault);
}

TEST(TextLineEnvironmentTest, ReadsTheColumnsItHas) {
  Bench bench;
  bench.port->say(".5\r\n", milliseconds(100));
  bench.port->say("21.5,45.0,1001.25\r\n", milliseconds(1100));
  const EnvironmentReading all = bench.read();
  EXPECT_EQ(all.temperature_degc, 21.5);
  EXPECT_EQ(all.humidity_percent, 45.0);
  EXPECT_EQ(all.pressure_hpa, 1001.25);

  Bench pressure_only(
      {.temperature_column = 0, .humidity_column = 0, .pressure_column = 2, .separator = ";"});
  pressure_only.port->say("\nBMP280;998.5\n");
  const EnvironmentReading one = pressure_only.read();
  EXPECT_EQ(one.temperature_degc, std::nullopt);
  EXPECT_EQ(one.humidity_percent, std::nullopt);
  EXPECT_EQ(one.pressure_hpa, 998.5);
}

TEST(TextLineEnvironmentTest, GivesTheNewestLineThatWaits) {
  Bench bench;
  bench.port->say("\n20,40,1000\n21,41,1001\n22,42,10");
  const Clock::Instant began = bench.clock.now();
  EXPECT_EQ(bench.read().temperature_degc, 21.0);
  EXPECT_EQ(bench.clock.now(), began) << "does not wait for the next one";
  bench.port->say("02\n");
  EXPECT_EQ(bench.read().temperature_degc, 22.0) << "the line of which half had come";
}

/// Bytes that arrived in a queue at an earlier time, as a thread behind a real port puts them there.
class OldBytes final : public wire::ByteStream {
 public:
  explicit OldBytes(Clock& clock) : clock_(clock) {}
  std::vector<wire::ReceivedBytes> waiting;
  std::size_t dropped = 0;
  void write(std::string_view) override {}
  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    if (waiting.empty()) {
      clock_.sleep_until(deadline);
      return {};
    }
    clock_.sleep_until(waiting.front().arrival);
    wire::ReceivedBytes first = waiting.front();
    waiting.erase(waiting.begin());
    return first;
  }
  void discard_input() override {}
  std::size_t dropped_bytes() const override { return dropped; }
  std::string name() const override { return "old"; }

 private:
  Clock& clock_;
};

TEST(TextLineEnvironmentTest, DoesNotGiveALineThatIsOld) {
  test::FakeClock clock;
  auto owned = std::make_unique<OldBytes>(clock);
  OldBytes& bytes = *owned;
  TextLineEnvironment sensor(std::move(owned), clock, all_three());
  bytes.waiting.push_back({"\n20,40,1000\n", clock.now()});
  clock.advance(seconds(11));
  EXPECT_THROW(sensor.read(clock.now() + seconds(1)), InstrumentError);
  bytes.waiting.push_back({"20,40,1000\n", clock.now()});
  clock.advance(seconds(11));
  bytes.waiting.push_back({"25,40,1000\n", clock.now() + seconds(1)});
  EXPECT_EQ(sensor.read(clock.now() + seconds(2)).temperature_degc, 25.0);
}

TEST(TextLineEnvironmentTest, NeverJoinsWhatAFullQueueSeparated) {
  test::FakeClock clock;
  auto owned = std::make_unique<OldBytes>(clock);
  OldBytes& bytes = *owned;
  TextLineEnvironment sensor(std::move(owned), clock, all_three());
  bytes.waiting.push_back({"\n20,40,1000\n2", clock.now()});
  EXPECT_EQ(sensor.read(clock.now()).temperature_degc, 20.0);
  bytes.dropped += 1000;
  bytes.waiting.push_back({"1,42,1000\n22,42,1000\n2", clock.now()});
  EXPECT_EQ(sensor.read(clock.now()).temperature_degc, 22.0) << "\"21,42,1000\" was never printed";
  bytes.waiting.push_back({"9,42,1000\n", clock.now()});
  EXPECT_THROW(sensor.read(clock.now()), InstrumentError) << "nor was \"29,42,1000\"";
}

TEST(TextLineEnvironmentTest, RefusesNumbersThatCannotBe) {
  for (const auto& [line, message] :
       {std::pair{"-90.1,45,1000", "temperature is -90.1 degC; required: -90 to 100"},
        {"100.1,45,1000", "temperature is 100.1"},
        {"nan,45,1000", "temperature is nan"},
        {"20,-0.1,1000", "relative humidity is -0.1 %; required: 0 to 100"},
        {"20,100.5,1000", "relative humidity is 100.5"},
        {"20,45,101325", "pressure is 101325 hPa; required: 300 to 1200"},
        {"20,45,101.3", "pressure is 101.3"}}) {
    Bench bench;
    bench.port->say(std::string("\n") + line + "\n");
    EXPECT_THAT(error_of(bench, Fault::kImplausible), AllOf(HasSubstr(message), HasSubstr("unit")));
  }
  for (const char* line : {"-90,0,300", "100,100,1200"}) {
    Bench bench;
    bench.port->say(std::string("\n") + line + "\n");
    EXPECT_NO_THROW(bench.read());
  }
}

TEST(TextLineEnvironmentTest, SaysWhatIsMissing) {
  Bench silent;
  const Clock::Instant began = silent.clock.now();
  EXPECT_THAT(error_of(silent, Fault::kNoReply), HasSubstr("not one byte"));
  EXPECT_EQ(silent.clock.now() - began, seconds(3)) << "the deadline, and no longer";

  Bench half;
  half.port->say("21.5,4");
  EXPECT_THAT(error_of(half, Fault::kNoReply), HasSubstr("only \"21.5,4\""));

  Bench other;
  for (int i = 0; i < 5; ++i) other.port->say("T=21.5 C\r\n", milliseconds(100 * i));
  EXPECT_THAT(error_of(other, Fault::kWrongIdentity), AllOf(HasSubstr("T=21.5 C"), HasSubstr("columns")));

  Bench damaged;
  damaged.port->say("\n21.5,45,1000\n");
  EXPECT_NO_THROW(damaged.read());
  damaged.port->say("21.5,4?,1000\n");
  EXPECT_THAT(error_of(damaged, Fault::kBadFrame), HasSubstr("1 lines"));
  damaged.port->say("21.75,45,1000\n");
  EXPECT_EQ(damaged.read().temperature_degc, 21.75) << "one bad line is forgotten with the next good one";

  Bench unplugged;
  unplugged.port->unplugged = true;
  error_of(unplugged, Fault::kLinkLost);
}

TEST(TextLineEnvironmentTest, RefusesSettingsThatCannotBe) {
  EXPECT_THROW(Bench({.temperature_column = 0}), std::invalid_argument) << "nothing to read";
  EXPECT_THROW(Bench({.temperature_column = -1}), std::invalid_argument);
  EXPECT_THROW(Bench({.temperature_column = 1, .humidity_column = 1}), std::invalid_argument);
  EXPECT_THROW(Bench({.temperature_column = 1, .separator = ""}), std::invalid_argument);
  test::FakeClock clock;
  EXPECT_THROW(TextLineEnvironment(nullptr, clock, {}), std::invalid_argument);
}

TEST(TextLineEnvironmentTest, ReadsTheSimulatedSensor) {
  sim::SimClock clock;
  sim::BenchTruth truth;
  truth.temperature_degc = 21.0;
  truth.temperature_per_hour = 2.0;
  sim::TextLineSettings board;
  board.content = sim::TextLineSettings::Content::kEnvironment;
  board.rate_hz = 0.5;
  board.header = "temperature,humidity,pressure";
  board.decimals = 2;
  board.humidity_percent = 38.5;
  board.pressure_hpa = 987.25;
  auto firmware =
      std::make_shared<sim::TextLineFirmware>(std::make_shared<sim::SimBench>(truth, clock.now()), board);
  TextLineEnvironment sensor(std::make_unique<sim::FirmwareStream>(firmware, clock), clock, all_three());
  for (const int minutes : {0, 30, 60}) {
    clock.sleep_until(Clock::Instant{} + std::chrono::minutes(minutes));
    const EnvironmentReading reading = sensor.read(clock.now() + seconds(5));
    ASSERT_TRUE(reading.temperature_degc);
    // The printed value is up to 2 s old, a thousandth of a degree; plus half of the last printed digit.
    EXPECT_NEAR(*reading.temperature_degc, 21.0 + minutes / 30.0, 0.0012 + 0.005);
    EXPECT_EQ(reading.humidity_percent, 38.5);
    EXPECT_EQ(reading.pressure_hpa, 987.25);
  }
}

}  // namespace
}  // namespace abcal
