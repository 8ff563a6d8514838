#include "app/bench_file/stated_truth.h"

#include <fmt/format.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <string>

#include "app/bench_file/instrument_ports.h"
#include "protocol/plan/rotation_plan.h"
#include "sim/counter_noise.h"

namespace abcal {
namespace {

/// Values of distributions with mean 0, one after the other, of one stage or item.
class StatedDraw {
 public:
  StatedDraw(const EffectSizes& sizes, std::uint64_t seed, std::uint64_t owner)
      : sizes_(sizes), seed_(seed), owner_(owner) {}

  /// The next value with the size of a key, in the unit of its size.
  double of(std::string_view key) {
    const double size = size_of(key);
    const std::array<double, 4> normal =
        sim::normal_numbers(seed_, sim::NoiseStream::kStated, {owner_, next_++, 0, 0});
    const auto uniform = [&](std::size_t i) { return share_below(normal.at(i)); };
    switch (sizes_.shape_of(key)) {
      case Shape::kNormal:
        return size * normal[0];
      case Shape::kRectangular:
        return size * std::numbers::sqrt3 * (2.0 * uniform(0) - 1.0);
      case Shape::kTriangular:
        return size * std::sqrt(6.0) * (uniform(0) + uniform(1) - 1.0);
      case Shape::kUShaped:
        return size * std::numbers::sqrt2 * std::sin(2.0 * std::numbers::pi * uniform(0));
    }
    return 0.0;
  }
  Eigen::Vector3d three_of(std::string_view key) {
    const double first = of(key), second = of(key);
    return {first, second, of(key)};
  }
  /// The next value between 0 and 1.
  double share() {
    const std::array<double, 4> normal =
        sim::normal_numbers(seed_, sim::NoiseStream::kStated, {owner_, next_++, 0, 0});
    return share_below(normal[0]);
  }
  double size_of(std::string_view key) const {
    for (const EffectSizeKey& each : effect_size_keys())
      if (each.key == key) return each.get(sizes_);
    return 0.0;
  }

 private:
  /// A value between 0 and 1 from a standard normal one.
  static double share_below(double normal) { return 0.5 * std::erfc(-normal / std::numbers::sqrt2); }

