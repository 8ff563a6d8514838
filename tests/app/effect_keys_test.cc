// [stage_uncertainty], [item_uncertainty] and the effects of [simulation] in a bench file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/results/analysis/effect_words.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::HasSubstr;
using testing::Not;

constexpr const char* kBench = R"(
[bench]
g_loc_mps2 = 9.81
[stage]
driver = "pi_gcs"
port = "simulated"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
)";

BenchConfig bench_with(const std::string& more) {
  return parse_bench(kBench + more, "bench.toml");
}

std::string refusal_of(const std::string& more) {
  try {
    bench_with(more);
  } catch (const BenchError& error) {
    return error.what();
  }
  ADD_FAILURE() << "accepted: " << more;
  return {};
}

TEST(EffectKeysTest, APlainNumberIsAStandardUncertaintyAndStated) {
  const BenchConfig config =
      bench_with("[stage_uncertainty]\nwobble_urad = 12\n[item_uncertainty]\ndrift = 2e-5\n");
  EXPECT_EQ(config.items.front().tolerances.wobble_urad, 12.0);
  EXPECT_EQ(config.items.front().tolerances.sources.at("wobble_urad"), "stated");
  EXPECT_EQ(config.items.front().tolerances.drift, 2e-5);
  EXPECT_EQ(config.items.front().tolerances.step.deg(), 0.008);
  EXPECT_FALSE(config.items.front().tolerances.sources.contains("step_deg"));
  EXPECT_TRUE(config.warnings.empty());
}

TEST(EffectKeysTest, ATableGivesTheSourceAndTurnsLimitsIntoStandardUncertainties) {
  const BenchConfig config = bench_with(R"([stage_uncertainty]
alignment_deg = { value = 0.003, source = "autocollimator 2026-03" }
zero_deg = { half_width = 0.02, distribution = "rectangular", source = "data sheet" }
step_deg = { half_width = 0.02, distribution = "triangular" }
initial_turn_deg = { half_width = 0.02, distribution = "u-shaped" }
wobble_urad = { expanded_uncertainty = 30, k = 2, source = "certificate 4711" }
)");
  const EffectSizes& sizes = config.items.front().tolerances;
  EXPECT_EQ(sizes.alignment.deg(), 0.003);
  EXPECT_EQ(sizes.sources.at("alignment_deg"), "autocollimator 2026-03");
  EXPECT_DOUBLE_EQ(sizes.zero.deg(), 0.02 / std::sqrt(3.0));
  EXPECT_EQ(sizes.sources.at("zero_deg"), "data sheet (rectangular, half-width 0.02 degree)");
  EXPECT_DOUBLE_EQ(sizes.step.deg(), 0.02 / std::sqrt(6.0));
  EXPECT_EQ(sizes.sources.at("step_deg"), "stated (triangular, half-width 0.02 degree)");
  EXPECT_DOUBLE_EQ(sizes.initial_turn.deg(), 0.02 / std::sqrt(2.0));
  EXPECT_EQ(sizes.wobble_urad, 15.0);
  EXPECT_EQ(sizes.sources.at("wobble_urad"), "certificate 4711 (U = 30 urad, k = 2)");
  // The distributions stay with the sizes, and a written file keeps them.
  const std::map<std::string, Shape, std::less<>> shapes{{"zero_deg", Shape::kRectangular},
                                                         {"step_deg", Shape::kTriangular},
                                                         {"initial_turn_deg", Shape::kUShaped}};
  EXPECT_EQ(sizes.shapes, shapes);
  const BenchConfig again = parse_bench(write_bench(config), "again");
  EXPECT_EQ(again.items.front().tolerances, sizes);
}

