// Series over temperature: a whole one, what is wrong with a bench file, chambers that fail, and programs
// that die.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

#include "app/session/temperature_series.h"
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
  EXPECT_NEAR(json["coefficients"][0]["at_reference"].get<double>(), -100.0, 2.0);
  EXPECT_THAT(result.err, AllOf(HasSubstr("set points -70 to 180 degC by its own hardware"),
                                HasSubstr("Point 7 of 7"), HasSubstr("The chamber is driven to 23 degC")));
  // Again: nothing is measured, the same is said.
  const ProgramResult again = series({});
  EXPECT_EQ(again.exit_code, 0);
  EXPECT_EQ(again.out, result.out);
  EXPECT_THAT(again.err, Not(HasSubstr("Point")));
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
