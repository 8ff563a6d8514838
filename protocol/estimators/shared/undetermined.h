#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// The effect that keeps outputs from being determined, and the remedy, in words.
struct Undetermined {
  std::string words;
  bool doubtful = false;  ///< True: the result is doubtful; false: a note is sufficient.
};

/// Origin of the effects.
enum class EffectsAre {
  kEstimated,  ///< The fit estimates them; an effect that it hardly determines does not show at these angles.
  kStated,     ///< The estimator takes the sizes as stated, except for k2 and k3.
};

/// Outputs that the readings hardly determine: their standard uncertainty is large, and mostly from effects.
/// No angle of a run shows a turn of the whole stage (alignment, mean step errors, initial turns together):
/// it is known as well as it is stated, and a coarse one causes only a note up to 2 % of the sensitivity.
/// @param unit  S_j: R, as the covariances
std::vector<Undetermined> undetermined_outputs(std::span<const EffectShare> shares,
                                               const Covariance12& covariance, const Eigen::Vector3d& unit,
                                               const EffectSizes& sizes, EffectsAre are);

}  // namespace abcal
