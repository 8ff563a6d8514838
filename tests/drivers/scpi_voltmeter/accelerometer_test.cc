#include "drivers/scpi_voltmeter/accelerometer.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cerrno>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "drivers/wire/usbtmc_stream.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/endless_stream.h"
#include "tests/support/accelerometer_bench.h"
#include "tests/support/error_of.h"
#include "tests/support/scripted_line.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using test::ScriptedLine;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;

constexpr double kRateHz = 5.0;
constexpr Clock::Duration kPeriod = 200ms;
/// At 1 PLC a scan is waited for less long than this.
constexpr Clock::Duration kBeyondPatience = 5s;
constexpr Clock::Duration kAnswerTime = 5s;

AccelerometerSettings settings_at(double rate_hz) {
  AccelerometerSettings settings;
  settings.rate_hz = rate_hz;
  return settings;
}

/// Answers of a voltmeter.
struct FakeMeter {
  std::string identity = "HEWLETT-PACKARD,34970A,MY1,13-2-2";
  std::string no_error = "+0,\"No error\"";
  std::string scan_list = "#214(@101,102,103)";
  /// The answer to the nth READ?; the first one, number 0, is start()'s.
  std::function<std::string(int scan)> readings = [](int scan) {
    return fmt::format("+{0}.1E+00,101,+{0}.2E+00,102,+{0}.3E+00,103", scan);
  };
  std::map<std::string, std::vector<std::string>> errors;  ///< Errors that a command causes.

  std::string operator()(const std::string& command) {
    if (command == "*IDN?") return identity + "\n";
    if (command == "*CLS") waiting.clear();
    if (command == "SYST:ERR?") {
      if (waiting.empty()) return no_error + "\n";
      const std::string error = waiting.front();
      waiting.erase(waiting.begin());
      return error + "\n";
    }
    if (const auto found = errors.find(command); found != errors.end())
      waiting.insert(waiting.end(), found->second.begin(), found->second.end());
    if (command == "ROUT:SCAN?") return scan_list + "\r\n";
    if (command == "READ?") return readings(scans++) + "\n";
    return {};
  }

  std::vector<std::string> waiting{};
  int scans = 0;
};

struct Bench : test::AccelerometerBench<ScpiScanningVoltmeter, ScriptedLine> {
  explicit Bench(const FakeMeter& fake = {}, const AccelerometerSettings& settings = settings_at(kRateHz))
      : AccelerometerBench(settings, '\n', fake) {}

  std::optional<Reading> next(Clock::Duration patience = 1s) {
    const Clock::Instant deadline = clock.now() + patience;
    auto reading = accelerometer->next(deadline);
    EXPECT_LE(clock.now(), deadline);
    return reading;
  }
  /// The number of the READ? whose reply the next reading is, encoded in its value.
  int next_scan(Clock::Duration patience = 60s) {
    const auto reading = next(patience);
    return reading ? static_cast<int>(std::lround(reading->output(0) - 0.1)) : -1;
  }
  /// Settings sent to it, without queries.
  std::vector<std::string> settings_sent() const {
    std::vector<std::string> sent;
    for (const std::string& command : port->commands())
      if (!command.ends_with('?')) sent.push_back(command);
    return sent;
  }
};

FakeMeter keithley(const std::string& model) {
  FakeMeter fake;
  fake.identity = "KEITHLEY INSTRUMENTS INC.,MODEL " + model + ",1234567,B02  /A02";
  fake.no_error = "0, \"no error\"";
  return fake;
}

// ---- Identification

TEST(ScpiScanningVoltmeterTest, IdentifiesTheModelAndChangesNothing) {
  AccelerometerSettings settings = settings_at(kRateHz);
  settings.scale = {1.0, -0.5, 2.0};
  settings.bias = {0.0, 2.5, 2.5};
  settings.unit = "g";
  Bench bench({}, settings);
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "HEWLETT-PACKARD");
  EXPECT_EQ(info.model, "34970A");
  EXPECT_EQ(info.serial_number, "MY1");
  EXPECT_EQ(info.firmware, "13-2-2");
  EXPECT_EQ(info.output_unit, "g");
  EXPECT_EQ(info.full_scale, 25.0) << "(10 V + 2.5 V) / 0.5 V/g";
  EXPECT_EQ(info.rate_hz, kRateHz);
  EXPECT_THAT(bench.port->commands(), ElementsAre("*IDN?"));
  EXPECT_EQ(Bench().accelerometer->identify().output_unit, "V");
}

TEST(ScpiScanningVoltmeterTest, RefusesWhatItDoesNotKnowAndSaysWhatItKnows) {
  for (const char* identity :
       {"ACME,34970A,0,1", "HEWLETT-PACKARD,34401A,0,11-5-2", "KEITHLEY,MODEL 6430,1,C"}) {
    FakeMeter fake;
    fake.identity = identity;
    EXPECT_THAT(
        error_of([&] { Bench(fake).accelerometer->identify(); }, Fault::kWrongIdentity),
        AllOf(HasSubstr("34970A, 34972A and DAQ970A"), HasSubstr("2700 and 2001"), HasSubstr("model")))
        << identity;
  }
}

