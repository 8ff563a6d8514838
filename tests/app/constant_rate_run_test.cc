// A run at a constant rate with the program, and what it refuses.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/app/instrument_cases.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::HasSubstr;

constexpr const char* kBench = R"(schema = "abcal.bench/2"
[bench]
g_loc_mps2 = 9.81
[item]
serial_number = "A1"
[stage]
driver = "simulated"
[accelerometer]
driver = "simulated"
rate_hz = 100.0
response_unit = "g"
[protocol]
motion = "constant_rate"
rate_deg_per_s = [60, 20]
acceleration_deg_per_s2 = 200.0
steps = 36
step_deg = 10.0
check_poses = false
settle_s = "auto"
dwell_readings = 100
[simulation]
seed = 11
sensitivity_matrix = [[1.0, 0.004, -0.003], [0.006, 1.0, 0.008], [-0.011, 0.006, 1.0]]
offset = [0.01, -0.02, 0.005]
noise = 1e-4
low_pass_hz = 5.0
group_delay_s = 0.02
time_stamp_jitter_s = 0.001
position_u_mm = [10, 5, 20]
encoder_jitter_s = 0.001
[simulation.x]
speed_deg_per_s = 60.0
acceleration_deg_per_s2 = 200.0
wobble_urad = 50.0
[simulation.z]
speed_deg_per_s = 60.0
acceleration_deg_per_s2 = 200.0
wobble_urad = 50.0
)";

class ConstantRateRunTest : public ProgramTest {
 protected:
  void write_bench(const std::string& text) { test::write_file(folder / "bench.toml", text); }
  void run() {
    write_bench(kBench);
    const ProgramResult done = abcal({"run", "bench.toml", "-o", "a.run"});
    ASSERT_EQ(done.exit_code, 0) << done.err << done.out;
  }
  /// The words of `abcal plan` about one change of the bench file.
  std::string refusal(const std::string& from, const std::string& to) {
    write_bench(replaced(kBench, from, to));
    const ProgramResult plan = abcal({"plan", "bench.toml"});
    EXPECT_NE(plan.exit_code, 0) << plan.out;
    return plan.err;
  }
};

TEST_F(ConstantRateRunTest, GivesTheResponseAtRestAndAtEachRate) {
  run();
  const ProgramResult analysed = abcal({"analyse", "a.run", "--json"});
  ASSERT_EQ(analysed.exit_code, 0) << analysed.err;
  const auto json = nlohmann::json::parse(analysed.out);
  const auto& motion = json.at("motion");
  ASSERT_EQ(motion.at("responses").size(), 2U);
  const auto& fast = motion["responses"][1];
  EXPECT_NEAR(fast.at("frequency_hz").get<double>(), 1.0 / 6.0, 1e-4);
  for (const auto& amplitude : fast.at("amplitude"))
    EXPECT_NEAR(amplitude.at("value").get<double>(), 0.999445, 5e-5);
  EXPECT_NEAR(motion.at("position")[0][0].at("value").get<double>(), 10.0, 1.0);
  // 20 ms and the low-pass of 32 ms, less the mean lateness of the encoder, 0.8 ms.
  EXPECT_NEAR(motion.at("delay")[0].at("value").get<double>(), 0.0510, 0.003);
  const ProgramResult truth = abcal({"analyse", "a.run", "--truth", "bench.toml"});
  EXPECT_THAT(truth.out, HasSubstr("agrees"));
  EXPECT_THAT(abcal({"analyse", "a.run", "--full"}).out, HasSubstr("Response relative to rest"));
  EXPECT_EQ(abcal({"verify", "a.run"}).exit_code, 0);
}

TEST_F(ConstantRateRunTest, ItsReportSaysHowItWasMeasured) {
  run();
  ASSERT_EQ(abcal({"report", "a.run", "--html", "a.html"}).exit_code, 0);
  const std::string html = test::read_file(folder / "a.html");
  EXPECT_THAT(html, HasSubstr("at constant rates (M. Gaitan and J. Geist"));
  EXPECT_THAT(html, testing::Not(HasSubstr("the stage stands still")));
}

