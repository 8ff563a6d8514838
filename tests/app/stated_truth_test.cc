#include "app/bench_file/stated_truth.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <string>

namespace abcal {
namespace {

bool nothing(std::size_t /*item*/, std::string_view /*key*/) {
  return false;
}

struct Drawn {
  sim::StageTruth stage;
  sim::OutputTruth item;
};

Drawn draw(const EffectSizes& sizes, std::uint64_t seed, bool at_a_rate = false,
           const std::function<bool(std::size_t, std::string_view)>& is_fixed = nothing) {
  Drawn out;
  out.stage.seed = seed;
  out.item.sensitivity_matrix = 4.0 * Eigen::Matrix3d::Identity();
  draw_stated_truth({sizes}, {100.0, at_a_rate}, is_fixed, out.stage, {&out.item});
  return out;
}

/// All values that are drawn, over the standard deviation that each is to have, by the key of its size.
std::map<std::string, std::vector<double>> standardised(const Drawn& d, const EffectSizes& sizes) {
  std::map<std::string, std::vector<double>> out;
  const auto three = [&](const char* key, const Eigen::Vector3d& value, double size) {
    for (Eigen::Index j = 0; j < 3; ++j) out[key].push_back(value(j) / size);
  };
  const double tilt = std::sin(sizes.alignment.rad());
  out["alignment_deg"] = {d.stage.zx / tilt, d.stage.zy / tilt, d.stage.xz / tilt};
  for (const sim::AxisTruth* axis : {&d.stage.x, &d.stage.z}) {
    out["zero_deg"].push_back(axis->mean_step_error.deg() / sizes.zero.deg());
    out["initial_turn_deg"].push_back(axis->initial_turn_error.deg() / sizes.initial_turn.deg());
    for (std::size_t i = 0; i < axis->harmonics.size(); ++i) {
      const bool smooth = i < 6;
      const double size = smooth ? sizes.step_smooth.deg() : sizes.step_eccentric.deg();
      for (const Angle& value : {axis->harmonics[i].sin_coefficient, axis->harmonics[i].cos_coefficient})
        out[smooth ? "step_smooth_deg" : "step_eccentric_deg"].push_back(value.deg() / size);
    }
    for (const sim::WobbleHarmonic& w : axis->wobble)
      for (const double value : {w.cos_1_urad, w.sin_1_urad, w.cos_2_urad, w.sin_2_urad})
        out["wobble_urad"].push_back(value / sizes.wobble_urad);
  }
  const double s = 4.0;
  const sim::OutputTruth& item = d.item;
  for (const Eigen::Vector3d& drift : {item.drift_1, item.drift_2, item.drift_3})
    three("drift", drift, s * sizes.drift);
  // Sine and cosine of one order: the amplitude over the root of 2.
  three("cyclic_drift", item.sinusoidal_drift / std::numbers::sqrt2, s * sizes.cyclic_drift);
  three("sensitivity_drift", item.sensitivity_drift, sizes.sensitivity_drift);
  three("k2", item.k2, sizes.k2 / s);
  three("k3", item.k3, sizes.k3 / (s * s));
  three("nonlinearity", item.k4, sizes.nonlinearity / std::pow(s, 3));
  three("nonlinearity", item.k5, sizes.nonlinearity / std::pow(s, 4));
  for (const Eigen::Vector3d& one :
       {item.asymmetry, item.cross_ab, item.cross_ac, item.cross_bc, item.cross_bb, item.cross_cc})
    three("nonlinearity", one, sizes.nonlinearity);
  three("hysteresis", item.hysteresis, s * sizes.hysteresis);
  return out;
}

// Each has its stated size, and no effect of the table is forgotten.
TEST(StatedTruthTest, EachEffectIsDrawnFromItsSizeOrIsOnTheListOfThoseThatAreNot) {
  EffectSizes sizes;
  sizes.step_eccentric = Angle::degrees(0.01);
  sizes.cyclic_drift = 1e-5;
  std::map<std::string, double> squares, means, counts;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    for (const auto& [key, values] : standardised(draw(sizes, seed), sizes)) {
      for (const double value : values) {
        squares[key] += value * value;
        means[key] += value;
        counts[key] += 1.0;
      }
    }
  }
  std::set<std::string> drawn{"step_deg", "axes_distance_mm", "rate_offset", "position_mm"};
  for (const auto& [key, square] : squares) {
    EXPECT_NEAR(square / counts[key], 1.0, 5.0 * std::sqrt(2.0 / counts[key])) << key;
    EXPECT_NEAR(means[key] / counts[key], 0.0, 5.0 / std::sqrt(counts[key])) << key;
    drawn.insert(key);
  }
  for (const EffectNotDrawn& left_out : effects_not_drawn()) drawn.emplace(left_out.key);
  for (const EffectSizeKey& key : effect_size_keys())
    EXPECT_TRUE(drawn.contains(std::string(key.key))) << key.key;
  EXPECT_EQ(draw(sizes, 1).stage.x.step_error_sd, sizes.step);
  EXPECT_EQ(draw(sizes, 1).stage.span_s, 100.0);
}

TEST(StatedTruthTest, AShapeIsThatOfItsStatement) {
  EffectSizes sizes;
  sizes.shapes = {{"zero_deg", Shape::kRectangular}, {"drift", Shape::kUShaped}, {"k2", Shape::kTriangular}};
  double zero = 0.0, drift = 0.0, k2 = 0.0, square = 0.0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    const Drawn d = draw(sizes, seed);
    zero = std::max(zero, std::abs(d.stage.x.mean_step_error.deg()) / sizes.zero.deg());
    drift = std::max(drift, d.item.drift_1.cwiseAbs().maxCoeff() / (4.0 * sizes.drift));
    k2 = std::max(k2, d.item.k2.cwiseAbs().maxCoeff() * 4.0 / sizes.k2);
    square += std::pow(d.stage.x.mean_step_error.deg() / sizes.zero.deg(), 2) / 400.0;
  }
  EXPECT_LE(zero, std::numbers::sqrt3);
  EXPECT_GT(zero, 1.7);
  EXPECT_LE(drift, std::numbers::sqrt2);
  EXPECT_GT(drift, 1.41);
  EXPECT_LE(k2, std::sqrt(6.0));
  EXPECT_GT(k2, 2.2);
  EXPECT_NEAR(square, 1.0, 0.2);
}