TEST(ScpiScanningVoltmeterTest, SaysWhatIsWrongWithTheSettingsAllAtOnce) {
  AccelerometerSettings settings = settings_at(0.0);
  settings.range_v = -1.0;
  settings.integration_plc = std::nan("");
  settings.scale[1] = 0.0;
  settings.bias[2] = std::numeric_limits<double>::infinity();
  settings.channels = {101, 102, 101};
  try {
    Bench bench({}, settings);
    FAIL() << "accepted";
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("rate_hz is 0"), HasSubstr("range_v is -1"),
                                    HasSubstr("integration_plc is nan"), HasSubstr("scale has 0"),
                                    HasSubstr("bias has inf"), HasSubstr("101, 102, 101")));
  }
}

// ---- Settings

TEST(ScpiScanningVoltmeterTest, SetsAKeysightScanner) {
  AccelerometerSettings settings = settings_at(kRateHz);
  settings.channels = {103, 101, 110};
  settings.range_v = 1.0;
  settings.integration_plc = 0.2;
  FakeMeter fake;
  fake.scan_list = "#214(@101,103,110)";
  fake.readings = [](int) { return "+1.0E+00,101,+2.0E+00,103,+3.0E+00,110"; };
  Bench bench(fake, settings);
  bench.accelerometer->start();
  EXPECT_THAT(bench.settings_sent(),
              ElementsAre("SYST:REM", "*RST", "*CLS", "CONF:VOLT:DC 1,MAX,(@103,101,110)",
                          "SENS:VOLT:DC:NPLC 0.2,(@103,101,110)", "SENS:VOLT:DC:ZERO:AUTO ON,(@103,101,110)",
                          "ROUT:SCAN (@103,101,110)", "TRIG:SOUR IMM", "TRIG:COUN 1", "FORM:READ:CHAN ON",
                          "FORM:READ:UNIT OFF", "FORM:READ:TIME OFF"));
  EXPECT_EQ(bench.next()->output, Eigen::Vector3d(2.0, 1.0, 3.0)) << "by channel, not by order";
}

TEST(ScpiScanningVoltmeterTest, SetsTheKeithleys) {
  Bench scanner(keithley("2700"));
  scanner.accelerometer->start();
  EXPECT_THAT(scanner.settings_sent(),
              ElementsAre("*RST", "*CLS", ":INIT:CONT OFF", ":SENS:FUNC \"VOLT\",(@101,102,103)",
                          ":SENS:VOLT:RANG 10,(@101,102,103)", ":SENS:VOLT:NPLC 1,(@101,102,103)",
                          ":FORM:ELEM READ,CHAN", ":ROUT:SCAN (@101,102,103)", ":ROUT:SCAN:LSEL INT",
                          ":TRIG:COUN 1", ":SAMP:COUN 3"));
  AccelerometerSettings settings = settings_at(kRateHz);
  settings.channels = {1, 2, 3};
  FakeMeter fake = keithley("2001");
  fake.readings = [](int) { return "+1.5E+00VDC,001,-2.5E+00VDC,002,+3.5E+00VDC,003"; };
  Bench other(fake, settings);
  other.accelerometer->start();
  EXPECT_THAT(other.settings_sent(), AllOf(Contains(":SENS:FUNC \"VOLT\""), Contains(":SENS:VOLT:NPLC 1"),
                                           Contains(":ROUT:SCAN (@1,2,3)"), Contains(":ARM:LAY2:COUN 1"),
                                           Contains(":TRIG:COUN 3"), Not(Contains(":SAMP:COUN 3"))));
  EXPECT_EQ(other.next()->output, Eigen::Vector3d(1.5, -2.5, 3.5));
}

TEST(ScpiScanningVoltmeterTest, SaysTheRefusalInTheInstrumentsWords) {
  FakeMeter fake;
  fake.errors["CONF:VOLT:DC 10,MAX,(@101,102,103)"] = {"-222,\"Data out of range\"",
                                                       "+301,\"Module currently committed to scan\""};
  Bench bench(fake);
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("34970A (SN MY1)"), HasSubstr("error -222 (\"Data out of range\")"),
                    HasSubstr("error 301"), HasSubstr("\"CONF:VOLT:DC 10,MAX,(@101,102,103)\"")));
  EXPECT_THAT(bench.settings_sent(), Not(Contains("TRIG:COUN 1"))) << "nothing is set after a refusal";
}

TEST(ScpiScanningVoltmeterTest, HeedsNoErrorsOfBefore) {
  FakeMeter fake;
  fake.errors["SYST:REM"] = {"-113,\"Undefined header\""};
  fake.waiting = {"-410,\"Query INTERRUPTED\""};
  Bench bench(fake);
  EXPECT_NO_THROW(bench.accelerometer->start());
}