TEST(EffectKeysTest, EveryMistakeIsReportedAtOnceWithItsLineRangeAndUnit) {
  const std::string text = refusal_of(R"([stage_uncertainty]
wobble_urad = 1e6
step_deg = -0.1
zero_deg = nan
step_smoth_deg = 0.004
alignment_deg = { source = "a certificate" }
initial_turn_deg = { half_width = 0.02 }
step_smooth_deg = { half_width = 0.02, distribution = "gaussian" }
[item_uncertainty]
drift = { value = 1e-5, half_width = 2e-5, distribution = "rectangular" }
sensitivity_drift = { expanded_uncertainty = 1e-5 }
hysteresis = { value = -1e-5, source = 7 }
nonlinearity = "small"
k2 = { vlaue = 1e-3 }
)");
  EXPECT_THAT(text,
              HasSubstr("line 11, [stage_uncertainty] wobble_urad: found 1e+06 urad; required: a standard "
                        "uncertainty, a number from 0 to 10000 urad"));
  EXPECT_THAT(text,
              HasSubstr("line 12, [stage_uncertainty] step_deg: found -0.1 degree; required: a standard "
                        "uncertainty, a number from 0 to 10 degree"));
  EXPECT_THAT(text, HasSubstr("line 13, [stage_uncertainty] zero_deg: found nan"));
  EXPECT_THAT(text,
              HasSubstr("line 14, [stage_uncertainty] step_smoth_deg: found a key of this name; required: a "
                        "known key: did you mean \"step_smooth_deg\"?"));
  EXPECT_THAT(
      text,
      HasSubstr(
          "line 15, [stage_uncertainty] alignment_deg: found a source without a value; required: one of "
          "value (standard uncertainty), half_width with distribution, expanded_uncertainty with k: a "
          "number from 0 to"));
  EXPECT_THAT(
      text,
      HasSubstr("line 16, [stage_uncertainty] initial_turn_deg: found half_width without distribution"));
  EXPECT_THAT(text,
              HasSubstr("line 17, [stage_uncertainty.step_smooth_deg] distribution: found \"gaussian\""));
  EXPECT_THAT(text, HasSubstr("line 19, [item_uncertainty] drift: found several values"));
  EXPECT_THAT(
      text, HasSubstr("line 20, [item_uncertainty] sensitivity_drift: found expanded_uncertainty without k"));
  EXPECT_THAT(
      text,
      HasSubstr("line 21, [item_uncertainty.hysteresis] value: found -1e-05; required: a number from 0"));
  EXPECT_THAT(text, HasSubstr("line 21, [item_uncertainty.hysteresis] source: found 7"));
  EXPECT_THAT(text, HasSubstr("line 22, [item_uncertainty] nonlinearity: found \"small\""));
  EXPECT_THAT(text, HasSubstr("line 23, [item_uncertainty.k2] vlaue: found a key of this name"));
}

TEST(EffectKeysTest, TheOldSectionIsReadAndSaidToBeOld) {
  const BenchConfig config = bench_with("[tolerances]\nstep_deg = 0.006\ndrift = 3e-5\n");
  EXPECT_EQ(config.items.front().tolerances.step.deg(), 0.006);
  EXPECT_EQ(config.items.front().tolerances.drift, 3e-5);
  EXPECT_EQ(config.items.front().tolerances.sources.at("step_deg"), "tolerances");
  ASSERT_EQ(config.warnings.size(), 1U);
  EXPECT_THAT(config.warnings[0], HasSubstr("[tolerances] belongs to the older schema abcal.bench/1"));
  EXPECT_THAT(config.warnings[0], HasSubstr("[stage_uncertainty] step_deg, [item_uncertainty] drift"));
  EXPECT_EQ(config.schema, "abcal.bench/2");
  EXPECT_TRUE(bench_with("[tolerances]\n").warnings.empty()) << "an empty section states nothing";
  EXPECT_THAT(refusal_of("[tolerances]\nstep_deg = 0.006\n[stage_uncertainty]\nstep_deg = 0.006\n"),
              HasSubstr("[tolerances] step_deg: found also [stage_uncertainty] step_deg"));
  EXPECT_THAT(refusal_of("[tolerances]\nwobble_urad = 10\n"), HasSubstr("[tolerances] wobble_urad"));
}

TEST(EffectKeysTest, AWrittenFileTellsDefaultsFromStatedValues) {
  const BenchConfig config = bench_with(
      "[stage_uncertainty]\nwobble_urad = { value = 12, source = \"certificate \\\"A\\\"\" "
      "}\n[tolerances]\nstep_deg = "
      "0.006\n");
  const std::string once = write_bench(config);
  EXPECT_THAT(once, HasSubstr("schema = 'abcal.bench/2'"));
  EXPECT_THAT(once, Not(HasSubstr("[tolerances]")));
  EXPECT_THAT(once, HasSubstr("hysteresis = { value = 1e-05, source = 'default' }"));
  const BenchConfig again = parse_bench(once, "stored");
  EXPECT_EQ(write_bench(again), once);
  EXPECT_EQ(again.items.front().tolerances.sources, config.items.front().tolerances.sources);
  EXPECT_EQ(again.items.front().tolerances.wobble_urad, 12.0);
  EXPECT_EQ(again.items.front().tolerances.step.deg(), 0.006);
  EXPECT_TRUE(again.warnings.empty());
}

