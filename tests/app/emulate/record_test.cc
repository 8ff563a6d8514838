// A relay between a host and an instrument, its log, and the comparison of another instrument with the log.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "app/measure/emulator/compare_firmware.h"
#include "app/measure/emulator/relay.h"
#include "app/measure/emulator/wire_log.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/sim_clock.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;

class RecordTest : public testing::Test {
 protected:
  std::shared_ptr<sim::Firmware> stage() {
    return std::make_shared<sim::PiGcsFirmware>(
        std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now()));
  }

  /// A host's questions and what came back, through the relay.
  std::string talk(Relay& relay, const std::vector<std::string>& questions) {
    std::string answers;
    for (const std::string& question : questions) {
      relay.receive(question, clock.now());
      clock.sleep_until(clock.now() + 100ms);
      answers += relay.transmit(clock.now());
    }
    return answers;
  }

  void record(const std::vector<std::string>& questions) {
    WireLogWriter writer(file, "/dev/ttyUSB0", "2026-11-22T10:00:00Z");
    Relay relay(std::make_unique<sim::FirmwareStream>(stage(), clock), writer, clock.now());
    heard = talk(relay, questions);
  }

  test::TemporaryFolder folder;
  std::filesystem::path file = folder / "host.wire";
  sim::SimClock clock;
  std::string heard;
};

TEST_F(RecordTest, EveryByteOfBothIsKeptWithItsTime) {
  record({"CSV?\n", "POS? 1\n"});
  EXPECT_THAT(heard, HasSubstr("2.0\n"));
  const WireLog log = read_wire_log(file);
  EXPECT_EQ(log.port, "/dev/ttyUSB0");
  EXPECT_EQ(log.begun_utc, "2026-11-22T10:00:00Z");
  std::string from_host, from_instrument;
  double last_s = 0.0;
  for (const LoggedBytes& row : log.rows) {
    (row.from == LoggedBytes::From::kHost ? from_host : from_instrument) += row.bytes;
    EXPECT_GE(row.t_s, last_s);
    last_s = row.t_s;
  }
  EXPECT_EQ(from_host, "CSV?\nPOS? 1\n");
  EXPECT_EQ(from_instrument, heard);
}

TEST_F(RecordTest, ALogIsNeverOverwrittenAndHalfALastLineIsLeftOut) {
  record({"CSV?\n"});
  EXPECT_THROW(WireLogWriter(file, "a", "b"), std::runtime_error);
  const std::size_t rows = read_wire_log(file).rows.size();
  std::ofstream(file, std::ios::app) << R"({"t_s": 1.0, "fr)";
  EXPECT_EQ(read_wire_log(file).rows.size(), rows);
  std::ofstream(file, std::ios::app) << "\n";
  try {
    (void)read_wire_log(file);
    FAIL() << "a line that is no JSON was accepted";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("line 4"));
  }
}

TEST_F(RecordTest, BytesThatAreNoHexadecimalDigitsAreNamed) {
  for (const std::string digits : {"4Z", "435"}) {
    std::filesystem::remove(file);
    record({"CSV?\n"});
    std::ofstream(file, std::ios::app) << R"({"t_s": 1.0, "from": "host", "hex": ")" << digits << "\"}\n";
    try {
      (void)read_wire_log(file);
      ADD_FAILURE() << digits << " was accepted";
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), AllOf(HasSubstr("line 4"), HasSubstr("\"hex\" is \"" + digits + "\""),
                                      HasSubstr("two hexadecimal digits")));
    }
  }
}

TEST_F(RecordTest, TheSameInstrumentAnswersTheSame) {
  record({"CSV?\n", "*IDN?\n", "POS? 1\n", "ERR?\n"});
  const auto exchanges = compare_firmware(read_wire_log(file), *stage(), clock.now());
  ASSERT_EQ(exchanges.size(), 4U);
  for (const ComparedExchange& each : exchanges) {
    EXPECT_EQ(each.likeness, Likeness::kEqual) << each.asked;
    EXPECT_FALSE(each.simulated.empty()) << each.asked;
  }
}

TEST_F(RecordTest, OtherAnswersAreFoundAndNamed) {
  WireLog log{"p", "now", {}};
  const auto add = [&](LoggedBytes::From from, double t_s, const std::string& bytes) {
    log.rows.push_back({from, t_s, bytes});
  };
  using enum LoggedBytes::From;
  add(kHost, 0.0, "POS? 1\n");
  add(kInstrument, 0.01, "1=12.5000\n");
  add(kHost, 1.0, "CSV?\n");
  add(kInstrument, 1.01, "version two\n");
  add(kHost, 2.0, "WGO 1\n");  // A wave generator, which is not emulated.
  add(kInstrument, 2.01, "started\n");
  add(kHost, 3.0, "CSV");  // In two pieces.
  add(kHost, 3.001, "?\n");
  const auto exchanges = compare_firmware(log, *stage(), clock.now());
  ASSERT_EQ(exchanges.size(), 4U);
  EXPECT_EQ(exchanges[0].likeness, Likeness::kNumbersDiffer) << exchanges[0].simulated;
  EXPECT_EQ(exchanges[1].likeness, Likeness::kDifferent);
  EXPECT_EQ(exchanges[2].likeness, Likeness::kOnlyReal) << exchanges[2].simulated;
  EXPECT_EQ(exchanges[3].asked, "CSV?\n");
  EXPECT_EQ(exchanges[3].likeness, Likeness::kOnlySimulated);
}

}  // namespace
}  // namespace abcal