TEST(ScpiScanningVoltmeterTest, RefusesARateThatTheIntegrationCannotKeepBeforeItSetsAnything) {
  AccelerometerSettings settings = settings_at(5.0);
  settings.integration_plc = 10.0;
  Bench bench({}, settings);
  // Three channels of 10 cycles, twice because of the automatic zero: 1 s at 60 Hz.
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 5"), HasSubstr("at most 1,"), HasSubstr("automatic zero")));
  EXPECT_THAT(bench.settings_sent(), SizeIs(0));
}

TEST(ScpiScanningVoltmeterTest, RefusesARateThatItsScansDoNotKeepInTheMean) {
  Bench bench;
  bench.port->mishaps["READ?"].assign(11, {.late = 400ms});
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 5"), HasSubstr("at most 2.48"), HasSubstr("0.402 s (mean of 10)")));
}

TEST(ScpiScanningVoltmeterTest, OneSlowScanDoesNotMakeARateImpossible) {
  Bench bench;
  bench.port->mishaps["READ?"] = {{.late = 400ms}};
  EXPECT_NO_THROW(bench.accelerometer->start());
  EXPECT_EQ(bench.port->count("READ?"), 11U);
  // A few slow scans among the others are accepted, too: the mean counts.
  bench.port->mishaps["READ?"] = {{.late = 400ms}, {.late = 400ms}, {}, {.late = 400ms}};
  EXPECT_NO_THROW(bench.accelerometer->start());
}

TEST(ScpiScanningVoltmeterTest, AVerySlowVoltmeterIsJudgedByFewerScans) {
  Bench bench;
  bench.port->mishaps["READ?"].assign(11, {.late = 3s});
  const Clock::Instant begin = bench.clock.now();
  error_of([&] { bench.accelerometer->start(); }, Fault::kRefused);
  EXPECT_LT(bench.clock.now() - begin, 20s);
}

TEST(ScpiScanningVoltmeterTest, RefusesAVoltmeterThatScansOtherChannels) {
  FakeMeter fake;
  fake.scan_list = "#214(@101,102,104)";
  EXPECT_THAT(error_of([&] { Bench(fake).accelerometer->start(); }, Fault::kImplausible),
              AllOf(HasSubstr("(@101,102,104)"), HasSubstr("required: (@101,102,103)")));
  fake = keithley("2700");  // It has no answer to the query; its replies show the channels.
  fake.readings = [](int) { return "+1.0E+00,101,+2.0E+00,102,+3.0E+00,104"; };
  EXPECT_THAT(error_of([&] { Bench(fake).accelerometer->start(); }, Fault::kBadFrame),
              HasSubstr("no channel 103; required: (@101,102,103)"));
}

// ---- Readings

TEST(ScpiScanningVoltmeterTest, ConvertsVoltsByChannel) {
  AccelerometerSettings settings = settings_at(kRateHz);
  settings.scale = {0.5, -2.0, 1.0};
  settings.bias = {1.0, 0.5, -1.0};
  FakeMeter fake;
  fake.readings = [](int) { return "+1.25E+00,101,+2.5E+00,102,-9.9E+37,103"; };
  Bench bench(fake, settings);
  bench.accelerometer->start();
  const auto reading = bench.next();
  EXPECT_EQ(reading->output, Eigen::Vector3d(0.5, -1.0, -9.0)) << "(V - bias) / scale; overload: -10 V";
  EXPECT_TRUE(reading->over_range);
}

