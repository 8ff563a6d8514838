#include "protocol/plan/effect_sizes.h"

#include <fmt/format.h>

#include <array>

#include "drivers/text/names.h"

namespace abcal {
namespace {

constexpr std::string_view kStage = "stage_uncertainty";
/// A stored default is not mistaken for a stated value.
constexpr std::string_view kDefaultSource = "default";
constexpr std::string_view kItem = "item_uncertainty";

constexpr auto kShapes = names<Shape>({{Shape::kNormal, "normal"},
                                       {Shape::kRectangular, "rectangular"},
                                       {Shape::kTriangular, "triangular"},
                                       {Shape::kUShaped, "u-shaped"}});

template <Angle EffectSizes::*member>
constexpr double degrees_of(const EffectSizes& sizes) {
  return (sizes.*member).deg();
}
template <Angle EffectSizes::*member>
constexpr void set_degrees(EffectSizes& sizes, double value) {
  sizes.*member = Angle::degrees(value);
}
template <double EffectSizes::*member>
constexpr double value_of(const EffectSizes& sizes) {
  return sizes.*member;
}
template <double EffectSizes::*member>
constexpr void set_value(EffectSizes& sizes, double value) {
  sizes.*member = value;
}

template <Angle EffectSizes::*member>
constexpr EffectSizeKey angle(std::string_view section, std::string_view key, double most, Term words) {
  return {.section = section,
          .key = key,
          .unit = "degree",
          .most = most,
          .words = words,
          .get = degrees_of<member>,
          .set = set_degrees<member>};
}
template <double EffectSizes::*member>
constexpr EffectSizeKey value(std::string_view section, std::string_view key, std::string_view unit,
                              double most, Term words) {
  return {.section = section,
          .key = key,
          .unit = unit,
          .most = most,
          .words = words,
          .get = value_of<member>,
          .set = set_value<member>};
}
constexpr EffectSizeKey once_a_tolerance(EffectSizeKey key) {
  key.was_tolerance = true;
  return key;
}
constexpr EffectSizeKey further(EffectSizeKey key) {
  key.is_further = true;
  return key;
}
constexpr EffectSizeKey usual_but_zero(Term uncovered, EffectSizeKey key) {
  key.uncovered = uncovered;
  return key;
}

constexpr EffectSizeKey between_runs(EffectSizeKey key) {
  key.between_runs = true;
  return key;
}
constexpr EffectSizeKey in_motion(double size, EffectSizeKey key) {
  key.in_motion = size;
  return key;
}

constexpr std::array kKeys{
    once_a_tolerance(angle<&EffectSizes::alignment>(kStage, "alignment_deg", 10.0, "alignment of the axes")),
    once_a_tolerance(
        angle<&EffectSizes::initial_turn>(kStage, "initial_turn_deg", 10.0, "initial turns of -90 degrees")),
    once_a_tolerance(angle<&EffectSizes::zero>(kStage, "zero_deg", 10.0, "zeros of the axes")),
    once_a_tolerance(angle<&EffectSizes::step>(kStage, "step_deg", 10.0, "step errors without memory")),
    further(angle<&EffectSizes::step_smooth>(kStage, "step_smooth_deg", 10.0,
                                             "smooth step errors, each coefficient to 6/rev")),
    further(angle<&EffectSizes::step_eccentric>(kStage, "step_eccentric_deg", 10.0,
                                                "step error with one period a turn, sine and cosine")),
    further(value<&EffectSizes::wobble_urad>(kStage, "wobble_urad", "urad", 10'000.0,
                                             "wobble of the axes, each coefficient to 3/rev")),
    once_a_tolerance(value<&EffectSizes::drift>(kItem, "drift", "1", 1.0, "drift of the offset, each order")),
    usual_but_zero("an offset that comes and goes 2 to 6 times in the run, as with air conditioning",
                   further(value<&EffectSizes::cyclic_drift>(
                       kItem, "cyclic_drift", "1", 1.0,
                       "offset that comes and goes, each coefficient, 2 to 6 cycles a run"))),
    further(value<&EffectSizes::sensitivity_drift>(kItem, "sensitivity_drift", "1", 1.0,
                                                   "drift of the sensitivity")),
    further(value<&EffectSizes::nonlinearity>(kItem, "nonlinearity", "1", 0.1,
                                              "non-linearity of orders 4 and 5, |a| and cross terms")),
    further(value<&EffectSizes::hysteresis>(kItem, "hysteresis", "1", 0.1, "hysteresis")),
    value<&EffectSizes::k2>(kItem, "k2", "1", 0.1, "non-linearity of order 2"),
    value<&EffectSizes::k3>(kItem, "k3", "1", 0.1, "non-linearity of order 3"),
    angle<&EffectSizes::orthogonality>(kItem, "orthogonality_deg", 45.0,
                                       "angles between the item's axes about 90 degrees"),
    between_runs(value<&EffectSizes::drift_between_runs>(
        kItem, "drift_between_runs", "1", 1.0,
        "change of offset and sensitivity from run to run of a measurement of several")),
    value<&EffectSizes::voltmeter_gain>(kItem, "voltmeter_gain", "1", 0.1, "gain of the voltmeter"),
    value<&EffectSizes::voltmeter_offset>(kItem, "voltmeter_offset", "1", 0.1, "offset of the voltmeter"),
    in_motion(0.1, value<&EffectSizes::delay_s>(kStage, "delay_s", "s", 10.0,
                                                "delay of the item behind the encoders")),
    in_motion(10.0, value<&EffectSizes::axes_distance_mm>(kStage, "axes_distance_mm", "mm", 1000.0,
                                                          "distance between the axes of the stage")),
    in_motion(0.0005,
              angle<&EffectSizes::sweep>(kStage, "sweep_deg", 10.0, "error of the angles common to a sweep")),
    in_motion(0.001, value<&EffectSizes::delay_difference_s>(kItem, "delay_difference_s", "s", 10.0,
                                                             "delay of an output beyond that of the item")),
    in_motion(0.01,
              value<&EffectSizes::low_pass>(kItem, "low_pass", "1", 1.0,
                                            "loss of amplitude at 60 degrees/s, growing with its square")),
    in_motion(5e-7, value<&EffectSizes::low_pass_fourth>(
                        kItem, "low_pass_fourth", "1", 1.0,
                        "loss of amplitude at 60 degrees/s, growing with its fourth power")),
    in_motion(1e-4,
              value<&EffectSizes::phase_rad>(kItem, "phase_rad", "radian", 1.0,
                                             "phase beyond a delay at 60 degrees/s, growing with its cube")),
    in_motion(1e-4, value<&EffectSizes::rate_offset>(kItem, "rate_offset", "1", 1.0,
                                                     "offset that grows with the rate, at 60 degrees/s")),
    in_motion(30.0, value<&EffectSizes::position_mm>(kItem, "position_mm", "mm", 10'000.0,
                                                     "apparent positions of the outputs' elements")),
};

std::string full_name(const EffectSizeKey& key) {
  return fmt::format("{}.{}", key.section, key.key);
}

}  // namespace

std::string_view to_string(Shape shape) {
  return kShapes.of(shape);
}

std::optional<Shape> shape_named(std::string_view name) {
  return kShapes.value(name);
}

Shape EffectSizes::shape_of(std::string_view key) const {
  const auto found = shapes.find(key);
  return found == shapes.end() ? Shape::kNormal : found->second;
}

bool is_without_entry(const EffectSizeKey& key, const EffectSizes& sizes) {
  return (key.in_motion > 0.0 || key.between_runs) && key.get(sizes) == 0.0 &&
         !sizes.sources.contains(key.key);
}

EffectSizes with_effects_of_motion(EffectSizes sizes) {
  for (const EffectSizeKey& key : kKeys)
    if (key.in_motion > 0.0 && !sizes.sources.contains(key.key)) key.set(sizes, key.in_motion);
  return sizes;
}

EffectSizes without_further_effects(EffectSizes sizes) {
  for (const EffectSizeKey& key : kKeys)
    if (key.is_further) key.set(sizes, 0.0);
  return sizes;
}

std::span<const EffectSizeKey> effect_size_keys() {
  return kKeys;
}

void read_effect_sizes(const std::function<std::optional<double>(const std::string&, double)>& number,
                       const std::function<std::optional<std::string>(const std::string&)>& text,
                       EffectSizes& sizes) {
  for (const EffectSizeKey& key : kKeys) {
    const std::string name = full_name(key);
    std::string source = "stated";
    std::optional<double> found = number(name, key.most);
    if (found) {
      source = text(name + ".source").value_or("stated");
    } else if (key.was_tolerance) {
      found = number(fmt::format("tolerances.{}", key.key), key.most);
      source = "tolerances";
    }
    if (!found) continue;
    key.set(sizes, *found);
    sizes.shapes.erase(std::string(key.key));
    const Shape shape = shape_named(text(name + ".distribution").value_or("")).value_or(Shape::kNormal);
    if (shape != Shape::kNormal) sizes.shapes.emplace(key.key, shape);
    if (source == kDefaultSource) {
      sizes.sources.erase(std::string(key.key));
    } else {
      sizes.sources.insert_or_assign(std::string(key.key), source);
    }
  }
}

std::map<std::string, std::string> effect_size_entries(const EffectSizes& sizes) {
  std::map<std::string, std::string> entries;
  for (const EffectSizeKey& key : kKeys) {
    if (is_without_entry(key, sizes)) continue;
    const std::string name = full_name(key);
    entries[name] = fmt::format("{:.17g}", key.get(sizes));
    const auto source = sizes.sources.find(key.key);
    if (const Shape shape = sizes.shape_of(key.key); shape != Shape::kNormal)
      entries[name + ".distribution"] = to_string(shape);
    entries[name + ".source"] = source == sizes.sources.end() ? std::string(kDefaultSource) : source->second;
  }
  return entries;
}

std::vector<Term> unstated_effects(const EffectSizes& sizes) {
  std::vector<Term> words;
  for (const EffectSizeKey& key : kKeys) {
    if (key.get(sizes) > 0.0 && !sizes.sources.contains(key.key)) words.emplace_back(key.words);
  }
  return words;
}

}  // namespace abcal
