// Series over temperature inside the test: chambers of both makers, and series that are ended by a chamber, a
// door or a person.

#include "app/measure/session/temperature_series.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <random>

#include "app/measure/session/temperature_soak.h"
#include "app/results/analysis/temperature_points.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/run/run_observer.h"
#include "tests/app/temperature_text.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class TemperatureSeriesTest : public testing::Test {
 protected:
  /// Measures, or goes on with, the series NAME-01.run ... @throws as TemperatureSeries
  TemperatureResult measure(const SeriesText& text, const std::string& name = "a") {
    TemperatureSeries::Options options;
    options.session.stop = stop_.get_token();
    options.session.listener = [this](const SessionEvent& event) {
      if (!std::holds_alternative<DwellDoneEvent>(event)) return;
      ++dwells_;
      if (dwells_ == stop_after_) stop_.request_stop();
    };
    options.tell = [this](const std::string& line) { told_ += line + "\n"; };
    const auto paths = TemperatureSeries(std::move(options))
                           .measure({parse_bench(text.text(), "bench.toml"), "bench.toml", folder_ / name});
    return fit_temperature(points_of_series(paths).front(), 23.0, "g");
  }
  InstrumentError failure_of(const SeriesText& text, const std::string& name = "a") {
    try {
      measure(text, name);
    } catch (const InstrumentError& error) {
      return error;
    }
    ADD_FAILURE() << "the series did not end early";
    return {"", Fault::kNoReply, ""};
  }

  test::TemporaryFolder folder_;
  std::stop_source stop_;
  std::string told_;
  int dwells_ = 0, stop_after_ = -1;
};

/// Differences of the slopes from the truth, in standard uncertainties.
std::vector<double> slope_errors(const TemperatureResult& result) {
  constexpr std::array<double, 9> kTruth{-100.0, 50.0, 20.0, 0.0, 0.0, 0.0, 30.0, -50.0, 10.0};
  std::vector<double> errors;
  for (std::size_t k = 0; k < 9; ++k) {
    const TemperatureCoefficient& each = result.coefficients[k];
    if (each.standard_uncertainty > 0.0)
      errors.push_back((each.at_reference - kTruth[k]) / each.standard_uncertainty);
  }
  return errors;
}

TEST_F(TemperatureSeriesTest, UpAndDownAndBackToTheReference) {
  const TemperatureResult result = measure({});
  ASSERT_EQ(result.points.size(), 7U);
  EXPECT_EQ(result.points[1].leg, SeriesLeg::kUp);
  EXPECT_EQ(result.points[5].leg, SeriesLeg::kDown);
  EXPECT_NEAR(result.points[1].temperature_degc, -37.0, 0.5) << "with its self-heating";
  EXPECT_NEAR(result.coefficients[0].at_reference, -100.0, 3.0);
  for (const double error : slope_errors(result)) EXPECT_LT(std::abs(error), 4.5);
  EXPECT_THAT(told_, AllOf(HasSubstr("set points -70 to 180 degC by its own hardware"),
                           HasSubstr("Point 7 of 7"), HasSubstr("The chamber is driven to 23 degC")));
  const StoredRun third = RunFile::load(series_paths(folder_ / "a", 7)[2]);
  EXPECT_EQ(third.header.labels.at(kPointLabel), "3 of 7");
  EXPECT_THAT(third.header.labels.at(kSoakLabel), HasSubstr("soaked for"));
  const auto& instruments = third.header.instruments;
  EXPECT_TRUE(std::any_of(instruments.begin(), instruments.end(),
                          [](const auto& each) { return each.role == "chamber"; }));
}

// The example of the issue: 7 points from -40 to 85 degC, up and down, as a dry run.
TEST_F(TemperatureSeriesTest, SevenPointsUpAndDownTakeLessThanTenSeconds) {
  SeriesText text;
  text.temperature =
      "set_points_degc = [-40, -20, 0, 23, 45, 65, 85]\nramp_k_per_min = 2.0\nsoak_min_s = "
      "1800\nitem_min_degc = "
      "-40\nitem_max_degc = 90\n";
  text.protocol = "steps = 24\nstep_deg = 15.0\nsettle_s = 0.5\ndwell_readings = 100\n";
  const auto begin = std::chrono::steady_clock::now();
  const TemperatureResult result = measure(text);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
  fmt::print("15 points in {:.2f} s\n", took.count());
  EXPECT_EQ(result.points.size(), 15U);
}

