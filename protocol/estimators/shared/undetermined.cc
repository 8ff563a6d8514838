#include "protocol/estimators/shared/undetermined.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <numbers>
#include <optional>

#include "protocol/model/effects.h"

namespace abcal {
namespace {

constexpr double kLarge = 2e-3;     // relative to S_j: a run that determines its outputs is far below
constexpr double kTooLarge = 2e-2;  // relative to S_j: more than a degree
constexpr double kMost = 0.5;       // share of the variance
constexpr double kDegrees = 180.0 / std::numbers::pi;

std::string output_name(Eigen::Index i) {
  return i < 9 ? fmt::format("s_{}{}", "uvw"[i / 3], "xyz"[i % 3]) : fmt::format("O_{}", "uvw"[i - 9]);
}

/// An effect that shows at the angles of a run, so that a fit can find it.
bool shows_at_angles(const JudgedShare& share, EffectsAre are) {
  if (share.key == "alignment_deg" || share.key == "zero_deg" || share.key == "orthogonality_deg")
    return false;
  // The stage turned as a whole about X: tilt of Z, mean step error and initial turn together.
  return share.key != "initial_turn_deg" || are != EffectsAre::kEstimated;
}

/// Even an estimator that takes the effects as stated finds the curvature.
bool is_estimated(const JudgedShare& share, EffectsAre are) {
  return are == EffectsAre::kEstimated || share.key == "k2" || share.key == "k3";
}

/// Remedies against one effect, as a sentence.
Message remedy(const JudgedShare& share, const EffectSizes& sizes, EffectsAre are) {
  const Message effect = effect_words(share.effect);
  Message words;
  if (share.key == "orthogonality_deg") {
    words = Message("these poses do not determine {unknowns}. Measure nine or more poses", effect);
  } else if (!shows_at_angles(share, are)) {
    words = Message(
        "no angle of a run tells {unknowns} from a turn of the whole stage. Measure the axes (abcal level)",
        effect);
  } else if (!is_estimated(share, are)) {
    words = Message(
        "this estimator takes {unknowns} as stated. Use the joint estimator, which finds it in the readings",
        effect);
  } else {
    words = Message("these angles do not determine {unknowns}. Measure more angles on full circles", effect);
  }
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.key != share.key) continue;
    const Message size = key.unit == "1" ? Message("{number:.2g}", key.get(sizes))
                                         : Message("{number:.2g} {unit}", key.get(sizes), key.unit);
    words = Message("{advice}, or state a smaller [{section}] {key} with its source (it is {size})", words,
                    key.section, key.key, size);
  }
  return words;
}

/// Outputs whose uncertainty has one cause.
struct Outputs {
  std::vector<std::string> names;
  double worst = 0.0;  ///< Relative to S_j, or in radian.

  void add(const JudgedOutput& output, double u) {
    names.push_back(output.name);
    worst = std::max(worst, u);
  }
  /// "s_ux, s_uy are known to 0.004 of the sensitivity only: " and what to do
  Message words(bool angles, const Message& advice) const {
    const std::string all = fmt::format("{}", fmt::join(names, ", "));
    const bool one = names.size() == 1;
    if (angles && one)
      return {"{outputs} is known to {limit:.2g} degrees only: {advice}", all, worst * kDegrees, advice};
    if (angles)
      return {"{outputs} are known to {limit:.2g} degrees only: {advice}", all, worst * kDegrees, advice};
    if (one)
      return {"{outputs} is known to {limit:.1g} of the sensitivity only: {advice}", all, worst, advice};
    return {"{outputs} are known to {limit:.1g} of the sensitivity only: {advice}", all, worst, advice};
  }
};

/// Place of the effect that gives most of the variance of an output; absent: the readings do.
std::optional<std::size_t> cause_of(const JudgedOutput& output) {
  double of_all = 0.0;
  std::size_t largest = 0;
  for (std::size_t k = 0; k < output.shares.size(); ++k) {
    of_all += output.shares[k].variance;
    if (output.shares[k].variance > output.shares[largest].variance) largest = k;
  }
  const double variance = output.quantity.standard_uncertainty * output.quantity.standard_uncertainty;
  if (!(of_all > kMost * variance)) return std::nullopt;
  return largest;
}

}  // namespace

std::vector<Undetermined> undetermined_outputs(std::span<const JudgedOutput> outputs,
                                               const EffectSizes& sizes, EffectsAre are) {
  // By cause: the effects in their order, then the readings; angles apart.
  const std::size_t effects = outputs.empty() ? 0 : outputs.front().shares.size();
  std::vector<std::array<Outputs, 2>> by_cause(effects + 1);
  for (const JudgedOutput& output : outputs) {
    const double half = 0.5 * coverage_factor(output.quantity) * output.quantity.standard_uncertainty;
    const double u = half / output.unit;
    if (u >= kLarge) by_cause[cause_of(output).value_or(effects)][output.angle ? 1 : 0].add(output, u);
  }
  std::vector<Undetermined> out;
  for (std::size_t k = 0; k <= effects; ++k) {
    for (const bool angles : {false, true}) {
      const Outputs& one = by_cause[k][angles ? 1 : 0];
      if (one.names.empty()) continue;
      const bool too_large = one.worst > kTooLarge;
      if (k == effects) {
        out.push_back({one.words(angles, Message("the readings scatter too much, or are too few to show "
                                                 "their scatter. Measure more of them, or average longer")),
                       too_large});
        continue;
      }
      const JudgedShare& share = outputs.front().shares[k];
      const bool could_be_found = shows_at_angles(share, are) && is_estimated(share, are);
      out.push_back({one.words(angles, remedy(share, sizes, are)), could_be_found || too_large});
    }
  }
  return out;
}

std::vector<JudgedOutput> judged_outputs(const CalibrationResult& result, std::span<const EffectShare> shares,
                                         const Eigen::Vector3d& unit) {
  std::vector<JudgedOutput> out;
  for (Eigen::Index i = 0; i < 12; ++i) {
    const auto row = static_cast<std::size_t>(i < 9 ? i / 3 : i - 9);
    JudgedOutput& output = out.emplace_back();
    output.name = output_name(i);
    output.quantity =
        i < 9 ? (*result.sensitivity_matrix)[row][static_cast<std::size_t>(i % 3)] : result.offset[row];
    output.unit = unit(static_cast<Eigen::Index>(row));
    for (const EffectShare& share : shares)
      output.shares.push_back({share.effect, share.key, share.covariance(i, i)});
  }
  return out;
}

}  // namespace abcal