/// The blocks of TOML in a page.
std::vector<std::string> toml_blocks(const std::string& page) {
  const std::string text = test::read_file(test::source_folder() / "docs" / page);
  std::vector<std::string> blocks;
  const std::string fence = "```toml\n";
  for (std::size_t at = text.find(fence); at != std::string::npos; at = text.find(fence, at)) {
    at += fence.size();
    blocks.push_back(text.substr(at, text.find("```", at) - at));
  }
  return blocks;
}

// Every number of the examples of docs/effects.md, as its text derives it.
TEST(EffectKeysTest, TheExamplesOfThePageAreReadAsTheirTextSays) {
  const std::vector<std::string> blocks = toml_blocks("effects.md");
  ASSERT_EQ(blocks.size(), 3U);
  const EffectSizes forms = bench_with(blocks[0]).items.front().tolerances;
  EXPECT_EQ(forms.wobble_urad, 12.0);
  EXPECT_DOUBLE_EQ(forms.drift, 1e-5);
  const BenchConfig both = bench_with(blocks[1] + "alignment_deg = 0.01\n" + blocks[2]);
  const EffectSizes& sizes = both.items.front().tolerances;
  EXPECT_NEAR(sizes.wobble_urad, 50.0 / 4.1, 0.5);
  EXPECT_NEAR(sizes.zero.deg(), 0.0115, 5e-5);
  EXPECT_EQ(sizes.zero.deg(), sizes.initial_turn.deg());
  EXPECT_NEAR(sizes.step.deg(), sizes.zero.deg() / std::sqrt(2.0), 2e-4);
  EXPECT_NEAR(sizes.step_smooth.deg(), sizes.step.deg() / std::sqrt(6.0), 5e-5);
  EXPECT_NEAR(sizes.step_eccentric.deg(), 0.02 / std::sqrt(2.0), 5e-5);
  EXPECT_EQ(sizes.shape_of("step_eccentric_deg"), Shape::kUShaped);
  EXPECT_NEAR(sizes.drift, 8.7e-5, 5e-7);
  EXPECT_NEAR(sizes.sensitivity_drift, 5.8e-5, 5e-7);
  EXPECT_NEAR(sizes.k2, 5.8e-4, 5e-6);
  EXPECT_NEAR(sizes.k3, 5.8e-4, 5e-6);
  EXPECT_NEAR(sizes.hysteresis, 2.9e-5, 5e-7);
  EXPECT_TRUE(both.warnings.empty());
  EXPECT_EQ(unstated_effects(sizes).size(), 1U) << default_effects_words(sizes, Advice::kNone);
  EXPECT_THAT(default_effects_words(sizes, Advice::kNone), HasSubstr("non-linearity of orders 4 and 5"));
}

TEST(EffectKeysTest, ANumberAloneHasNoSource) {
  EffectSizes sizes;
  EXPECT_TRUE(effects_without_source(sizes).empty()) << "a default is unstated, not without source";
  sizes.sources = {{"wobble_urad", "certificate 12"}, {"step_deg", "stated"},
                   {"alignment_deg", "tolerances"},   {"k2", " "},
                   {"k3", "stated in data sheet 5"},  {"voltmeter_gain", "stated"}};  // Zero: no effect.
  EXPECT_THAT(effects_without_source(sizes),
              testing::ElementsAre("alignment of the axes", "step errors without memory",
                                   "non-linearity of order 2"));
  // Statements of a bench file.
  const BenchConfig config = bench_with(
      "[stage_uncertainty]\nwobble_urad = 12\nzero_deg = { half_width = 0.02, distribution = \"rectangular\" "
      "}\n"
      "step_deg = { value = 0.001, source = \"certificate 12\" }\nalignment_deg = 0\n"
      "[item_uncertainty]\ndrift = { expanded_uncertainty = 2e-5, k = 2 }\n");
  EXPECT_THAT(effects_without_source(config.items.front().tolerances),
              testing::ElementsAre("zeros of the axes", "wobble of the axes, each coefficient to 3/rev",
                                   "drift of the offset, each order"));
}

TEST(EffectKeysTest, DefaultsAreNamed) {
  const BenchConfig config = bench_with("[stage_uncertainty]\nwobble_urad = 12\n");
  const std::string words = default_effects_words(config.items.front().tolerances, Advice::kForOperator);
  EXPECT_THAT(words, HasSubstr("default sizes are used"));
  EXPECT_THAT(words, HasSubstr("hysteresis"));
  EXPECT_THAT(words, Not(HasSubstr("wobble")));
  EXPECT_THAT(words, HasSubstr("; state them in [stage_uncertainty]"));
  EXPECT_THAT(default_effects_words(config.items.front().tolerances, Advice::kNone),
              Not(HasSubstr("state them")));
}

