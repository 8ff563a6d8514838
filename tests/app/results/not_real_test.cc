// Runs that count as simulated although their ports look like real ones.
#include "app/bench_file/not_real.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "app/measure/bench/make_bench.h"
#include "tests/app/instrument_cases.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

BenchConfig on_ports(const StageCase& stage, const AccelerometerCase& accelerometer,
                     const std::string& port) {
  const std::string of_item = port == "simulated" ? port : port + "u";
  const std::string three = port == "simulated" ? port : of_item + " " + port + "v " + port + "w";
  return parse_bench(bench_text(stage, accelerometer, port, port, port == "simulated" ? port : port + "z",
                                accelerometer.name == "scpi_single" ? three : of_item),
                     "bench");
}

RunHeader with(const std::string& role, const std::string& serial_number) {
  RunHeader header;
  InstrumentIdentity instrument;
  instrument.role = role;
  instrument.serial_number = serial_number;
  header.instruments.push_back(instrument);
  return header;
}

TEST(NotRealTest, ASerialNumberIsReportedIfEachInstrumentGaveOne) {
  for (const char* reported : {"", " ", " + 13", "12 + ", "12, 0, 14", "0", "12,,14"})
    EXPECT_FALSE(is_serial_number_reported(reported)) << reported;
  for (const char* reported : {"12", "12/13", "12 + 13", "12, 13, 14", "0x2a51", "100"})
    EXPECT_TRUE(is_serial_number_reported(reported)) << reported;
}

TEST(NotRealTest, ABenchFileWithASimulationIsThatOfAnEmulator) {
  const BenchConfig real = read_bench(test::source_folder() / "docs/examples/real.toml");
  EXPECT_THAT(instruments_not_real({}, real), IsEmpty());
  BenchConfig emulated = real;
  emulated.items.front().simulation.noise = 1e-4;
  EXPECT_THAT(instruments_not_real({}, emulated), ElementsAre("stage", "accelerometer"));
  // If a port names the simulated instrument, only that one is simulated.
  emulated = on_ports(stages().front(), accelerometers().front(), "/dev/ttyUSB0");
  emulated.items.front().accelerometer.port = "simulated";
  EXPECT_THAT(instruments_not_real({}, emulated), ElementsAre("accelerometer"));
}

TEST(NotRealTest, SerialNumbersAreReadAsInstrumentsJoinThem) {
  EXPECT_THAT(single_serial_numbers("12"), ElementsAre("12"));
  EXPECT_THAT(single_serial_numbers("12/13"), ElementsAre("12", "13"));
  EXPECT_THAT(single_serial_numbers("12 + 6284.123456"), ElementsAre("12", "6284.123456"));
  EXPECT_THAT(single_serial_numbers("12, 13, 14"), ElementsAre("12", "13", "14"));
  EXPECT_THAT(single_serial_numbers(""), IsEmpty());
}

TEST(NotRealTest, EverySimulatedInstrumentIsKnownByItsSerialNumber) {
  for (const StageCase& stage : stages()) {
    const std::string found =
        make_bench(on_ports(stage, accelerometers().front(), "simulated")).stage->identify().serial_number;
    if (found.empty()) continue;  // Its interface does not tell it.
    BenchConfig real = on_ports(stage, accelerometers().front(), "/dev/ttyUSB0");
    real.simulation = {};
    real.items.front().simulation = {};
    EXPECT_THAT(instruments_not_real(with("stage", found), real), ElementsAre("stage"))
        << stage.name << ": " << found;
    EXPECT_THAT(instruments_not_real(with("stage", "1" + single_serial_numbers(found).front()), real),
                IsEmpty())
        << stage.name;
  }
  for (const AccelerometerCase& accelerometer : accelerometers()) {
    const std::string found = make_bench(on_ports(stages().front(), accelerometer, "simulated"))
                                  .first()
                                  .accelerometer->identify()
                                  .serial_number;
    if (found.empty()) continue;  // These have none.
    BenchConfig real = on_ports(stages().front(), accelerometer, "/dev/ttyUSB0");
    real.simulation = {};
    real.items.front().simulation = {};
    EXPECT_THAT(instruments_not_real(with("accelerometer", found), real), ElementsAre("accelerometer"))
        << accelerometer.name << ": " << found;
  }
}

}  // namespace
}  // namespace abcal
