#include "protocol/estimators/shared/undetermined.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace abcal {
namespace {

constexpr double kLarge = 2e-3;     // relative to S_j: no run that determines its outputs comes near
constexpr double kTooLarge = 2e-2;  // relative to S_j: more than a degree
constexpr double kMost = 0.5;       // share of the variance

std::string output_name(Eigen::Index i) {
  return i < 9 ? fmt::format("s_{}{}", "uvw"[i / 3], "xyz"[i % 3]) : fmt::format("O_{}", "uvw"[i - 9]);
}

/// Remedies against one effect, as a sentence.
std::string remedy(const EffectShare& share, const EffectSizes& sizes, bool shown_by_angles, EffectsAre are) {
  std::string words;
  if (!shown_by_angles) {
    words = fmt::format(
        "no angle of a run tells {} from a turn of the whole stage. Measure the axes (abcal level)",
        share.effect);
  } else if (are == EffectsAre::kStated && share.key != "k2" && share.key != "k3") {
    words = fmt::format(
        "this estimator takes {} as stated. Use the joint estimator, which finds it in the readings",
        share.effect);
  } else {
    words =
        fmt::format("these angles do not determine {}. Measure more angles on full circles", share.effect);
  }
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.key != share.key) continue;
    words +=
        fmt::format(", or state a smaller [{}] {} with its source (it is {:.2g}{}{})", key.section, key.key,
                    key.get(sizes), key.unit == "1" ? "" : " ", key.unit == "1" ? "" : key.unit);
  }
  return words;
}

}  // namespace

std::vector<Undetermined> undetermined_outputs(std::span<const EffectShare> shares,
                                               const Covariance12& covariance, const Eigen::Vector3d& unit,
                                               const EffectSizes& sizes, EffectsAre are) {
  struct Outputs {
    std::vector<std::string> names;
    double worst = 0.0;
  };
  std::vector<Outputs> of_effect(shares.size());
  for (Eigen::Index i = 0; i < 12; ++i) {
    const double u = std::sqrt(covariance(i, i)) / unit(i < 9 ? i / 3 : i - 9);
    if (!(u >= kLarge)) continue;
    double of_all = 0.0;
    std::size_t largest = 0;
    for (std::size_t k = 0; k < shares.size(); ++k) {
      of_all += shares[k].covariance(i, i);
      if (shares[k].covariance(i, i) > shares[largest].covariance(i, i)) largest = k;
    }
    if (!(of_all > kMost * covariance(i, i))) continue;  // the noise of the readings
    of_effect[largest].names.push_back(output_name(i));
    of_effect[largest].worst = std::max(of_effect[largest].worst, u);
  }
  std::vector<Undetermined> out;
  for (std::size_t k = 0; k < shares.size(); ++k) {
    const Outputs& outputs = of_effect[k];
    if (outputs.names.empty()) continue;
    // The stage turned as a whole about X: tilt of Z, mean step error and initial turn together.
    const bool of_orientation = shares[k].key == "alignment_deg" || shares[k].key == "zero_deg" ||
                                (shares[k].key == "initial_turn_deg" && are == EffectsAre::kEstimated);
    const bool shown_by_angles = !of_orientation;
    const bool could_be_found = shown_by_angles && are == EffectsAre::kEstimated;
    out.push_back({fmt::format("{} {} known to {:.1g} of the sensitivity only: {}",
                               fmt::join(outputs.names, ", "), outputs.names.size() == 1 ? "is" : "are",
                               outputs.worst, remedy(shares[k], sizes, shown_by_angles, are)),
                   could_be_found || outputs.worst > kTooLarge});
  }
  return out;
}

}  // namespace abcal
