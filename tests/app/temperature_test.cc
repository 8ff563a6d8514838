// Series over temperature: a complete one, errors in a bench file, chambers that fail, and programs that die.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

#include "app/bench_file/bench_config.h"
#include "app/measure/session/temperature_series.h"
#include "app/system/real_clock.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/open_stream.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_label.h"
#include "tests/app/program_fixtures.h"
#include "tests/app/temperature_text.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::Program;
using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

class TemperatureTest : public ProgramTest {
 protected:
  ProgramResult series(const SeriesText& text, const std::vector<std::string>& more = {"--json"}) {
    test::write_file(folder / "bench.toml", text.text());
    std::vector<std::string> arguments{"temperature", "bench.toml"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return abcal(arguments);
  }
  std::size_t run_files() const {
    std::size_t count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      count += entry.path().extension() == ".run" ? 1 : 0;
    return count;
  }
};

/// Differences from the truth in standard uncertainties: s_u, s_v, s_w and O_u, O_v, O_w, each its slope.
std::vector<double> slope_errors(const Json& json) {
  constexpr std::array<double, 9> kTruth{-100.0, 50.0, 20.0, 0.0, 0.0, 0.0, 30.0, -50.0, 10.0};
  std::vector<double> errors;
  for (std::size_t k = 0; k < 9; ++k) {
    const Json& each = json["coefficients"][k];
    const double u = each["standard_uncertainty"];
    if (u > 0.0) errors.push_back((each["at_reference"].get<double>() - kTruth[k]) / u);
  }
  return errors;
}

TEST_F(TemperatureTest, ASeriesUpAndDownFindsTheCoefficients) {
  const ProgramResult result = series({});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Json json = Json::parse(result.out);
  ASSERT_EQ(json["points"].size(), 7U) << "reference, 3 up, 2 down, reference";
  EXPECT_EQ(json["points"][1]["leg"], "up");
  EXPECT_EQ(json["points"][5]["leg"], "down");
  EXPECT_NEAR(json["points"][1]["temperature_degc"].get<double>(), -37.0, 0.5) << "with its self-heating";
  for (const double error : slope_errors(json)) EXPECT_LT(std::abs(error), 4.5);
  EXPECT_EQ(json["verdict"], "usable") << json["why"];
  EXPECT_EQ(json["stage"].size(), 5U) << "each run found the stage by itself";
  EXPECT_NEAR(json["coefficients"][0]["at_reference"].get<double>(), -100.0, 2.0);
  EXPECT_THAT(result.err, AllOf(HasSubstr("set points -70 to 180 degC by its own hardware"),
                                HasSubstr("Point 7 of 7"), HasSubstr("The chamber is driven to 23 degC")));
  std::vector<std::string> points{"export"};
  for (int n = 1; n <= 7; ++n) points.push_back(fmt::format("bench-temperature-{:02}.run", n));
  const auto exported = [&](const std::vector<std::string>& options) {
    std::vector<std::string> arguments = points;
    arguments.insert(arguments.end(), options.begin(), options.end());
    return abcal(arguments);
  };
  const ProgramResult constants = exported({"--as", "json"});
  ASSERT_EQ(constants.exit_code, 0) << constants.err;
  EXPECT_EQ(Json::parse(constants.out)["outputs"][0]["coefficients"], json["polynomials"][0]["coefficients"]);
  EXPECT_EQ(Json::parse(constants.out)["T0_degc"], 23.0);
  const ProgramResult px4 = exported({"--as", "px4"});
  EXPECT_EQ(px4.exit_code, 2);
  EXPECT_THAT(px4.err, HasSubstr("7 files, the points of a series over temperature"));
  EXPECT_EQ(exported({"--as", "csv", "--frame", "platter"}).exit_code, 2);

  // Repeated: nothing is measured, and the output is the same.
  const ProgramResult again = series({});
  EXPECT_EQ(again.exit_code, 0);
  EXPECT_EQ(again.out, result.out);
  EXPECT_THAT(again.err, Not(HasSubstr("Point")));
}

TEST_F(TemperatureTest, EveryItemOfASeriesHasItsCoefficients) {
  SeriesText one;
  one.temperature = "set_points_degc = [23, 60]\nsoak_min_s = 600\nsoak_max_s = 14400\n";
  std::string text = one.text();
  const std::string item = "[item]\nsensitivity_tolerance = 0.1\n",
                    accelerometer = "[accelerometer]\ndriver = \"simulated\"\nresponse_unit = \"g\"\n";
  for (const std::string& section : {item, accelerometer}) {
    ASSERT_NE(text.find(section), std::string::npos);
    text.erase(text.find(section), section.size());
  }
  for (int k = 1; k <= 2; ++k)
    text += fmt::format("[[item]]\nserial_number = \"{}\"\nsensitivity_tolerance = 0.1\n[item.{}", k,
                        accelerometer.substr(1));
  test::write_file(folder / "bench.toml", text);
  const ProgramResult all = abcal({"temperature", "bench.toml", "--json"});
  ASSERT_EQ(all.exit_code, 0) << all.err;
  const Json json = Json::parse(all.out);
  ASSERT_EQ(json["items"].size(), 2U);
  EXPECT_NE(json["items"][0]["coefficients"], json["items"][1]["coefficients"]);
  const ProgramResult second = abcal({"temperature", "bench.toml", "--json", "--item", "2"});
  EXPECT_EQ(Json::parse(second.out), json["items"][1]);
  EXPECT_EQ(abcal({"temperature", "bench.toml", "--item", "3"}).exit_code, 2);
  EXPECT_THAT(abcal({"temperature", "bench.toml", "--html", "a.html"}).err,
              HasSubstr("required: --item 1 to 2, whose page is written"));
  std::vector<std::string> points{"export"};
  for (std::size_t n = 1; n <= json["items"][0]["points"].size(); ++n)
    points.push_back(fmt::format("bench-temperature-{:02}.run", n));
  points.insert(points.end(), {"--as", "json", "--item"});
  points.emplace_back("2");
  const ProgramResult exported = abcal(points);
  ASSERT_EQ(exported.exit_code, 0) << exported.err;
  EXPECT_EQ(Json::parse(exported.out)["outputs"][0]["coefficients"],
            json["items"][1]["polynomials"][0]["coefficients"]);
}

TEST_F(TemperatureTest, AStageThatTurnsWarmMakesTheSeriesDoubtful) {
  SeriesText text;
  text.world = "zx_per_degc = 3e-6\n";
  const ProgramResult result = series(text);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Json json = Json::parse(result.out);
  ASSERT_EQ(json["stage"].size(), 5U);
  EXPECT_EQ(json["stage"][0]["name"], "Zx");
  EXPECT_NEAR(json["stage"][0]["slope"].get<double>(), 3e-6, 1e-6);
  EXPECT_FALSE(json["stage"][0]["constant"].get<bool>());
  EXPECT_EQ(json["verdict"], "doubtful");
  EXPECT_THAT(json["why"][0].get<std::string>(), HasSubstr("the stage changes with temperature: Zx"));
}

TEST_F(TemperatureTest, EveryProblemOfTheFileIsSaidAtOnceWithItsLine) {
  SeriesText text;
  text.chamber = "driver = \"watlow_f4\"\nport = \"simulated\"\nmax_degc = 80\n";
  text.temperature =
      "set_points_degc = [-40, 23, 23, 85]\nramp_k_per_min = 1.0\nsoak_rate_k_per_min = 0\nsoak_max_s = "
      "3600\n"
      "item_min_degc = -20\n";
  const ProgramResult result = series(text);
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(
      result.err,
      AllOf(HasSubstr("line 15, [temperature] set_points_degc: found -40, 23, 23, 85; required: each once"),
            HasSubstr("soak_rate_k_per_min"), HasSubstr("would never end"), HasSubstr("soak_max_s")));
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(TemperatureTest, SetPointsOutsideTheChamberEndBeforeAnythingHeats) {
  SeriesText text;
  text.temperature = "set_points_degc = [23, 190]\nramp_k_per_min = 5.0\n";
  const ProgramResult result = series(text);
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("190"), HasSubstr("-70 to 180 degC, the limits of the hardware")));
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(TemperatureTest, AChamberInFahrenheitIsRefused) {
  SeriesText text;
  text.more = "[emulator]\nchamber_in_fahrenheit = true\n";
  const ProgramResult result = series(text);
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_THAT(result.err, AllOf(HasSubstr("its unit is degF"), HasSubstr("required: degC")));
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(TemperatureTest, ThePlannerFindsThePlanOfEachPoint) {
  SeriesText text;
  text.temperature = "set_points_degc = [23, 50]\ndown = false\nramp_k_per_min = 5.0\nsoak_min_s = 1200\n";
  const ProgramResult result = series(text, {"--reach", "s=2e-5", "--noise", "1e-4", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.err, HasSubstr("Plan of each point, found for reach s=2e-5, noise 1e-4: 3 x "));
  const auto protocol = [](const StoredRun& run) {
    return parse_bench(run.header.bench_toml, "run").protocol;
  };
  const auto paths = series_paths(folder / "bench-temperature", 4);
  const ProtocolConfig first = protocol(RunFile::load(paths[0]));
  EXPECT_GE(first.steps, 12) << "the bench file has 8";
  for (const auto& path : paths) {
    const StoredRun run = RunFile::load(path);
    EXPECT_EQ(run.header.labels.at(kPlanLabel), "reach s=2e-5, noise 1e-4");
    EXPECT_EQ(protocol(run).steps, first.steps);
    EXPECT_EQ(protocol(run).dwell_readings, first.dwell_readings);
  }
  // The plan that was found reaches the uncertainty.
  const Json point = Json::parse(result.out)["points"][0];
  const double u = std::hypot(point["own_standard_uncertainty"][0].get<double>(),
                              point["shared_standard_uncertainty"][0].get<double>());
  EXPECT_LT(u, 1.3 * 2e-5);
  EXPECT_GT(u, 0.3 * 2e-5);

  // It goes on with the plan that it has; another one would be another series.
  for (const char* suffix : {"", ".results"}) std::filesystem::remove(paths[3].string() + suffix);
  const ProgramResult on = series(text);
  ASSERT_EQ(on.exit_code, 0) << on.err;
  EXPECT_EQ(protocol(RunFile::load(paths[3])).steps, first.steps);
  const ProgramResult other = series(text, {"--reach", "s=1e-5", "--noise", "1e-4"});
  EXPECT_EQ(other.exit_code, 2);
  EXPECT_THAT(other.err, AllOf(HasSubstr("found for: reach s=2e-5, noise 1e-4"), HasSubstr("-o")));
}

TEST_F(TemperatureTest, APlanOutOfReachEndsBeforeAnythingHeats) {
  const ProgramResult result = series({}, {"--reach", "s=1e-12", "--noise", "1e-4"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("out of reach: s: 1e-12 is wanted"), Not(HasSubstr("Chamber"))));
  EXPECT_EQ(run_files(), 0U);
}

/// A series over the emulator, in real time, that is killed in the middle of a motion.
class KilledSeriesTest : public TemperatureTest {
 protected:
  static constexpr double kSet = 26.0;

  struct Chamber {
    std::string driver, model, port;
  };

  static std::string bench_text(const Chamber& chamber, const std::string& end) {
    BenchText text;
    text.stage_port = "links/stage";
    text.accelerometer_port = "links/accelerometer";
    text.motion = "speed_deg_per_s = 30.0\nacceleration_deg_per_s2 = 200.0\n";
    return text.text() +
           fmt::format(
               "[chamber]\ndriver = \"{}\"\nmodel = \"{}\"\nport = \"{}\"\npause_output = 2\ndry_gas = true\n"
               "[temperature]\nset_points_degc = [{:g}, 30]\nreference_degc = {:g}\nramp_k_per_min = "
               "0\nair_window_k = 20\nsoak_min_s = 0\nsoak_span_s = 2\nsoak_rate_k_per_min = 100\nend = "
               "\"{}\"\n",
               chamber.driver, chamber.model, chamber.port, kSet, kSet, end);
  }

  /// Text after `begin` in the emulator's output, up to the end of the line.
  std::string told(const std::string& begin) const {
    const std::string out = emulator_->out();
    const std::size_t at = out.find(begin);
    EXPECT_NE(at, std::string::npos) << out << emulator_->err();
    if (at == std::string::npos) return "";
    return out.substr(at + begin.size(), out.find('\n', at) - at - begin.size());
  }

  void start(Chamber chamber, const std::string& end) {
    test::write_file(folder / "emulated.toml", bench_text(chamber, end));
    emulator_ = std::make_unique<Program>(
        std::vector<std::string>{"emulate", "emulated.toml", "--link-dir", "links", "--control", "0"},
        folder.path());
    ASSERT_TRUE(test::wait_for([&] { return emulator_->out().find("Serving") != std::string::npos; }, 20s))
        << emulator_->err();
    const std::string tcp = "tcp:127.0.0.1:";
    if (chamber.port.starts_with(tcp))
      chamber.port = tcp + told(fmt::format("chamber: {} on {}", chamber.driver, tcp));
    test::write_file(folder / "bench.toml", bench_text(chamber, end));
    control_ = wire::open_stream(tcp + told("control: tcp:127.0.0.1:"), {}, clock_);
  }

  Json status() {
    control_->write("{\"do\": \"status\"}\n");
    std::string line;
    while (!line.ends_with('\n')) {
      const std::string more = control_->read_until(clock_.now() + 10s).bytes;
      if (more.empty()) throw std::runtime_error("the emulator does not answer");
      line += more;
    }
    return Json::parse(line);
  }

  static bool stage_moves(const Json& status) {
    return status["x"]["moving"].get<bool>() || status["z"]["moving"].get<bool>();
  }

  /// Kills a series while the stage moves and the chamber has its set point, and waits for the guard.
  std::string kill_one() {
    Program series({"temperature", "bench.toml"}, folder.path());
    const bool moves = test::wait_for(
        [&] {
          const Json now = status();
          return (stage_moves(now) && now.contains("chamber") &&
                  std::filesystem::exists(series_paths(folder / "bench-temperature", 1)[0])) ||
                 !series.running();
        },
        60s);
    EXPECT_TRUE(moves && series.running()) << series.err();
    const double before = status()["chamber"]["target_degc"];
    EXPECT_NEAR(before, kSet, 1e-3);
    series.signal(SIGKILL);
    EXPECT_EQ(series.wait(), 128 + SIGKILL);
    const auto said = [&] {
      const std::string err = series.err();
      return err.find("chamber: ") != std::string::npos && err.find("stage: ") != std::string::npos;
    };
    EXPECT_TRUE(test::wait_for(said, 30s)) << series.err();
    return series.err();
  }

  RealClock clock_;
  std::unique_ptr<Program> emulator_;
  std::unique_ptr<wire::ByteStream> control_;
};

TEST_F(KilledSeriesTest, LeavesTheChamberAsThePolicySaysAndTheStageHalted) {
  const std::vector<std::pair<Chamber, std::string>> cases{
      {{"watlow_f4", "F4T", "tcp:127.0.0.1:0"}, "ambient"},
      {{"watlow_f4", "F4", "links/chamber"}, "off"},
      {{"weiss_simserv", "simserv", "tcp:127.0.0.1:0"}, "ambient"},
      {{"watlow_f4", "F4T", "links/chamber"}, "hold"}};
  for (const auto& [chamber, end] : cases) {
    SCOPED_TRACE(fmt::format("{} {} on {}, {}", chamber.driver, chamber.model, chamber.port, end));
    start(chamber, end);
    if (HasFatalFailure()) return;
    const std::string words = kill_one();
    EXPECT_THAT(words, AllOf(HasSubstr("axis X: halted; axis Z: halted"),
                             HasSubstr(end == "hold" ? "chamber: holds its last set point"
                                                     : "chamber: is driven to 23 degC")));
    const Json after = status();
    EXPECT_FALSE(stage_moves(after));
    EXPECT_NEAR(after["chamber"]["target_degc"].get<double>(), end == "hold" ? kSet : 23.0, 1e-3);
    EXPECT_TRUE(after["chamber"]["running"].get<bool>());
    EXPECT_FALSE(after["chamber"]["paused"].get<bool>());
    emulator_.reset();
    for (const char* name : {"bench-temperature-01.run", "bench-temperature-01.run-wal",
                             "bench-temperature-01.run-shm", "bench-temperature-01.run.results"})
      std::filesystem::remove(folder / name);
  }
}

using LongTemperatureTest = TemperatureTest;

TEST_F(LongTemperatureTest, ProgramsThatDieGoOn) {
  const SeriesText text;
  const auto begin = std::chrono::steady_clock::now();
  const ProgramResult whole = series(text, {"-o", "whole", "--json"});
  ASSERT_EQ(whole.exit_code, 0) << whole.err;
  const auto duration = std::chrono::steady_clock::now() - begin;
  std::mt19937_64 random(20261122);
  std::uniform_real_distribution<double> moment(0.0, 1.0);
  int killed = 0;
  for (int attempt = 0; killed < 20; ++attempt) {
    ASSERT_LT(attempt, 200);
    const std::string name = fmt::format("a{}", attempt);
    {
      Program program({"temperature", "bench.toml", "-o", name, "--json"}, folder.path());
      const auto wait = std::chrono::duration_cast<std::chrono::milliseconds>(duration * moment(random));
      test::wait_for([&] { return !program.running(); }, wait);
      program.signal(SIGKILL);
      if (program.wait() != 128 + SIGKILL) continue;
    }
    ++killed;
    const ProgramResult resumed = abcal({"temperature", "bench.toml", "-o", name, "--json"});
    ASSERT_EQ(resumed.exit_code, 0) << resumed.err;
    const Json json = Json::parse(resumed.out);
    EXPECT_EQ(json["points"].size(), 7U);
    for (const double error : slope_errors(json)) EXPECT_LT(std::abs(error), 4.5) << name;
    for (const auto& path : series_paths(folder / name, 7))
      EXPECT_EQ(abcal({"verify", path.filename().string()}).exit_code, 0) << path;
  }
  fmt::print("{} killed series went on\n", killed);
}

}  // namespace
}  // namespace abcal
