// A whole calibration through every stage driver with every accelerometer driver, against their simulated
// counterparts: all pairs in simulated time, and each driver once over pseudo-terminals or TCP in real time.

#include <gmock/gmock.h>

#include <string>
#include <tuple>

#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::HasSubstr;

struct StageCase {
  std::string name;
  std::string sections;  ///< [stage] and its axes but for the ports, which read PORT, PORTX, PORTZ.
};

struct AccelerometerCase {
  std::string name;
  std::string section;  ///< [accelerometer] but for its port.
  double scale = 1.0;   ///< Response unit per g_loc.
  double noise = 1e-4;  ///< Of one reading, in g_loc.
};

// The names of the tests carry the parameters: as words, not as bytes.
void PrintTo(const StageCase& stage, std::ostream* out) {
  *out << stage.name;
}
void PrintTo(const AccelerometerCase& accelerometer, std::ostream* out) {
  *out << accelerometer.name;
}

const std::vector<StageCase>& stages() {
  static const std::vector<StageCase> all{
      {"pi_gcs", "[stage]\ndriver = \"pi_gcs\"\nport = \"PORT\"\n"},
      {"newport_esp", "[stage]\ndriver = \"newport_esp\"\nport = \"PORT\"\n"},
      {"zaber_ascii", "[stage]\ndriver = \"zaber_ascii\"\nport = \"PORT\"\n"},
      {"two_controllers",
       "[stage.x]\ndriver = \"newport_esp\"\nport = \"PORTX\"\naxis = \"1\"\n"
       "[stage.z]\ndriver = \"pi_gcs\"\nport = \"PORTZ\"\naxis = \"1\"\n"},
  };
  return all;
}

const std::vector<AccelerometerCase>& accelerometers() {
  static const std::vector<AccelerometerCase> all{
      {"microstrain_mip", "driver = \"microstrain_mip\"\nrate_hz = 200.0\n"},
      {"vectornav", "driver = \"vectornav\"\nrate_hz = 200.0\n", 9.81},
      {"xsens_mti", "driver = \"xsens_mti\"\nrate_hz = 100.0\n", 9.81},
      {"scpi_voltmeter", "driver = \"scpi_voltmeter\"\nrate_hz = 20.0\nintegration_plc = 0.02\n"},
      {"scpi_single", "driver = \"scpi_single\"\nrate_hz = 20.0\nintegration_plc = 0.02\n"},
      // 16 g over 32768 counts: the noise must be a few counts, or averaging does not resolve them.
      {"witmotion", "driver = \"witmotion\"\nrate_hz = 100.0\nbaud = 115200\n", 1.0, 2e-3},
      {"text_line", "driver = \"text_line\"\nrate_hz = 100.0\n"},
  };
  return all;
}

std::string replaced(std::string text, const std::string& what, const std::string& with) {
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + with.size()))
    text.replace(at, what.size(), with);
  return text;
}

std::string bench_text(const StageCase& stage, const AccelerometerCase& accelerometer,
                       const std::string& stage_port, const std::string& stage_x_port,
                       const std::string& stage_z_port, const std::string& accelerometer_port) {
  const double k = accelerometer.scale;
  std::string sections = replaced(stage.sections, "PORTX", stage_x_port);
  sections = replaced(sections, "PORTZ", stage_z_port);
  sections = replaced(sections, "PORT", stage_port);
  const auto row = [&](double a, double b, double c) {
    return "[" + std::to_string(k * a) + ", " + std::to_string(k * b) + ", " + std::to_string(k * c) + "]";
  };
  return "[bench]\ng_loc_mps2 = 9.81\n" + sections + "[accelerometer]\nport = \"" + accelerometer_port +
         "\"\n" + accelerometer.section +
         "[protocol]\nsteps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = 10\n[simulation]\nseed "
         "= "
         "3\nsensitivity_matrix = [" +
         row(1.01, 0.02, -0.01) + ", " + row(-0.03, 0.98, 0.02) + ", " + row(0.01, -0.02, 1.0) +
         "]\noffset = " + row(0.01, -0.02, 0.03) + "\nnoise = " + std::to_string(k * accelerometer.noise) +
         "\nzx = 5e-5\nzy = -1e-4\nxz = 1e-4\n"
         "[simulation.x]\nspeed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\nstep_error_deg = "
         "0.005\n"
         "[simulation.z]\nspeed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\nstep_error_deg = "
         "0.005\n";
}

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
  test::write_file(folder / "emulated.toml", bench_text(stage, accelerometer, any, any, any, any));
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
                    Wired{"pi_gcs", "text_line"}, Wired{"newport_esp", "microstrain_mip"}),
    [](const auto& pair) {
      return pair.param.stage + "_with_" + pair.param.accelerometer + (pair.param.tcp ? "_tcp" : "_terminal");
    });

}  // namespace
}  // namespace abcal