TEST(ScpiScanningVoltmeterTest, KeepsItsRateAndCountsItsScans) {
  Bench bench;
  bench.accelerometer->start();
  std::optional<Clock::Instant> last;
  for (int scan = 1; scan <= 20; ++scan) {
    const auto reading = bench.next();
    ASSERT_TRUE(reading);
    EXPECT_FALSE(reading->over_range);
    EXPECT_EQ(reading->sequence, static_cast<std::uint64_t>(scan - 1));
    EXPECT_NEAR(reading->output(2), scan + 0.3, 4e-15 * scan) << "a few ulp";
    EXPECT_EQ(reading->arrival, bench.clock.now());
    if (last) {
      EXPECT_EQ(reading->arrival - *last, kPeriod);
    }
    last = reading->arrival;
  }
  bench.clock.advance(10s);  // Nobody asked: nothing was measured, so nothing is lost or old.
  EXPECT_EQ(bench.next_scan(), 21);
  EXPECT_EQ(bench.accelerometer->health().readings, 21U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(ScpiScanningVoltmeterTest, KeepsTheDeadlineWhileAScanLasts) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->mishaps["READ?"] = {{.late = 1s}};
  for (int i = 0; i < 9; ++i) {
    const Clock::Instant deadline = bench.clock.now() + 100ms;
    EXPECT_FALSE(bench.accelerometer->next(deadline));
    EXPECT_EQ(bench.clock.now(), deadline);
  }
  EXPECT_FALSE(bench.accelerometer->next(bench.clock.now() - 1h)) << "a deadline long gone";
  EXPECT_EQ(bench.port->count("READ?"), 2U) << "the same scan all the time";
  EXPECT_EQ(bench.next_scan(), 1);
}

TEST(ScpiScanningVoltmeterTest, ThrowsAwayTheScanThatBeganBeforeADiscard) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->mishaps["READ?"] = {{.late = 100ms}};
  EXPECT_FALSE(bench.next(10ms));
  bench.accelerometer->discard_pending();
  EXPECT_EQ(bench.next_scan(), 2);
  bench.accelerometer->discard_pending();  // None is under way now.
  EXPECT_EQ(bench.next_scan(), 3);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(ScpiScanningVoltmeterTest, UnderstandsARepliesBytesOneByOne) {
  Bench bench;
  bench.port->byte_by_byte = true;
  bench.accelerometer->start();
  for (int scan = 1; scan < 5; ++scan) EXPECT_EQ(bench.next_scan(), scan);
}

TEST(ScpiScanningVoltmeterTest, NeverTakesALateReplyForTheNextScan) {
  for (const Clock::Duration late : {3s, 4s, 6s, 8s, 9s, 11s}) {
    Bench bench;
    bench.accelerometer->start();
    bench.port->mishaps["READ?"] = {{.late = late}};
    const auto reading = bench.next(60s);
    ASSERT_TRUE(reading) << to_seconds(late);
    const auto health = bench.accelerometer->health();
    if (late == 3s) {
      EXPECT_EQ(reading->output(0), 1.1) << "in time";
      EXPECT_EQ(health.lost_readings, 0U);
    } else {
      EXPECT_EQ(reading->output(0), 2.1) << to_seconds(late);
      EXPECT_EQ(reading->sequence, 1U);
      EXPECT_EQ(health.lost_readings, 1U);
    }
    EXPECT_EQ(bench.next_scan(), late == 3s ? 2 : 3);
  }
}

TEST(ScpiScanningVoltmeterTest, NeverTakesALateAnswerToASettingsQuery) {
  FakeMeter fake;
  fake.errors["TRIG:COUN 1"] = {"-222,\"Data out of range\""};
  Bench bench(fake);
  bench.port->mishaps["SYST:ERR?"] = {{.late = 7s}};  // "No error", of *CLS.
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kNoReply), HasSubstr("SYST:ERR?"));
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused), HasSubstr("\"TRIG:COUN 1\""))
      << "the error is told of the command that caused it";
}

TEST(ScpiScanningVoltmeterTest, LosesADamagedScanAndCountsIt) {
  for (const char* damaged :
       {"garbage\n", "+1.1E+00,101,+1.2E+00,102\n", "+1.1E+00,101,+1.2E+00,102,+1.3E,103\n", "\xFF\xFE\n",
        "\n", "+0,\"No error\"\n", "+1.1E+00,101,+1.2E+00,102,+1.3E+00,104\n",
        "+1.1,101,+1.2,101,+1.3,102\n"}) {
    Bench bench;
    bench.accelerometer->start();
    bench.port->mishaps["READ?"] = {{.instead = damaged}};
    EXPECT_EQ(bench.next_scan(), 2) << damaged;
    const auto health = bench.accelerometer->health();
    EXPECT_EQ(health.lost_readings, 1U);
    EXPECT_EQ(health.bad_frames, 1U);
    EXPECT_EQ(health.skipped_bytes, std::string_view(damaged).size());
  }
}

TEST(ScpiScanningVoltmeterTest, LosesAScanOfWhichNothingOrHalfCame) {
  for (const char* half : {"", "+1.1E+00,101,+1.2"}) {
    Bench bench;
    bench.accelerometer->start();
    bench.port->mishaps["READ?"] = {{.instead = half}};
    EXPECT_EQ(bench.next_scan(), 2) << half;
    EXPECT_EQ(bench.accelerometer->health().lost_readings, 1U);
    EXPECT_EQ(bench.accelerometer->health().skipped_bytes, std::string_view(half).size());
  }
}

TEST(ScpiScanningVoltmeterTest, AsksForTheIdentityAgainWhereNoiseSpoiltIt) {
  Bench bench;
  bench.port->mishaps["*IDN?"] = {{.instead = "\xF0noise\n"}};
  bench.accelerometer->start();
  bench.port->mishaps["READ?"] = {{.instead = ""}};
  bench.port->mishaps["*IDN?"] = {{.before = "noise"}};
  EXPECT_EQ(bench.next_scan(), 2);
}

TEST(ScpiScanningVoltmeterTest, GivesUpAfterThreeLostScansInARow) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->mishaps["READ?"] = {{.instead = "x\n"}, {.instead = "x\n"}, {.instead = "+1,101\n"}};
  EXPECT_THAT(
      error_of([&] { bench.next(60s); }, Fault::kBadFrame),
      AllOf(HasSubstr("3 scans in a row"), HasSubstr("\"+1,101\""), HasSubstr("1 readings; required: 3")));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 3U);
}

TEST(ScpiScanningVoltmeterTest, SaysWhyThereIsNoReadingIfTheVoltmeterDoes) {
  FakeMeter fake;
  fake.errors["READ?"] = {"-410,\"Query INTERRUPTED\"", "+532,\"Cannot achieve requested resolution\""};
  Bench bench(fake);
  bench.port->mishaps["READ?"] = {{}, {.instead = ""}};
  bench.accelerometer->start();
  EXPECT_THAT(error_of([&] { bench.next(60s); }, Fault::kRefused),
              AllOf(HasSubstr("error 532"), HasSubstr("Cannot achieve"), HasSubstr("\"READ?\"")));
}

