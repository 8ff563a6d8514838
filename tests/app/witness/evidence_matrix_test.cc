// Every way to measure, with a witness: killed and resumed, verified, and certified.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/measure/session/temperature_series.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"
#include "tests/app/certificate/record_fixtures.h"
#include "tests/app/temperature_text.h"
#include "tests/app/witness/witness_fixtures.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::HasSubstr;
using testing::Not;

/// A program that is killed says and stores nothing more: no handler of errors catches it.
struct Killed {};

/// One way to measure: the runs of a certificate, which one program after the other measures.
struct Way {
  const char* name;
  std::vector<std::string> benches;  ///< One for each run "0.run", "1.run", ...
  std::size_t killed_after = 17;     ///< Angles.
  std::vector<std::string> issue{};  ///< Arguments in addition.
  bool is_measurement = false;       ///< The runs are combined.
  bool is_series = false;            ///< Over temperature, of one bench.
};

void PrintTo(const Way& way, std::ostream* stream) {
  *stream << way.name;
}

std::string with_protocol(const std::string& protocol) {
  return replaced(certificate_bench(), "steps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = 10\n",
                  protocol);
}

std::string constant_rate_bench() {
  return replaced(
      with_protocol("motion = \"constant_rate\"\nrate_deg_per_s = [60, 20]\nacceleration_deg_per_s2 = 200.0\n"
                    "steps = 36\nstep_deg = 10.0\nsettle_s = \"auto\"\n"),
      "noise = 1e-4\n", "noise = 1e-4\nlow_pass_hz = 5.0\ngroup_delay_s = 0.02\n");
}

std::string tray_bench() {
  std::string text = replaced(
      certificate_bench(),
      "[item]\nmaker = \"Maker\"\nmodel = \"M-3\"\nserial_number = \"SN-42\"\nrange = \"8 g\"\n", "");
  text =
      replaced(text, "[accelerometer]\ndriver = \"simulated\"\nresponse_unit = \"g\"\nrate_hz = 200.0\n", "");
  for (int k = 1; k <= 2; ++k)
    text += fmt::format(
        "[[item]]\nmaker = \"MicroStrain\"\nmodel = \"3DM-GV7-AR\"\nserial_number = \"SN-{0}\"\n"
        "[item.accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\nrate_hz = 200.0\n"
        "serial_number = \"SN-{0}\"\n",
        k);
  return text;
}

std::string series_bench() {
  return replaced(replaced(SeriesText().text(), "[item]\n",
                           "[item]\nmaker = \"Maker\"\nmodel = \"M-3\"\nserial_number = \"SN-42\"\n"),
                  "g_loc_mps2 = 9.81\n",
                  "name = \"bench 1\"\ng_loc_mps2 = 9.81\ng_loc_expanded_uncertainty_mps2 = 0.00003\n"
                  "g_loc_k = 2.0\ng_loc_source = \"survey of 2025, EX-GRAV-7\"\n") +
         "[operator]\nname = \"Operator N. N.\"\n[environment]\ntemperature_degc = 23.0\n"
         "humidity_percent = 45.0\n";
}

std::vector<Way> ways() {
  return {{.name = "steps", .benches = {certificate_bench()}},
          {.name = "two_faces",
           .benches = {with_protocol("faces = 2\nsteps = 12\nstep_deg = 30.0\nsettle_s = "
                                     "0.05\ndwell_readings = 10\n")}},
          {.name = "constant_rate", .benches = {constant_rate_bench()}, .killed_after = 80},
          {.name = "tray", .benches = {tray_bench()}, .issue = {"--item", "2"}},
          {.name = "mountings",
           .benches = {bench_of("SN-42", kAsIs, 1), bench_of("SN-42", kAboutX, 2)},
           .is_measurement = true},
          {.name = "temperature", .benches = {series_bench()}, .is_series = true}};
}

class EvidenceMatrixTest : public testing::TestWithParam<Way> {
 protected:
  static void SetUpTestSuite() {
    register_folder_ = new test::TemporaryFolder;
    register_ = new test::TrainingRegister(register_folder_->path());
    register_->lab({"key", "bench 1", "-o", "bench.pem"});
    test::TrainingRegister::leave();
  }
  static void TearDownTestSuite() {
    delete register_;
    delete register_folder_;
  }

  void SetUp() override {
    served_ = std::make_unique<ServedWitness>(
        std::make_unique<WitnessLog>(folder / "witness.db", test::read_file(*register_folder_ / "bench.pem"),
                                     [this] {
                                       passed_ += std::chrono::hours(1);
                                       return WitnessMoment{Clock::UtcTime(passed_), "boot", passed_};
                                     }),
        folder / "socket");
  }