  const EffectSizes& sizes_;
  std::uint64_t seed_, owner_, next_ = 0;
};

constexpr int kSmoothOrders = 6;  // docs/effects.md
constexpr int kWobbleOrders = 3;

void draw_axis(StatedDraw& draw, const std::string& name,
               const std::function<bool(std::string_view)>& is_fixed, sim::AxisTruth& axis) {
  const auto angle = [&](const char* key, std::string_view size, Angle& value) {
    const Angle drawn = Angle::degrees(draw.of(size));
    if (!is_fixed(name + key)) value = drawn;
  };
  angle(".mean_step_error_deg", "zero_deg", axis.mean_step_error);
  angle(".initial_turn_error_deg", "initial_turn_deg", axis.initial_turn_error);
  if (!is_fixed(name + ".step_error_deg")) axis.step_error_sd = Angle::degrees(draw.size_of("step_deg"));
  std::vector<sim::ErrorHarmonic> harmonics;
  for (int order = 1; order <= kSmoothOrders; ++order) {
    const Angle sine = Angle::degrees(draw.of("step_smooth_deg"));
    harmonics.push_back({order, sine, Angle::degrees(draw.of("step_smooth_deg"))});
  }
  const Angle sine = Angle::degrees(draw.of("step_eccentric_deg"));
  harmonics.push_back({1, sine, Angle::degrees(draw.of("step_eccentric_deg"))});
  if (!is_fixed(name + ".harmonics") && !is_fixed(name + ".smooth_error_deg")) axis.harmonics = harmonics;
  std::vector<sim::WobbleHarmonic> wobble;
  for (int order = 1; order <= kWobbleOrders; ++order) {
    sim::WobbleHarmonic& one = wobble.emplace_back();
    one.order = order;
    for (double* value : {&one.cos_1_urad, &one.sin_1_urad, &one.cos_2_urad, &one.sin_2_urad})
      *value = draw.of("wobble_urad");
  }
  if (!is_fixed(name + ".wobble") && !is_fixed(name + ".wobble_urad")) axis.wobble = wobble;
}

/// Three values of an item from a size relative to S: a term of order n has the unit R^(1 - n).
Eigen::Vector3d drawn_vector(StatedDraw& draw, std::string_view stated, int order,
                             const sim::OutputTruth& item) {
  const Eigen::Array3d size = item.sensitivity_matrix.rowwise().norm().array();
  return (draw.three_of(stated).array() * size.pow(1 - order)).matrix();
}

/// Changes over one run.
void draw_drifts(StatedDraw& draw, double span_s, const std::function<bool(std::string_view)>& is_fixed,
                 sim::OutputTruth& item) {
  const auto vector = [&](const char* key, std::string_view stated, int order, Eigen::Vector3d& value) {
    const Eigen::Vector3d drawn = drawn_vector(draw, stated, order, item);
    if (!is_fixed(key)) value = drawn;
  };
  vector("drift_1", "drift", 0, item.drift_1);
  vector("drift_2", "drift", 0, item.drift_2);
  vector("drift_3", "drift", 0, item.drift_3);
  vector("sensitivity_drift", "sensitivity_drift", 1, item.sensitivity_drift);
  if (draw.size_of("cyclic_drift") == 0.0 || is_fixed("sinusoidal_drift")) return;
  // One order of the five that are stated, at a phase of its own: sine and cosine of the stated size.
  constexpr double kLeastCycles = 2.0, kOrders = 5.0;
  item.sinusoidal_drift_period_s = span_s / (kLeastCycles + std::floor(kOrders * draw.share()));
  item.sinusoidal_drift_phase = Angle::degrees(360.0 * draw.share());
  item.sinusoidal_drift = std::numbers::sqrt2 * drawn_vector(draw, "cyclic_drift", 0, item);
}

void draw_item(StatedDraw& draw, bool at_a_rate, const std::function<bool(std::string_view)>& is_fixed,
               sim::OutputTruth& item) {
  const auto vector = [&](const char* key, std::string_view stated, int order, Eigen::Vector3d& value) {
    const Eigen::Vector3d drawn = drawn_vector(draw, stated, order, item);
    if (!is_fixed(key)) value = drawn;
  };
  vector("k2", "k2", 2, item.k2);
  vector("k3", "k3", 3, item.k3);
  vector("k4", "nonlinearity", 4, item.k4);
  vector("k5", "nonlinearity", 5, item.k5);
  vector("asymmetry", "nonlinearity", 1, item.asymmetry);
  vector("cross_ab", "nonlinearity", 1, item.cross_ab);
  vector("cross_ac", "nonlinearity", 1, item.cross_ac);
  vector("cross_bc", "nonlinearity", 1, item.cross_bc);
  vector("cross_bb", "nonlinearity", 1, item.cross_bb);
  vector("cross_cc", "nonlinearity", 1, item.cross_cc);
  vector("hysteresis", "hysteresis", 0, item.hysteresis);
  if (!at_a_rate) return;
  vector("rate_offset", "rate_offset", 0, item.rate_offset);
  vector("position_u_mm", "position_mm", 1, item.position_u_mm);
  vector("position_v_mm", "position_mm", 1, item.position_v_mm);
  vector("position_w_mm", "position_mm", 1, item.position_w_mm);
}

/// Whether simulated time is that of one run from its beginning.
bool begins_with_the_run(const BenchConfig& config) {
  const auto is_simulated = [](const InstrumentPort& port) { return port.port == kSimulated; };
  return config.temperature.set_points_degc.empty() &&
         std::ranges::all_of(stage_ports(config.stage), is_simulated) &&
         std::ranges::all_of(all_accelerometer_ports(config), is_simulated) &&
         std::ranges::all_of(environment_ports(config.environment), is_simulated) &&
         std::ranges::all_of(chamber_ports(config.chamber), is_simulated);
}

/// Nullopt if the bench cannot be measured, which is reported elsewhere.
std::optional<double> time_of_planned_run(const BenchConfig& config) {
  const sim::StageTruth& s = config.simulation;
  const auto speed = [](const StageAxisConfig& axis, const sim::AxisTruth& truth) {
    return AxisSpeed{axis.speed_deg_per_s.value_or(truth.speed_deg_per_s), truth.acceleration_deg_per_s2};
  };
  double rate_hz = config.items.front().accelerometer.settings.rate_hz;
  for (const BenchItemConfig& item : config.items)
    rate_hz = std::min(rate_hz, item.accelerometer.settings.rate_hz);
  try {
    const std::vector<PlannedAngle> plan = make_rotation_plan(
        config.protocol,
        {AxisTravel{s.x.travel_min, s.x.travel_max}, AxisTravel{s.z.travel_min, s.z.travel_max}});
    const double run_s = estimate_duration(plan, config.protocol,
                                           {speed(config.stage.x, s.x), speed(config.stage.z, s.z)}, rate_hz)
                             .total_s();
    return std::max(1.0, run_s + config.protocol.warm_up_s);
  } catch (const PlanError&) {
    return std::nullopt;
  }
}

}  // namespace

void draw_stated_truth(const std::vector<EffectSizes>& sizes, const DrawnRun& run,
                       const std::function<bool(std::size_t, std::string_view)>& is_fixed,
                       sim::StageTruth& stage, const std::vector<sim::OutputTruth*>& items) {
  const auto is_fixed_of_stage = [&](std::string_view key) { return is_fixed(0, key); };
  StatedDraw draw(sizes.at(0), stage.seed, 0);
  const auto inclination = [&](const char* key, double& value) {
    const double drawn = std::sin(Angle::degrees(draw.of("alignment_deg")).rad());
    if (!is_fixed_of_stage(key)) value = drawn;
  };
  inclination("zx", stage.zx);
  inclination("zy", stage.zy);
  inclination("xz", stage.xz);
  draw_axis(draw, "x", is_fixed_of_stage, stage.x);
  draw_axis(draw, "z", is_fixed_of_stage, stage.z);
  if (run.at_a_rate && !is_fixed(0, "axes_distance_mm")) stage.axes_distance_mm = draw.of("axes_distance_mm");
  if (!is_fixed(0, "span_s")) stage.span_s = run.span_s;
  for (std::size_t k = 0; k < items.size(); ++k) {
    StatedDraw of_item(sizes.at(k), stage.seed, k + 1);
    const auto is_fixed_of_item = [&](std::string_view key) { return is_fixed(k + 1, key); };
    draw_item(of_item, run.at_a_rate, is_fixed_of_item, *items[k]);
    // Other drifts in each run on the same bench.
    constexpr std::uint64_t kOfRun = 1'000'000;
    StatedDraw of_run(sizes.at(k), sim::seed_of_run(stage.seed, stage.run), kOfRun + k + 1);
    draw_drifts(of_run, stage.span_s, is_fixed_of_item, *items[k]);
  }
}

void draw_stated_truth(BenchConfig& config, const std::function<bool(const std::string&)>& gives) {
  const std::optional<double> run_s = time_of_planned_run(config);
  const bool drifts = run_s && begins_with_the_run(config);
  std::vector<EffectSizes> sizes;
  std::vector<sim::OutputTruth*> items;
  for (BenchItemConfig& item : config.items) {
    sizes.push_back(item.tolerances);
    items.push_back(&item.simulation);
  }
  draw_stated_truth(
      sizes, {run_s.value_or(config.simulation.span_s), config.protocol.is_constant_rate()},
      [&](std::size_t item, std::string_view key) {
        const bool is_drift = item > 0 && key.find("drift") != std::string_view::npos;
        if (is_drift && !drifts) return true;
        // A value of [simulation] is that of all items of a list.
        return gives(fmt::format("simulation.{}", key)) ||
               (item > 0 && gives(fmt::format("item[{}].simulation.{}", item - 1, key)));
      },
      config.simulation, items);
}

const std::vector<EffectNotDrawn>& effects_not_drawn() {
  static const std::vector<EffectNotDrawn> kList{
      {"orthogonality_deg", "the angles between the axes are those of sensitivity_matrix"},
      {"drift_between_runs", "a simulated run is one run"},
      {"voltmeter_gain", "added to a finished result; the simulated voltmeter has none"},
      {"voltmeter_offset", "added to a finished result; the simulated voltmeter has none"},
      {"delay_s", "the delay is group_delay_s less encoder_latency_s"},
      {"delay_difference_s", "all outputs have one delay, group_delay_s"},
      {"sweep_deg", "follows from the jitter of the encoder's samples"},
      {"low_pass", "follows from low_pass_hz"},
      {"low_pass_fourth", "follows from low_pass_hz"},
      {"phase_rad", "follows from low_pass_hz"},
  };
  return kList;
}

}  // namespace abcal
