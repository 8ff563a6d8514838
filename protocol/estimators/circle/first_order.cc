#include "protocol/estimators/circle/first_order.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <stdexcept>
#include <utility>

namespace abcal {

namespace {

constexpr double kRadianPerDegree = std::numbers::pi / 180.0;

/// Pose, gravity and linear response at each reading of the record.
struct EffectPlaces {
  std::vector<StagePose> poses;
  std::vector<GravityAt> gravity;
  std::vector<ItemPoint> points;
};

EffectPlaces places_of(std::span<const DwellRecord* const> dwells, std::span<const double> time_fractions,
                       const Eigen::Matrix3d& s, const std::vector<Eigen::Vector3d>& signs) {
  EffectPlaces out;
  const Eigen::Matrix3d rows = s.rowwise().normalized();
  for (std::size_t i = 0; i < dwells.size(); ++i) {
    const SinCos alpha = sincos(dwells[i]->alpha);
    StagePose& pose =
        out.poses.emplace_back(StagePose::of(dwells[i]->experiment, dwells[i]->face, alpha.sin, alpha.cos));
    if (const auto& motion = dwells[i]->motion) {
      pose.rate_radps = pose.mean_rate_radps = Angle::degrees(motion->rate_deg_per_s).rad();
      pose.acceleration_radps2 = Angle::degrees(motion->acceleration_deg_per_s2).rad();
    }
    out.gravity.push_back(gravity_at(pose, StageInputs::Zero()));
    out.points.push_back({time_fractions[i], rows * out.gravity.back().g, signs[i]});
    out.points.back().turn(pose, rows, out.gravity.back());
  }
  return out;
}

bool in_motion(std::span<const DwellRecord* const> dwells) {
  return std::ranges::any_of(dwells, [](const DwellRecord* dwell) { return dwell->motion.has_value(); });
}

/// Unit in which a budget shows an unknown, and the size of that unit in the table's unit.
std::pair<std::string, double> shown_unit(const StageEffect& effect) {
  if (effect.unit == "1") return {"1", 1.0};
  if (effect.key == "wobble_urad") return {"urad", 1e-6};
  return {"degree", kRadianPerDegree};
}

void add_stage_effects(const EffectPlaces& places, bool turns, const Eigen::Matrix3d& s,
                       const EffectSizes& sizes, std::vector<InputEffect>& effects) {
  for (const StageEffect& entry : stage_effects()) {
    const bool in_run =
        std::ranges::any_of(places.poses, [&](const StagePose& pose) { return pose.face >= entry.face; });
    if (!in_run || (entry.in_motion && !turns)) continue;
    const auto [unit, size] = shown_unit(entry);
    for (int i = 0; i < entry.count; ++i) {
      const std::string which = entry.unknown_name(i);
      InputEffect effect;
      effect.name = fmt::format("{}{}{}", entry.name, which.empty() ? "" : ", ", which);
      effect.group = entry.name;
      effect.key = entry.key;
      effect.unit = unit;
      effect.standard_uncertainty = entry.prior(sizes) / size;
      effect.effect.reserve(places.poses.size());
      for (std::size_t n = 0; n < places.poses.size(); ++n) {
        const StageShare share = entry.share(places.poses[n], i);
        const auto& by = places.gravity[n].by_input;
        effect.effect.push_back(
            size * s * (by.col(share.input) * share.value + by.col(share.second_input) * share.second_value));
      }
      effects.push_back(std::move(effect));
    }
  }
}

void add_item_effects(const EffectPlaces& places, bool turns, const Eigen::Matrix3d& s,
                      const EffectSizes& sizes, const std::string& response_unit,
                      std::vector<InputEffect>& effects) {
  const Eigen::Matrix3d rows = s.rowwise().normalized();
  for (const ItemEffect& entry : item_effects()) {
    if (entry.in_motion && !turns) continue;
    for (int i = 0; i < entry.count; ++i) {
      for (int j = 0; j < 3; ++j) {
        const std::string which = entry.unknown_name(i);
        InputEffect effect;
        effect.name = fmt::format("{} {}{}{}", entry.name, "uvw"[j], which.empty() ? "" : ", ", which);
        effect.group = entry.name;
        effect.key = entry.key;
        effect.unit = response_unit;
        effect.standard_uncertainty = entry.prior(sizes) * s.row(j).norm();
        effect.item = &entry;
        effect.item_unknown = i;
        effect.output = j;
        effect.effect.reserve(places.points.size());
        for (const ItemPoint& point : places.points)
          effect.effect.push_back(entry.share(point, j, i).value * Eigen::Vector3d::Unit(j));
        const LineShare line = entry.line(rows, j, i);
        effect.line.segment<3>(3 * j) = line.scale * rows.row(j).transpose();
        effect.line(9 + j) = line.offset;
        effects.push_back(std::move(effect));
      }
    }
  }
}

/// Adds what the mean signs of the hysteresis leave unknown, reading by reading.
/// @param sizes  those of the hysteresis of u, v, w (R)
void add_unknown_signs(std::span<const DwellRecord* const> dwells, const std::vector<Eigen::Vector3d>& signs,
                       const Eigen::Vector3d& sizes, const std::string& response_unit,
                       std::vector<InputEffect>& effects) {
  const auto entry = std::ranges::find(item_effects(), "hysteresis", &ItemEffect::key);
  for (std::size_t k = 0; k < signs.size(); ++k) {
    for (int j = 0; j < 3; ++j) {
      InputEffect effect;
      effect.name = fmt::format("{} {}, sign at f_{}({})", entry->name, "uvw"[j], dwells[k] -> experiment,
                                dwells[k] -> n);
      effect.group = entry->name;
      effect.key = entry->key;
      effect.unit = response_unit;
      effect.standard_uncertainty = sizes(j) * std::sqrt(std::max(0.0, 1.0 - signs[k](j) * signs[k](j)));
      effect.first_reading = k;
      effect.effect.push_back(Eigen::Vector3d::Unit(j));
      effects.push_back(std::move(effect));
    }
  }
}

/// The change of the readings by an angle error of the axis that moves, by 1 degree.
Eigen::Vector3d by_degree(const EffectPlaces& places, std::size_t n, const Eigen::Matrix3d& s) {
  const int moving = moving_angle_input(places.poses[n].experiment);
  return kRadianPerDegree * s * places.gravity[n].by_input.col(moving);
}

/// Adds what is not known of the angles of each sweep: their mean and their course around the circle.
void add_sweeps(std::span<const DwellRecord* const> dwells, const EffectPlaces& places,
                const Eigen::Matrix3d& s, const EffectSizes& sizes, std::vector<InputEffect>& effects) {
  std::map<std::array<int, 3>, std::vector<std::size_t>> sweeps;
  for (std::size_t n = 0; n < dwells.size(); ++n)
    if (dwells[n]->motion)
      sweeps[{dwells[n]->experiment, dwells[n]->face, dwells[n]->motion->sweep}].push_back(n);
  for (const auto& [which, readings] : sweeps) {
    const auto turned_deg = [&](std::size_t n) { return dwells[n]->alpha.deg(); };
    const auto [low, high] = std::ranges::minmax_element(readings, {}, turned_deg);
    const double middle_deg = 0.5 * (turned_deg(*low) + turned_deg(*high));
    const double course_deg = dwells[readings.front()]->motion->u_angle_deg;
    for (int i = 0; i < kSweepUnknowns; ++i) {
      InputEffect effect;
      effect.name = fmt::format("angles of sweep {} of experiment {}, part {}", which[2], which[0], i + 1);
      effect.group = "angles of the sweeps";
      effect.key = "sweep_deg";
      effect.unit = "degree";
      effect.standard_uncertainty = i == 0 ? std::hypot(course_deg, sizes.sweep.deg()) : course_deg;
      if (effect.standard_uncertainty == 0.0) continue;
      effect.first_reading = readings.front();
      effect.effect.assign(readings.back() - readings.front() + 1, Eigen::Vector3d::Zero());
      for (const std::size_t n : readings)
        effect.effect[n - readings.front()] =
            by_degree(places, n, s) *
            sweep_shares(Angle::degrees(turned_deg(n) - middle_deg).rad()).value[static_cast<std::size_t>(i)];
      effects.push_back(std::move(effect));
    }
  }
}

/// Adds f_i(n) of each reading. The sweeps of a circle share it at one angle: the stage errs there alike.
void add_steps(std::span<const DwellRecord* const> dwells, const EffectPlaces& places,
               const Eigen::Matrix3d& s, double step_deg, std::vector<InputEffect>& effects) {
  std::map<std::array<int, 3>, std::size_t> of_sweeps;  // Place among the effects, by the angle of a circle.
  for (std::size_t k = 0; k < dwells.size(); ++k) {
    const DwellRecord& dwell = *dwells[k];
    if (dwell.motion) {
      const auto [known, is_new] =
          of_sweeps.try_emplace({dwell.experiment, dwell.face, dwell.n}, effects.size());
      if (!is_new) {
        InputEffect& shared = effects[known->second];
        shared.effect.resize(k - shared.first_reading, Eigen::Vector3d::Zero());
        shared.effect.push_back(by_degree(places, k, s));
        continue;
      }
    }
    InputEffect effect;
    effect.name = fmt::format("f_{}({})", dwell.experiment, dwell.n);
    effect.group = fmt::format("f_{}", dwell.experiment);
    effect.key = "step_deg";
    effect.unit = "degree";
    effect.standard_uncertainty = step_deg;
    effect.first_reading = k;
    effect.effect.push_back(by_degree(places, k, s));
    effects.push_back(std::move(effect));
  }
}

}  // namespace

std::vector<InputEffect> first_order_effects(const FirstOrderReadings& readings,
                                             const AccelerometerModel& accelerometer,
                                             const EffectSizes& sizes, const std::string& response_unit) {
  const auto& [dwells, time_fractions, arrivals] = readings;
  if (dwells.size() != time_fractions.size() || dwells.size() != arrivals.size()) {
    throw std::invalid_argument(
        fmt::format("first-order effects: {} dwells, {} times, {} arrivals; one of each is required",
                    dwells.size(), time_fractions.size(), arrivals.size()));
  }
  const Eigen::Matrix3d& s = accelerometer.sensitivity_matrix;
  std::vector<Eigen::Vector3d> signs(dwells.size(), Eigen::Vector3d::Zero());
  if (sizes.hysteresis > 0.0)
    signs = signs_by_sizes({arrivals.begin(), arrivals.end()}, s.rowwise().normalized(), sizes);
  const EffectPlaces places = places_of(dwells, time_fractions, s, signs);
  std::vector<InputEffect> effects;
  effects.reserve(150 + dwells.size());
  const bool turns = in_motion(dwells);
  add_stage_effects(places, turns, s, sizes, effects);
  add_item_effects(places, turns, s, sizes, response_unit, effects);
  if (turns) add_sweeps(dwells, places, s, sizes, effects);
  add_unknown_signs(dwells, signs, sizes.hysteresis * s.rowwise().norm(), response_unit, effects);
  std::erase_if(effects, [](const InputEffect& effect) { return effect.standard_uncertainty == 0.0; });
  if (step_prior(sizes) > 0.0) add_steps(dwells, places, s, step_prior(sizes) / kRadianPerDegree, effects);
  return effects;
}

}  // namespace abcal
