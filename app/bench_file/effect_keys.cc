#include "app/bench_file/effect_keys.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <optional>
#include <vector>

#include "app/bench_file/key_ranges.h"

namespace abcal {
namespace {

constexpr double kMostUrad = 10'000.0;  // 0.6 degrees: a stage that is worse is broken
constexpr Range kTilt{-kMostUrad, kMostUrad};
constexpr Range kRelative{-0.5, 0.5};

/// [tolerances] of abcal.bench/1: the same quantities under their old section.
void read_old_tolerances(KeyVisitor& keys, EffectSizes& sizes, std::vector<std::string>& warnings) {
  keys.section("tolerances");
  std::vector<std::string> moved;
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (!key.was_tolerance) continue;
    const std::string name(key.key);
    std::optional<double> value;
    keys.number(name, value, {0.0, key.most});
    if (!value) continue;
    key.set(sizes, *value);
    sizes.sources.insert_or_assign(name, "tolerances");
    moved.push_back(fmt::format("[{}] {}", key.section, key.key));
  }
  if (moved.empty()) return;
  warnings.push_back(
      fmt::format("[tolerances] belongs to the older schema abcal.bench/1; it is read, but use {} instead "
                  "(abcal.bench/2, docs/effects.md)",
                  fmt::join(moved, ", ")));
}

constexpr std::string_view kStageSection = "stage_uncertainty";
constexpr std::string_view kItemSection = "item_uncertainty";

void visit_sizes_of(std::string_view section, KeyVisitor& keys, EffectSizes& sizes) {
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.section != section) continue;
    const std::string name(key.key);
    const auto source = sizes.sources.find(name);
    if (keys.writes() && is_without_entry(key, sizes)) continue;
    const Shape shape = sizes.shape_of(name);
    StatedUncertainty stated{key.get(sizes), source == sizes.sources.end() ? "" : source->second,
                             shape == Shape::kNormal ? "" : std::string(to_string(shape))};
    keys.uncertainty(name, stated, key.most, std::string(key.unit));
    key.set(sizes, stated.value);
    sizes.shapes.erase(name);
    if (const std::optional<Shape> stated_shape = shape_named(stated.distribution);
        stated_shape && *stated_shape != Shape::kNormal)
      sizes.shapes.emplace(name, *stated_shape);
    if (stated.source.empty()) {
      sizes.sources.erase(name);
    } else {
      sizes.sources.insert_or_assign(name, stated.source);
    }
  }
}

}  // namespace

void visit_effect_sizes(KeyVisitor& keys, EffectSizes& sizes, bool with_item,
                        std::vector<std::string>& warnings) {
  if (!keys.writes()) read_old_tolerances(keys, sizes, warnings);
  for (const std::string_view section : {kStageSection, kItemSection}) {
    if (section == kItemSection && !with_item) continue;
    keys.section(std::string(section));
    visit_sizes_of(section, keys, sizes);
  }
}

void visit_item_effect_sizes(KeyVisitor& keys, EffectSizes& sizes) {
  visit_sizes_of(kItemSection, keys, sizes);
}

void visit_axis_effects(KeyVisitor& keys, sim::AxisTruth& axis) {
  keys.angle("smooth_error_deg", axis.smooth_error_sd, {0.0, 10.0});
  keys.number("wobble_urad", axis.wobble_sd_urad, {0.0, kMostUrad});
  keys.angle("fine_map_deg", axis.fine_map_sd, {0.0, 10.0});
  keys.angle("step_repeatability_deg", axis.step_repeatability_sd, {0.0, 10.0});
  keys.angle("homing_repeatability_deg", axis.homing_repeatability_sd, {0.0, 10.0});
  keys.angle("growth_deg", axis.growth_sd, {0.0, 10.0});
  keys.angle("knock_deg", axis.knock_sd, {0.0, 10.0});
}

void visit_axis_wobble(KeyVisitor& keys, sim::AxisTruth& axis) {
  keys.list("wobble", axis.wobble, sim::WobbleHarmonic{},
            [](KeyVisitor& entry, sim::WobbleHarmonic& harmonic) {
              entry.integer("order", harmonic.order, 1, 1000);
              entry.number("cos_1_urad", harmonic.cos_1_urad, kTilt);
              entry.number("sin_1_urad", harmonic.sin_1_urad, kTilt);
              entry.number("cos_2_urad", harmonic.cos_2_urad, kTilt);
              entry.number("sin_2_urad", harmonic.sin_2_urad, kTilt);
            });
}

void visit_output_effects(KeyVisitor& keys, sim::OutputTruth& s) {
  keys.vector("k4", s.k4, kFourthOrder);
  keys.vector("k5", s.k5, kFifthOrder);
  keys.vector("asymmetry", s.asymmetry, kRelative);
  keys.vector("cross_ab", s.cross_ab, kRelative);
  keys.vector("cross_ac", s.cross_ac, kRelative);
  keys.vector("cross_bc", s.cross_bc, kRelative);
  keys.vector("cross_bb", s.cross_bb, kRelative);
  keys.vector("cross_cc", s.cross_cc, kRelative);
  keys.vector("hysteresis", s.hysteresis, kResponse);
  keys.number("hysteresis_width", s.hysteresis_width, kResponseSize);
  keys.vector("drift_1", s.drift_1, kResponse);
  keys.vector("drift_2", s.drift_2, kResponse);
  keys.vector("drift_3", s.drift_3, kResponse);
  keys.vector("exponential_drift", s.exponential_drift, kResponse);
  keys.number("exponential_drift_s", s.exponential_drift_s, kTime);
  keys.vector("sinusoidal_drift", s.sinusoidal_drift, kResponse);
  keys.number("sinusoidal_drift_period_s", s.sinusoidal_drift_period_s, kTime);
  keys.angle("sinusoidal_drift_phase_deg", s.sinusoidal_drift_phase, kAngle);
  keys.vector("sensitivity_drift", s.sensitivity_drift, kRelative);
  keys.vector("gain_step", s.gain_step, kRelative);
  keys.number("gain_step_at_s", s.gain_step_at_s, kTimeOrZero);
  keys.number("random_walk", s.random_walk, kResponseSize);
  keys.number("flicker_noise", s.flicker_noise, kResponseSize);
  keys.number("correlated_noise", s.correlated_noise, kResponseSize);
  keys.number("correlated_noise_s", s.correlated_noise_s, kTime);
  keys.vector("mount_creep_urad", s.mount_creep_urad, kTilt);
  keys.number("mount_creep_s", s.mount_creep_s, kTime);
}

void visit_world_effects(KeyVisitor& keys, sim::StageTruth& s) {
  keys.number("span_s", s.span_s, {1.0, 1e9});
  keys.seed("run", s.run);
  keys.number("age_months", s.age_months, {0.0, 1200.0});
  keys.seed("knock_from_run", s.knock_from_run);
  keys.number("floor_repeatability_urad", s.floor_repeatability_urad, {0.0, kMostUrad});
  keys.number("floor_tilt_x_urad", s.floor_tilt_x_urad, kTilt);
  keys.number("floor_tilt_y_urad", s.floor_tilt_y_urad, kTilt);
  keys.vector("sag_urad", s.sag_urad, kTilt);
}

}  // namespace abcal