TEST(ScpiScanningVoltmeterTest, SaysThatNothingComes) {
  Bench bench;
  bench.port->silent = true;
  Clock::Instant begin = bench.clock.now();
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply),
              AllOf(HasSubstr("*IDN?"), HasSubstr("switched on")));
  EXPECT_LE(bench.clock.now() - begin, 2 * kAnswerTime);

  bench.port->silent = false;
  bench.accelerometer->start();
  bench.port->silent = true;
  begin = bench.clock.now();
  EXPECT_THAT(error_of([&] { bench.accelerometer->next(begin + 1h); }, Fault::kNoReply),
              AllOf(HasSubstr("no reply to \"READ?\""), HasSubstr("no answer to \"*IDN?\"")));
  EXPECT_LE(bench.clock.now() - begin, 2 * kBeyondPatience + 2 * kAnswerTime);

  // It comes back, with a changed world behind it: readings delivered then were measured then.
  bench.port->silent = false;
  const std::size_t asked = bench.port->count("READ?");
  EXPECT_TRUE(bench.next(60s));
  EXPECT_EQ(bench.port->count("READ?"), asked + 1);
}

TEST(ScpiScanningVoltmeterTest, SaysThatSomethingElseAnswers) {
  Bench bench;
  for (int i = 0; i < 2; ++i)
    bench.port->mishaps["*IDN?"].push_back({.instead = "@01 0 RJ IDLE -- BADCOMMAND\n"});
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("BADCOMMAND"), HasSubstr("another instrument")));
}

TEST(ScpiScanningVoltmeterTest, SaysThatThePortIsGone) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->unplugged = true;
  for (int i = 0; i < 3; ++i) error_of([&] { bench.next(); }, Fault::kLinkLost);
  bench.accelerometer->stop();
  error_of([&] { bench.accelerometer->identify(); }, Fault::kLinkLost);
}

TEST(ScpiScanningVoltmeterTest, StopsAndGoesLocal) {
  Bench bench;
  error_of([&] { bench.next(); }, Fault::kNotReady);
  bench.accelerometer->stop();
  EXPECT_THAT(bench.port->commands(), SizeIs(0)) << "who is there is not known";
  bench.accelerometer->start();
  bench.port->mishaps["READ?"] = {{.late = 1s}};
  EXPECT_FALSE(bench.next(10ms));
  bench.accelerometer->stop();
  const auto commands = bench.port->commands();
  EXPECT_EQ(commands.at(commands.size() - 2), "ABOR");
  EXPECT_EQ(commands.back(), "SYST:LOC");
  error_of([&] { bench.next(); }, Fault::kNotReady);
  bench.accelerometer->start();  // The reply to the READ? that was abandoned is on its way.
  EXPECT_EQ(bench.next_scan(), 3);
}

/// An endless stream of bytes.
class Babble final : public wire::ByteStream {
 public:
  Babble(test::FakeClock& clock, std::string bytes) : clock_(clock), bytes_(std::move(bytes)) {}
  bool on = true;
  void write(std::string_view) override {}
  wire::ReceivedBytes read_until(Clock::Instant) override {
    clock_.advance(1ms);
    return {bytes_, clock_.now()};
  }
  void discard_input() override {}
  std::string name() const override { return "babble"; }

 private:
  test::FakeClock& clock_;
  std::string bytes_;
};

TEST(ScpiScanningVoltmeterTest, IsNotHeldByAStreamThatNeverPauses) {
  for (const char* bytes : {"x", "x\n", "x\ny\n", "+0,\"No error\"\n", "HEWLETT-PACKARD,34970A,MY1,13-2-2\n",
                            "HEWLETT-PACKARD,34970A,MY1,13-2-2\n+0,\"No error\"\n"}) {
    test::FakeClock clock;
    ScpiScanningVoltmeter accelerometer(std::make_unique<Babble>(clock, bytes), clock, settings_at(kRateHz));
    EXPECT_THROW(accelerometer.start(), InstrumentError) << bytes;
    EXPECT_LT(clock.now().time_since_epoch(), 120s) << bytes;
  }
}