TEST(StatedTruthTest, AKeyOfTheFileKeepsItsValueAndNoOtherChanges) {
  const EffectSizes sizes;
  const Drawn all = draw(sizes, 7);
  const Drawn fixed = draw(sizes, 7, false, [](std::size_t item, std::string_view key) {
    return (item == 0 && key == "zx") || (item == 1 && key == "drift_2");
  });
  EXPECT_EQ(fixed.stage.zx, 0.0);
  EXPECT_EQ(fixed.item.drift_2, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_EQ(fixed.stage.zy, all.stage.zy);
  EXPECT_EQ(fixed.item.drift_3, all.item.drift_3);
}

TEST(StatedTruthTest, EffectsOfMotionBelongToRunsAtARate) {
  const EffectSizes sizes = with_effects_of_motion({});
  EXPECT_EQ(draw(sizes, 3).item.position_u_mm, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_NE(draw(sizes, 3, true).item.position_u_mm, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_NE(draw(sizes, 3, true).stage.axes_distance_mm, 0.0);
}

/// A bench file whose stage and item draw what they state.
std::string bench_that_draws(const std::string& port, const std::string& simulation) {
  return "schema = \"abcal.bench/2\"\n[bench]\ng_loc_mps2 = 9.8\n[stage]\n" + port +
         "\n[accelerometer]\ndriver = \"simulated\"\nrate_hz = 100.0\n[stage_uncertainty]\nwobble_urad = "
         "20.0\n[simulation]\ndraw = \"stated\"\nseed = 5\n" +
         simulation;
}
const std::string kSimulatedStage = "driver = \"simulated\"";

TEST(StatedTruthTest, ABenchFileDrawsWhatItDoesNotGive) {
  const BenchConfig free = parse_bench(bench_that_draws(kSimulatedStage, ""), "bench");
  BenchConfig fixed = parse_bench(
      bench_that_draws(kSimulatedStage, "k2 = [1e-3, 0, 0]\n[simulation.x]\nwobble_urad = 0.0\n"), "bench");
  EXPECT_NE(free.simulation.zx, 0.0);
  EXPECT_NE(free.items[0].simulation.drift_2, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_EQ(fixed.items[0].simulation.k2, Eigen::Vector3d(1e-3, 0.0, 0.0));
  EXPECT_TRUE(fixed.simulation.x.wobble.empty());
  fixed.items[0].simulation.k2 = free.items[0].simulation.k2;
  fixed.simulation.x.wobble = free.simulation.x.wobble;
  EXPECT_TRUE(fixed.is_same_bench(free));
  // A written file gives every value, and is the same bench.
  EXPECT_TRUE(parse_bench(write_bench(free), "written").is_same_bench(free));
  const BenchConfig other_run = parse_bench(bench_that_draws(kSimulatedStage, "run = 2\n"), "bench");
  EXPECT_EQ(other_run.simulation.zx, free.simulation.zx);
  EXPECT_EQ(other_run.items[0].simulation.k3, free.items[0].simulation.k3);
  EXPECT_NE(other_run.items[0].simulation.drift_2, free.items[0].simulation.drift_2);
}

TEST(StatedTruthTest, DriftsAreNotDrawnWhereTimeBeginsBeforeTheRun) {
  const BenchConfig real =
      parse_bench(bench_that_draws("driver = \"pi_gcs\"\nport = \"/dev/ttyS0\"", ""), "bench");
  EXPECT_EQ(real.items[0].simulation.drift_1, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_EQ(real.items[0].simulation.sensitivity_drift, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_NE(real.items[0].simulation.k3, Eigen::Vector3d(0.0, 0.0, 0.0));
}

TEST(StatedTruthTest, NothingIsDrawnUnasked) {
  std::string text = bench_that_draws(kSimulatedStage, "");
  text.erase(text.find("draw = \"stated\"\n"), 16);
  const BenchConfig config = parse_bench(text, "bench");
  EXPECT_EQ(config.simulation.zx, 0.0);
  EXPECT_EQ(config.items[0].simulation.k3, Eigen::Vector3d(0.0, 0.0, 0.0));
}

TEST(StatedTruthTest, ItemsOfATrayDrawTheirOwn) {
  const BenchConfig tray = parse_bench(
      "schema = \"abcal.bench/2\"\n[bench]\ng_loc_mps2 = 9.8\n[stage]\ndriver = "
      "\"simulated\"\n[simulation]\ndraw = \"stated\"\n[[item]]\n[item.accelerometer]\n"
      "driver = \"simulated\"\n[[item]]\n[item.accelerometer]\ndriver = \"simulated\"\n[item.simulation]\n"
      "k2 = [0, 0, 0]\n",
      "tray");
  EXPECT_NE(tray.item(1).simulation.k3, tray.item(2).simulation.k3);
  EXPECT_NE(tray.item(1).simulation.k2, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_EQ(tray.item(2).simulation.k2, Eigen::Vector3d(0.0, 0.0, 0.0));
}

}  // namespace
}  // namespace abcal