TEST_F(TemperatureSeriesTest, WhatTheChamberCannotDoIsSaidBeforeAnythingHeats) {
  SeriesText text;
  text.temperature = "set_points_degc = [23, 190]\nramp_k_per_min = 5.0\n";
  try {
    measure(text);
    FAIL();
  } catch (const BenchError& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("190"), HasSubstr("-70 to 180 degC, the limits of the hardware")));
  }
  EXPECT_FALSE(std::filesystem::exists(series_paths(folder_ / "a", 1)[0]));
}

TEST_F(TemperatureSeriesTest, AChamberInFahrenheitIsRefused) {
  SeriesText text;
  text.more = "[emulator]\nchamber_in_fahrenheit = true\n";
  const InstrumentError error = failure_of(text);
  EXPECT_THAT(error.what(), AllOf(HasSubstr("its unit is degF"), HasSubstr("required: degC")));
}

TEST_F(TemperatureSeriesTest, AnAlarmEndsTheSeries) {
  for (const char* kind : {"chamber-alarm", "chamber-door"}) {
    SeriesText text;
    text.chamber = "driver = \"weiss_simserv\"\nport = \"simulated\"\n";
    text.more = fmt::format("[[fault]]\nkind = \"{}\"\nat_s = 2000\n", kind);
    const InstrumentError error = failure_of(text, kind);
    EXPECT_EQ(error.fault(), Fault::kNotReady);
    EXPECT_THAT(error.what(),
                testing::AnyOf(HasSubstr("alarm: Thermal limiter"), HasSubstr("its door is open")));
  }
}

TEST_F(TemperatureSeriesTest, NothingIsCooledToTheDewPointOfTheChambersAir) {
  const auto bench = [](double coldest, const std::string& chamber) {
    SeriesText text;
    text.chamber += chamber;
    text.temperature = fmt::format(
        "set_points_degc = [{}, 40]\ndown = false\nramp_k_per_min = 5.0\nsoak_min_s = "
        "600\ndew_point_margin_k = "
        "2\n",
        coldest);
    text.more = "dew_point_degc = 5.0\n";
    return text;
  };
  const InstrumentError error = failure_of(bench(6.0, ""), "wet");
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.what(),
              AllOf(HasSubstr("6.0 degC is below the dew point of its air, 5.0 degC with a margin of 2 K"),
                    HasSubstr("required: dry air or nitrogen")));
  EXPECT_THAT(told_, HasSubstr("The chamber is driven to 23 degC"));
  EXPECT_TRUE(std::filesystem::exists(series_paths(folder_ / "wet", 4)[0])) << "the reference is warm";
  EXPECT_FALSE(std::filesystem::exists(series_paths(folder_ / "wet", 4)[1]));
  EXPECT_EQ(measure(bench(6.0, "dry_gas = true\n"), "dry").points.size(), 4U);
  EXPECT_EQ(measure(bench(8.0, ""), "warm").points.size(), 4U);
}

// Between two points, and while a run measures.
TEST_F(TemperatureSeriesTest, ALostChamberIsSaidToHeat) {
  for (const int at_s : {4000, 1300}) {
    SeriesText text;
    text.temperature += "end = \"off\"\n";
    text.protocol = "steps = 8\nstep_deg = 45.0\ncheck_poses = false\nsettle_s = 30.0\ndwell_readings = 20\n";
    text.more =
        fmt::format("[[fault]]\nkind = \"silence\"\ninstrument = \"chamber\"\nat_s = {}\nfor_s = 60\n", at_s);
    told_.clear();
    const InstrumentError error = failure_of(text, std::to_string(at_s));
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("chamber unreachable, last set point"), HasSubstr("it may be heating")));
    EXPECT_THAT(told_, HasSubstr("The chamber answers again"));
  }
}