  /// @param killed_after  angles after which the program is killed; 0: it is not
  MeasuringSession::Options options(std::size_t killed_after) {
    MeasuringSession::Options options;
    options.open_bench = [](const BenchConfig& config, BenchStreams streams) {
      Bench bench = make_bench(config, std::move(streams));
      bench.simulated_time = false;  // So that its angles are witnessed.
      return bench;
    };
    options.find_witness = [this] {
      return std::make_unique<WitnessClient>(folder / "socket", WitnessClient::Limits{});
    };
    options.listener = [killed_after, told = std::size_t{0}](const SessionEvent& event) mutable {
      if (std::holds_alternative<DwellDoneEvent>(event) && ++told == killed_after) throw Killed();
    };
    options.analyst = make_run_analyst();
    return options;
  }

  /// Measures a run, or a series, in a program that is killed and a second one. @return its files
  std::vector<std::string> measure(std::size_t k) {
    const std::string name = std::to_string(k);
    test::write_file(folder / (name + ".toml"), GetParam().benches[k]);
    const BenchConfig bench = read_bench(folder / (name + ".toml"));
    if (GetParam().is_series) {
      const auto series = [&](std::size_t killed_after) {
        return TemperatureSeries({options(killed_after), {}}).measure({bench, name + ".toml", folder / "t"});
      };
      EXPECT_THROW(series(GetParam().killed_after), Killed);
      std::vector<std::string> names;
      for (const auto& path : series(0)) names.push_back(path.filename().string());
      return names;
    }
    const std::string run = (folder / (name + ".run")).string();
    EXPECT_THROW(MeasuringSession(options(GetParam().killed_after)).start({.bench = bench, .run_file = run}),
                 Killed);
    MeasuringSession(options(0)).resume({.run_file = run});
    return {name + ".run"};
  }

  test::ProgramResult abcal(const std::vector<std::string>& arguments) {
    return test::run_program(arguments, folder.path());
  }
  test::TemporaryFolder folder;
  std::chrono::nanoseconds passed_{0};
  std::unique_ptr<ServedWitness> served_;
  static inline test::TemporaryFolder* register_folder_ = nullptr;
  static inline test::TrainingRegister* register_ = nullptr;
};

TEST_P(EvidenceMatrixTest, IsWitnessedResumedVerifiedAndCertified) {
  const Way& way = GetParam();
  std::string laboratory = example_laboratory();
  if (way.is_series)
    laboratory = replaced(laboratory, "serial_number = \"118001234\"", "serial_number = \"SIM-1\"    ");
  test::write_file(folder / "lab.toml", laboratory);
  std::vector<std::string> runs;
  for (std::size_t k = 0; k < way.benches.size(); ++k)
    for (std::string& run : measure(k)) runs.push_back(std::move(run));

  const test::TrainingRegister registered(*register_, folder.path());
  // Angles here take no time: statements that were under way at the kill are lost with the program, and the
  // approver says so. Nothing else is missing.
  bool lacks_some = false;
  for (const std::string& run : runs) {
    const auto verified = abcal({"verify", run});
    const bool lacks = verified.out.find("not witnessed:") != std::string::npos;
    EXPECT_EQ(verified.exit_code, lacks ? 1 : 0) << run << ":\n" << verified.out << verified.err;
    EXPECT_THAT(verified.out, HasSubstr("angles witnessed by the key of bench 1"));
    EXPECT_EQ(verified.out.find(" bad  "), verified.out.find(" bad  witness required")) << verified.out;
    EXPECT_EQ(verified.out.find(" bad  "), verified.out.rfind(" bad  ")) << verified.out;
    lacks_some = lacks_some || lacks;
  }
  std::vector<std::string> issue{"issue", runs.back(), "--laboratory", "lab.toml", "--dcc", "a.xml"};
  if (way.is_measurement) {
    std::vector<std::string> combine = runs;
    combine.insert(combine.begin(), "combine");
    combine.insert(combine.end(), {"-o", "m.measurement"});
    ASSERT_EQ(abcal(combine).exit_code, 0);
    issue[1] = "m.measurement";
  }
  issue.insert(issue.end(), way.issue.begin(), way.issue.end());
  if (way.is_series) {
    issue.emplace_back("--temperature");
    issue.insert(issue.end(), runs.begin(), runs.end());
  }
  if (lacks_some) issue.insert(issue.end(), {"--not-witnessed", "the program was killed"});
  const auto issued = abcal(issue);
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::string xml = test::read_file(folder / "a.xml");
  if (!lacks_some) {
    EXPECT_THAT(xml, HasSubstr("was signed by the witness with the key of bench 1 when it was measured"));
  } else {
    EXPECT_THAT(xml, HasSubstr("the program was killed"));
    EXPECT_THAT(xml, Not(HasSubstr("was signed by the witness")));
  }
}

INSTANTIATE_TEST_SUITE_P(Each, EvidenceMatrixTest, testing::ValuesIn(ways()),
                         [](const auto& way) { return way.param.name; });

}  // namespace
}  // namespace abcal