TEST_F(ConstantRateRunTest, OtherProgramsGetNothingThatLacksTheRate) {
  run();
  const ProgramResult csv = abcal({"report", "a.run", "--csv", "a.csv"});
  EXPECT_NE(csv.exit_code, 0);
  EXPECT_THAT(csv.err, HasSubstr("constant rates"));
}

// One sine fit of the sweeps of each circle: the response at rest, with that of the joint fit in its
// interval.
TEST_F(ConstantRateRunTest, AbcGivesTheResponseAtRest) {
  run();
  const auto result_of = [&](const char* estimator) {
    return nlohmann::json::parse(abcal({"analyse", "a.run", "--estimator", estimator, "--json"}).out);
  };
  const auto abc = result_of("abc"), joint = result_of("joint");
  EXPECT_EQ(abc.at("verdict"), "usable") << abc.at("why");
  for (const char* quantity : {"intrinsic_sensitivity", "intrinsic_angle", "offset"})
    for (std::size_t j = 0; j < 3; ++j) {
      const auto &one = abc.at(quantity).at(j), &other = joint.at(quantity).at(j);
      EXPECT_LT(std::abs(one.at("value").get<double>() - other.at("value").get<double>()),
                3.0 * one.at("standard_uncertainty").get<double>())
          << quantity << " " << j;
    }
}

TEST_F(ConstantRateRunTest, AnItemThatIsSlowerThanTheRotationIsSaidToBe) {
  write_bench(replaced(kBench, "low_pass_hz = 5.0", "low_pass_hz = 0.5"));
  (void)abcal({"run", "bench.toml", "-o", "a.run"});
  const auto json = nlohmann::json::parse(abcal({"analyse", "a.run", "--json"}).out);
  EXPECT_EQ(json.at("verdict"), "not_usable");
  EXPECT_THAT(
      json.at("why").get<std::string>(),
      testing::StartsWith("the item's filter is slow for the rotation: at 60 degrees/s its response is "
                          "smaller by "));
}

TEST_F(ConstantRateRunTest, WhatCannotBeMeasuredIsRefusedByThePlan) {
  EXPECT_THAT(refusal("[60, 20]", "[60, 60]"), HasSubstr("a second rate, stops, or a stated"));
  EXPECT_THAT(refusal("[60, 20]", "[200, 20]"), HasSubstr("rate_deg_per_s"));
  EXPECT_THAT(refusal("rate_hz = 100.0", "rate_hz = 20.0"), HasSubstr("readings at 20 Hz fall on a step"));
  EXPECT_THAT(
      refusal("driver = \"simulated\"\n[accelerometer]", "driver = \"manual_stage\"\n[accelerometer]"),
      HasSubstr("a stage that turns at a stated rate"));
  EXPECT_THAT(refusal("wobble_urad = 50.0\n[simulation.z]",
                      "travel_min_deg = -100.0\ntravel_max_deg = 280.0\n[simulation.z]"),
              HasSubstr("axis X"));
  EXPECT_THAT(refusal("steps = 36", "stops = 5\nsteps = 36"), HasSubstr("divides steps"));
}

TEST_F(ConstantRateRunTest, OneRateIsEnoughWithStopsOrAStatedFilter) {
  write_bench(replaced(kBench, "[60, 20]", "[60, 60]\nstops = 4"));
  EXPECT_EQ(abcal({"plan", "bench.toml"}).exit_code, 0);
  write_bench(replaced(kBench, "[60, 20]", "[60, 60]") +
              "[item_uncertainty]\nlow_pass = { value = 1e-5, source = \"data sheet\" }\n");
  EXPECT_EQ(abcal({"plan", "bench.toml"}).exit_code, 0);
}

}  // namespace
}  // namespace abcal