TEST_F(TemperatureSeriesTest, WeissChambersDoItToo) {
  for (const char* model : {"simserv", "ascii2"}) {
    SeriesText text;
    text.chamber = fmt::format("driver = \"weiss_simserv\"\nport = \"simulated\"\nmodel = \"{}\"\n", model);
    text.temperature =
        "set_points_degc = [0, 50]\ndown = false\nramp_k_per_min = 5.0\nsoak_min_s = 600\nend = \"hold\"\n";
    EXPECT_EQ(measure(text, model).points.size(), 4U);
  }
}

TEST_F(TemperatureSeriesTest, GoesOnAtTheNextAngleOfAnyPoint) {
  const SeriesText text;
  std::mt19937 random(5);
  int stops = 0;
  for (;;) {
    stop_ = {};
    dwells_ = 0;
    stop_after_ = 1 + static_cast<int>(random() % 60);
    try {
      const TemperatureResult result = measure(text);
      EXPECT_EQ(result.points.size(), 7U);
      for (const double error : slope_errors(result)) EXPECT_LT(std::abs(error), 4.5);
      break;
    } catch (const RunInterrupted&) {
      ++stops;
      EXPECT_THAT(told_, HasSubstr("The chamber is driven to 23 degC"));
    }
  }
  EXPECT_GT(stops, 2);
  for (const auto& path : series_paths(folder_ / "a", 7))
    EXPECT_EQ(RunFile::load(path).measured.size(), 24U + 3U);
}

TEST(SoakRuleTest, WaitsForAirAndItem) {
  TemperatureConfig config;
  config.soak_min_s = 600.0;
  config.soak_span_s = 200.0;
  config.soak_rate_k_per_min = 0.02;
  SoakRule rule(config, 50.0);
  double time = 0.0;
  const auto look = [&](double air, double item) {
    rule.add(time, air, item);
    time += 20.0;
  };
  for (int n = 0; n < 60; ++n) look(40.0, 40.0);
  EXPECT_FALSE(rule.reached()) << "the air is not there";
  for (int n = 0; n < 60; ++n) look(50.0, 40.0 + 0.02 * n);
  EXPECT_FALSE(rule.reached()) << "the item moves by 0.06 K/min";
  EXPECT_NEAR(*rule.rate_k_per_min(), 0.06, 1e-9);
  for (int n = 0; n < 12; ++n) look(50.0, 41.2);
  EXPECT_TRUE(rule.reached());
  look(52.0, 41.2);
  EXPECT_FALSE(rule.reached()) << "the air has left its window";
}

TEST(SoakRuleTest, ReadingsCoverTheSpanHoweverFarApartTheyAre) {
  TemperatureConfig config;
  config.soak_min_s = 0.0;
  config.soak_span_s = 4.0;
  config.soak_rate_k_per_min = 0.02;
  SoakRule rule(config, 50.0);
  for (const double time_s : {0.0, 1.3, 2.6, 3.9}) rule.add(time_s, 50.0, 41.2);
  EXPECT_FALSE(rule.rate_k_per_min()) << "the span has not passed";
  for (const double time_s : {5.2, 6.5, 7.8, 9.1}) {
    rule.add(time_s, 50.0, 41.2);
    EXPECT_TRUE(rule.reached()) << time_s << " s";
  }
}

using LongTemperatureSeriesTest = TemperatureSeriesTest;

TEST_F(LongTemperatureSeriesTest, CoefficientsLieWithinTheirUncertaintyIn200Series) {
  int within = 0, all = 0;
  double squares = 0.0;
  for (int n = 0; n < 200; ++n) {
    SeriesText text;
    text.seed = 1000 + n;
    const std::string name = fmt::format("s{}", n);
    for (const double error : slope_errors(measure(text, name))) {
      ++all;
      within += std::abs(error) < 1.96 ? 1 : 0;
      squares += error * error;
    }
    for (const auto& path : series_paths(folder_ / name, 7)) {
      std::filesystem::remove(path);
      std::filesystem::remove(ResultsFile::path_beside(path));
    }
  }
  fmt::print("{} of {} coefficients within 1.96 u, rms {:.3f} u\n", within, all, std::sqrt(squares / all));
  EXPECT_GE(within, 0.93 * all);
}

}  // namespace
}  // namespace abcal