TEST(ScpiScanningVoltmeterTest, KeepsOfALineWithoutEndNoMoreThanItShows) {
  const auto most_kilobytes = [] {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    return usage.ru_maxrss;
  };
  test::FakeClock clock;
  auto owned = std::make_unique<test::EndlessStream>(clock, std::string(100'000, 'x'));
  const test::EndlessStream& stream = *owned;
  ScpiScanningVoltmeter accelerometer(std::move(owned), clock, settings_at(kRateHz));
  const auto before = most_kilobytes();
  const std::string error = error_of([&] { accelerometer.identify(); }, Fault::kWrongIdentity);
  EXPECT_THAT(error, AllOf(HasSubstr("what arrived was \"xxxx"), HasSubstr("another instrument")));
  EXPECT_LT(error.size(), 1000U);
  ASSERT_GT(stream.given(), 900'000'000U);
  EXPECT_LT(most_kilobytes() - before, 500'000) << "a sanitizer keeps some of what is freed";
}

// ---- Three voltmeters of one channel

struct SinglesBench {
  explicit SinglesBench(std::array<FakeMeter, 3> fakes = singles(),
                        AccelerometerSettings settings = settings_at(kRateHz)) {
    std::array<std::unique_ptr<wire::ByteStream>, 3> streams;
    for (std::size_t i = 0; i < 3; ++i) {
      auto owned = std::make_unique<ScriptedLine>(clock, '\n', fakes[i]);
      lines[i] = owned.get();
      streams[i] = std::move(owned);
    }
    accelerometer = std::make_unique<ScpiSingleVoltmeters>(std::move(streams), clock, settings);
  }

  /// Each value encodes the unit and the number of the READ? that it answers: scan + unit / 10.
  static std::array<FakeMeter, 3> singles() {
    std::array<FakeMeter, 3> fakes;
    for (int unit = 0; unit < 3; ++unit) {
      FakeMeter& fake = fakes[static_cast<std::size_t>(unit)];
      fake.identity = fmt::format("HEWLETT-PACKARD,34401A,US{},11-5-2", unit);
      fake.readings = [unit](int scan) { return fmt::format("+{}.{}E+00", scan, unit); };
    }
    return fakes;
  }

  test::FakeClock clock;
  std::array<ScriptedLine*, 3> lines{};
  std::unique_ptr<ScpiSingleVoltmeters> accelerometer;
};

TEST(ScpiSingleVoltmetersTest, AreThreeUnits) {
  SinglesBench bench;
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.model, "34401A");
  EXPECT_EQ(info.serial_number, "US0, US1, US2");
  auto fakes = SinglesBench::singles();
  fakes[2].identity = "HEWLETT-PACKARD,34970A,MY1,13-2-2";
  EXPECT_THAT(error_of([&] { SinglesBench(fakes).accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("34970A"), HasSubstr("known are the voltmeters 34401A")));
}

TEST(ScpiSingleVoltmetersTest, AreSetAlike) {
  SinglesBench bench;
  bench.accelerometer->start();
  for (const ScriptedLine* line : bench.lines) {
    std::vector<std::string> sent;
    for (const std::string& command : line->commands())
      if (!command.ends_with('?')) sent.push_back(command);
    EXPECT_THAT(sent, ElementsAre("SYST:REM", "*RST", "*CLS", "CONF:VOLT:DC 10", "SENS:VOLT:DC:NPLC 1",
                                  "TRIG:SOUR IMM", "TRIG:COUN 1", "SAMP:COUN 1"));
  }
  bench.accelerometer->stop();
  for (const ScriptedLine* line : bench.lines) EXPECT_EQ(line->commands().back(), "SYST:LOC");
}

TEST(ScpiSingleVoltmetersTest, MeasureAllAtOnce) {
  SinglesBench bench;
  bench.accelerometer->start();
  bench.lines[0]->mishaps["READ?"] = {{.late = 500ms}};
  EXPECT_FALSE(bench.accelerometer->next(bench.clock.now()));
  for (const ScriptedLine* line : bench.lines) EXPECT_EQ(line->count("READ?"), 2U) << "nobody waited for u";
  const auto reading = bench.accelerometer->next(bench.clock.now() + 1s);
  ASSERT_TRUE(reading);
  EXPECT_EQ(reading->output, Eigen::Vector3d(1.0, 1.1, 1.2));
  EXPECT_EQ(reading->arrival, bench.clock.now()) << "of the last";
}

TEST(ScpiSingleVoltmetersTest, NeverMixScans) {
  const std::vector<ScriptedLine::Mishap> mishaps{{.instead = ""}, {.late = 4s},
                                                  {.late = 8s},    {.instead = "noise\n"},
                                                  {.late = 100ms}, {.before = "noise"}};
  for (std::size_t unit = 0; unit < 3; ++unit) {
    for (const auto& mishap : mishaps) {
      SinglesBench bench;
      bench.accelerometer->start();
      bench.lines[unit]->mishaps["READ?"] = {{}, mishap};
      std::vector<std::uint64_t> sequences;
      for (int i = 0; i < 4; ++i) {
        const auto reading = bench.accelerometer->next(bench.clock.now() + 60s);
        ASSERT_TRUE(reading);
        const double scan = std::floor(reading->output(0));
        EXPECT_EQ(reading->output, Eigen::Vector3d(scan, scan + 0.1, scan + 0.2));
        EXPECT_EQ(reading->sequence + 1, static_cast<std::uint64_t>(scan));
        sequences.push_back(reading->sequence);
      }
      const auto lost = bench.accelerometer->health().lost_readings;
      EXPECT_EQ(lost, mishap.late == 100ms ? 0U : 1U);
      EXPECT_EQ(sequences.back() + 1, 4 + lost);
    }
  }
}

TEST(ScpiSingleVoltmetersTest, OneThatIsUnpluggedOrSilentIsNamed) {
  SinglesBench bench;
  bench.accelerometer->start();
  bench.lines[1]->silent = true;
  EXPECT_THAT(error_of([&] { bench.accelerometer->next(bench.clock.now() + 1h); }, Fault::kNoReply),
              HasSubstr("(SN US1)"));
  bench.lines[1]->unplugged = true;
  error_of([&] { bench.accelerometer->next(bench.clock.now() + 1h); }, Fault::kLinkLost);
}

// ---- With the simulated firmware, which was written separately

/// Reads 1 V/g_loc, 2 V/g_loc and 3 V/g_loc along its axes, and offsets.
sim::BenchTruth truth_in_volts(double noise) {
  sim::BenchTruth truth;
  truth.sensitivity_matrix.diagonal() << 1.0, 2.0, 3.0;
  truth.offset << 0.5, -0.25, 0.125;
  truth.noise = noise;
  return truth;
}

struct SimulatedBench {
  SimulatedBench(sim::ScpiFamily family, std::array<int, 3> channels, double noise = 0.0,
                 AccelerometerSettings settings = settings_at(kRateHz))
      : world(std::make_shared<sim::SimBench>(truth_in_volts(noise), clock.now())) {
    settings.channels = channels;
    const auto stream = [&](std::size_t single) {
      sim::ScpiVoltmeterSettings meter;
      meter.family = family;
      meter.channels = channels;
      meter.single_channel = single;
      meter.needs_remote = family == sim::ScpiFamily::kKeysight34401a;
      if (family == sim::ScpiFamily::kKeithley2700 && channels[0] == 1) meter.model = "2001";
      return std::make_unique<sim::FirmwareStream>(std::make_shared<sim::ScpiVoltmeterFirmware>(world, meter),
                                                   clock);
    };
    if (family == sim::ScpiFamily::kKeysight34401a) {
      accelerometer = std::make_unique<ScpiSingleVoltmeters>(
          std::array<std::unique_ptr<wire::ByteStream>, 3>{stream(0), stream(1), stream(2)}, clock, settings);
    } else {
      accelerometer = std::make_unique<ScpiScanningVoltmeter>(stream(0), clock, settings);
    }
  }

  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world;
  std::unique_ptr<Accelerometer> accelerometer;
};

struct Family {
  const char* name;
  sim::ScpiFamily family;
  std::array<int, 3> channels;
};

class ScpiVoltmeterOverFirmwareTest : public ::testing::TestWithParam<Family> {};

INSTANTIATE_TEST_SUITE_P(
    Families, ScpiVoltmeterOverFirmwareTest,
    ::testing::Values(Family{"34970A", sim::ScpiFamily::kKeysight34970a, {103, 101, 102}},
                      Family{"34465A", sim::ScpiFamily::kKeysight34401a, {1, 2, 3}},
                      Family{"2700", sim::ScpiFamily::kKeithley2700, {101, 102, 103}},
                      Family{"2001", sim::ScpiFamily::kKeithley2700, {1, 2, 3}}),
    [](const auto& test) { return std::string(test.param.name); });

TEST_P(ScpiVoltmeterOverFirmwareTest, MeasuresTheTruthWithinItsNoise) {
  constexpr double kNoise = 0.01;
  constexpr int kReadings = 400;
  AccelerometerSettings settings = settings_at(kRateHz);
  settings.scale = {1.0, -2.0, 0.5};
  settings.bias = {0.5, 0.0, 0.125};
  settings.unit = "g";
  SimulatedBench bench(GetParam().family, GetParam().channels, kNoise, settings);
  EXPECT_EQ(bench.accelerometer->identify().model, GetParam().name);
  bench.accelerometer->start();
  bench.world->move(StageAxis::kX, Angle::degrees(180), bench.clock.now());
  bench.clock.sleep_until(bench.world->motion_end(StageAxis::kX, bench.clock.now()));
  const Eigen::Array3d scale(settings.scale[0], settings.scale[1], settings.scale[2]);
  const Eigen::Array3d bias(settings.bias[0], settings.bias[1], settings.bias[2]);
  const Eigen::Array3d truth = (Eigen::Array3d(0.5, -0.25, 0.125 - 3.0) - bias) / scale;
  const Eigen::Array3d noise = kNoise / scale.abs();

  Eigen::Array3d sum = Eigen::Array3d::Zero();
  Eigen::Array3d squares = Eigen::Array3d::Zero();
  const Clock::Instant begin = bench.clock.now();
  for (int n = 0; n < kReadings; ++n) {
    const auto reading = bench.accelerometer->next(bench.clock.now() + 1s);
    ASSERT_TRUE(reading);
    EXPECT_EQ(reading->sequence, static_cast<std::uint64_t>(n));
    EXPECT_FALSE(reading->over_range);
    const Eigen::Array3d deviation = reading->output.array() - truth;
    sum += deviation;
    squares += deviation.square();
  }
  EXPECT_NEAR(to_seconds(bench.clock.now() - begin), kReadings / kRateHz, 1.5 / kRateHz);
  const Eigen::Array3d error = (sum / kReadings).abs();
  const Eigen::Array3d spread = (squares / kReadings).sqrt();
  for (int i = 0; i < 3; ++i) {
    EXPECT_LT(error(i), 4.0 * noise(i) / std::sqrt(kReadings)) << i;  // 4 standard deviations of the mean
    EXPECT_NEAR(spread(i) / noise(i), 1.0, 4.0 / std::sqrt(2.0 * kReadings)) << i;  // and of the spread
  }
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
  bench.accelerometer->stop();
}

TEST_P(ScpiVoltmeterOverFirmwareTest, SaysOverload) {
  AccelerometerSettings settings = settings_at(kRateHz);
  settings.range_v = 1.0;
  SimulatedBench bench(GetParam().family, GetParam().channels, 0.0, settings);
  bench.accelerometer->start();
  const auto reading = bench.accelerometer->next(bench.clock.now() + 1s);
  ASSERT_TRUE(reading);
  EXPECT_TRUE(reading->over_range);
  EXPECT_EQ(reading->output, Eigen::Vector3d(0.5, -0.25, 1.0)) << "w is at 3.125 V";
}

TEST_P(ScpiVoltmeterOverFirmwareTest, RefusesARateThatItCannotKeep) {
  SimulatedBench bench(GetParam().family, GetParam().channels, 0.0, settings_at(45.0));
  error_of([&] { bench.accelerometer->start(); }, Fault::kRefused);
}

TEST_P(ScpiVoltmeterOverFirmwareTest, SurvivesAWorldThatFallsSilent) {
  SimulatedBench bench(GetParam().family, GetParam().channels);
  bench.accelerometer->start();
  ASSERT_TRUE(bench.accelerometer->next(bench.clock.now() + 1s));
  const Clock::Instant silent = bench.clock.now();
  bench.world->inject({.kind = sim::FaultKind::kNoOutput, .at = silent, .until = silent + 60s});
  error_of([&] { bench.accelerometer->next(silent + 1h); }, Fault::kNoReply);
  EXPECT_LT(bench.clock.now(), silent + 60s);
  // The stage turns, the voltmeter wakes: a reading of before the turn would be 1, 2, 3 V apart.
  bench.world->move(StageAxis::kX, Angle::degrees(180), bench.clock.now());
  std::optional<Reading> reading;
  while (!reading) {
    try {
      reading = bench.accelerometer->next(bench.clock.now() + 1h);
    } catch (const InstrumentError& error) {
      ASSERT_EQ(error.fault(), Fault::kNoReply) << error.what();
      ASSERT_LT(bench.clock.now(), silent + 120s);
    }
  }
  EXPECT_NEAR(reading->output(2), 0.125 - 3.0, 1e-8) << "the voltmeter's last digit";
}

TEST_P(ScpiVoltmeterOverFirmwareTest, StartsAgainAfterStoppingInTheMiddleOfAScan) {
  SimulatedBench bench(GetParam().family, GetParam().channels);
  for (int i = 0; i < 3; ++i) {
    bench.accelerometer->start();
    EXPECT_TRUE(bench.accelerometer->next(bench.clock.now() + 1s));
    bench.clock.sleep_until(bench.clock.now() + kPeriod);
    EXPECT_FALSE(bench.accelerometer->next(bench.clock.now() + 5ms));
    bench.accelerometer->stop();
  }
}

/// The firmware behind the kernel's device file.
class FirmwareDevice final : public wire::UsbtmcDevice {
 public:
  FirmwareDevice(std::shared_ptr<sim::Firmware> firmware, Clock& clock)
      : firmware_(std::move(firmware)), clock_(clock) {}
  long write(std::string_view message) override {
    firmware_->receive(message, clock_.now());
    return static_cast<long>(message.size());
  }
  long read(char* buffer, std::size_t size) override {
    const std::size_t count = output_.copy(buffer, size);
    output_.erase(0, count);
    return count > 0 ? static_cast<long>(count) : -ETIMEDOUT;
  }
  int status_byte() override {
    output_ += firmware_->transmit(clock_.now());
    return output_.empty() ? 0 : 0x10;
  }

 private:
  std::shared_ptr<sim::Firmware> firmware_;
  Clock& clock_;
  std::string output_;
};

TEST(ScpiVoltmeterOverUsbtmcTest, MeasuresTheTruth) {
  sim::SimClock clock;
  const auto world = std::make_shared<sim::SimBench>(truth_in_volts(0.0), clock.now());
  const auto firmware = std::make_shared<sim::ScpiVoltmeterFirmware>(world);
  ScpiScanningVoltmeter accelerometer(
      std::make_unique<wire::UsbtmcStream>(std::make_unique<FirmwareDevice>(firmware, clock), "/dev/usbtmc0",
                                           clock),
      clock, settings_at(kRateHz));
  accelerometer.start();
  for (int i = 0; i < 10; ++i) {
    const auto reading = accelerometer.next(clock.now() + 1s);
    ASSERT_TRUE(reading);
    EXPECT_EQ(reading->output, Eigen::Vector3d(0.5, -0.25, 3.125));
  }
  accelerometer.stop();
}

}  // namespace
}  // namespace abcal
