// A whole calibration through every stage driver with every accelerometer driver, against their simulated
// counterparts: all pairs in simulated time, and each driver once over pseudo-terminals or TCP in real time.

#include <gmock/gmock.h>

#include <string>
#include <tuple>

#include "tests/app/instrument_cases.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::HasSubstr;

class InstrumentPairs : public ProgramTest,
                        public testing::WithParamInterface<std::tuple<StageCase, AccelerometerCase>> {};

TEST_P(InstrumentPairs, CalibrateToWithinFourStandardUncertainties) {
  const auto& [stage, accelerometer] = GetParam();
  test::write_file(folder / "bench.toml",
                   bench_text(stage, accelerometer, "simulated", "simulated", "simulated", "simulated"));
  const ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err << run.out;
  const ProgramResult truth = abcal({"analyse", "a.run", "--estimator", "abc", "--truth", "bench.toml"});
  EXPECT_EQ(truth.exit_code, 0) << truth.out;
  EXPECT_THAT(truth.out, HasSubstr("agrees"));
}

INSTANTIATE_TEST_SUITE_P(All, InstrumentPairs,
                         testing::Combine(testing::ValuesIn(stages()), testing::ValuesIn(accelerometers())),
                         [](const auto& pair) {
                           return std::get<0>(pair.param).name + "_with_" + std::get<1>(pair.param).name;
                         });

INSTANTIATE_TEST_SUITE_P(EachDescription, InstrumentPairs,
                         testing::Combine(testing::ValuesIn(described_stages()),
                                          testing::Values(accelerometers().front())),
                         [](const auto& pair) { return std::get<0>(pair.param).name; });

/// The same bench, with its circles swept at 60 degrees/s up and 20 down.
std::string at_constant_rate(std::string bench) {
  bench = replaced(bench, "steps = 12\nstep_deg = 30.0\nsettle_s = 0.05\n",
                   "motion = \"constant_rate\"\nsteps = 36\nstep_deg = 10.0\nsettle_s = \"auto\"\n");
  return bench;
}

class ConstantRate : public ProgramTest, public testing::WithParamInterface<StageCase> {};

TEST_P(ConstantRate, CalibratesToWithinFourStandardUncertainties) {
  for (const AccelerometerCase& accelerometer : accelerometers()) {
    if (accelerometer.name != "microstrain_mip") continue;
    test::write_file(folder / "bench.toml",
                     at_constant_rate(bench_text(GetParam(), accelerometer, "simulated", "simulated",
                                                 "simulated", "simulated")));
    const ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run"});
    ASSERT_EQ(run.exit_code, 0) << run.err << run.out;
    const ProgramResult truth = abcal({"analyse", "a.run", "--truth", "bench.toml"});
    EXPECT_EQ(truth.exit_code, 0) << truth.out;
    EXPECT_THAT(truth.out, HasSubstr("agrees"));
  }
}

INSTANTIATE_TEST_SUITE_P(EachStage, ConstantRate, testing::ValuesIn(stages()),
                         [](const auto& stage) { return stage.param.name; });

struct Wired {
  std::string stage, accelerometer;
  bool tcp = false;
};

void PrintTo(const Wired& wired, std::ostream* out) {
  *out << wired.stage << " with " << wired.accelerometer << (wired.tcp ? " (TCP)" : " (terminal)");
}

/// Every driver over a real byte stream, with the emulator in a process of its own.
class WiredInstruments : public ProgramTest, public testing::WithParamInterface<Wired> {
 protected:
  static const auto& named(const auto& all, const std::string& name) {
    for (const auto& one : all)
      if (one.name == name) return one;
    throw std::invalid_argument(name);
  }
};

TEST_P(WiredInstruments, CalibrateToWithinFourStandardUncertainties) {
  const StageCase& stage = named(stages(), GetParam().stage);
  const AccelerometerCase& accelerometer = named(accelerometers(), GetParam().accelerometer);
  // Served on a free port that is not known before: two bench files, for the emulator and for the run.
  const std::string any = GetParam().tcp ? "tcp:127.0.0.1:0" : "links/none";
  test::write_file(folder / "emulated.toml",
                   bench_text(stage, accelerometer, any, any, GetParam().tcp ? any : "links/another", any));
  test::Program emulator({"emulate", "emulated.toml", "--link-dir", "links"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return emulator.out().find("Serving") != std::string::npos; },
                             std::chrono::seconds(20)))
      << emulator.err();
  const auto address = [&](const std::string& instrument) {
    const std::string out = emulator.out();
    const std::string key = "\n" + instrument + ": ";
    const std::size_t at = ("\n" + out).find(key);
    if (at == std::string::npos) return std::string("none");
    const std::size_t on = out.find(" on ", at) + 4;
    return out.substr(on, out.find('\n', on) - on);
  };
  test::write_file(folder / "bench.toml",
                   bench_text(stage, accelerometer, address("stage"), address("stage-x"), address("stage-z"),
                              address("accelerometer")));
  const ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err << run.out;
  const ProgramResult truth = abcal({"analyse", "a.run", "--estimator", "abc", "--truth", "bench.toml"});
  EXPECT_EQ(truth.exit_code, 0) << truth.out;
  EXPECT_THAT(truth.out, HasSubstr("agrees"));
}

INSTANTIATE_TEST_SUITE_P(
    EachDriver, WiredInstruments,
    testing::Values(Wired{"pi_gcs", "vectornav", true}, Wired{"newport_esp", "xsens_mti"},
                    Wired{"zaber_ascii", "scpi_voltmeter", true}, Wired{"two_controllers", "witmotion"},
                    Wired{"pi_gcs", "text_line"}, Wired{"newport_esp", "microstrain_mip"},
                    Wired{"zaber_chain", "microstrain_mip"}, Wired{"pi_chain", "mavlink", true}),
    [](const auto& pair) {
      return pair.param.stage + "_with_" + pair.param.accelerometer + (pair.param.tcp ? "_tcp" : "_terminal");
    });

}  // namespace
}  // namespace abcal