TEST(EffectKeysTest, TheSimulatedWorldTakesEveryEffectAndGivesItBack) {
  const BenchConfig config = bench_with(R"([simulation]
k4 = [1e-4, 0, 0]
asymmetry = [1e-4, 0, 0]
cross_bb = [0, 1e-5, 0]
hysteresis = [1e-5, 1e-5, 1e-5]
drift_2 = [3e-5, 0, 0]
exponential_drift = [1e-5, 0, 0]
sinusoidal_drift = [1e-5, 0, 0]
sinusoidal_drift_phase_deg = 30
sensitivity_drift = [1e-4, 0, 0]
gain_step = [0, 0.002, 0]
gain_step_at_s = 3000
random_walk = 2e-5
flicker_noise = 1e-5
correlated_noise = 1e-5
correlated_noise_s = 90
mount_creep_urad = [20, 0, 0]
span_s = 4000
floor_tilt_x_urad = 20
sag_urad = [0, 0, 20]
[simulation.x]
wobble_urad = 12
smooth_error_deg = 0.004
[[simulation.x.harmonics]]
order = 2
sin_deg = 0.005
[[simulation.x.wobble]]
order = 1
cos_1_urad = 20
sin_2_urad = -20
)");
  EXPECT_EQ(config.items.front().simulation.k4[0], 1e-4);
  EXPECT_EQ(config.items.front().simulation.gain_step[1], 0.002);
  EXPECT_EQ(config.simulation.span_s, 4000.0);
  EXPECT_EQ(config.simulation.x.wobble_sd_urad, 12.0);
  ASSERT_EQ(config.simulation.x.wobble.size(), 1U);
  EXPECT_EQ(config.simulation.x.wobble[0].sin_2_urad, -20.0);
  EXPECT_EQ(config.simulation.x.harmonics.size(), 1U);
  const std::string once = write_bench(config);
  const BenchConfig again = parse_bench(once, "stored");
  EXPECT_EQ(write_bench(again), once);
  EXPECT_EQ(again.items.front().simulation.sinusoidal_drift_phase, Angle::degrees(30.0));
  EXPECT_EQ(again.simulation.x.wobble.size(), 1U);
  EXPECT_EQ(again.items.front().simulation.correlated_noise_s, 90.0);
}

TEST(EffectKeysTest, TheSimulatedWorldRefusesWhatCannotBe) {
  const std::string text = refusal_of(R"([simulation]
asymmetry = [1e-4, 0.7, 0]
random_walk = -1
correlated_noise_s = 0
sag_urad = [0, 0, 1e6]
span_s = 0
drift_2 = [1, 2]
[simulation.z]
wobble_urad = 1e6
)");
  EXPECT_THAT(text,
              HasSubstr("line 11, [simulation] asymmetry: found [0.0001, 0.7, 0]; required: three numbers, "
                        "[u, v, w], each a number from -0.5 to 0.5"));
  EXPECT_THAT(text, HasSubstr("line 12, [simulation] random_walk: found -1"));
  EXPECT_THAT(text, HasSubstr("line 13, [simulation] correlated_noise_s: found 0"));
  EXPECT_THAT(text, HasSubstr("line 14, [simulation] sag_urad"));
  EXPECT_THAT(text, HasSubstr("line 15, [simulation] span_s: found 0"));
  EXPECT_THAT(text, HasSubstr("line 16, [simulation] drift_2"));
  EXPECT_THAT(
      text,
      HasSubstr("line 18, [simulation.z] wobble_urad: found 1e+06; required: a number from 0 to 10000"));
}

TEST(EffectKeysTest, TheEstimatorIsChosenBeforeTheFirstAngle) {
  EXPECT_EQ(bench_with("").protocol.estimator, kDefaultEstimator);
  EXPECT_EQ(bench_with("[protocol]\nestimator = \"abc\"\n").protocol.estimator, "abc");
  EXPECT_THAT(
      refusal_of("[protocol]\nestimator = \"best\"\n"),
      HasSubstr("[protocol] estimator: found \"best\"; required: one of \"abc\", \"joint\", \"norm\""));
}

}  // namespace
}  // namespace abcal
