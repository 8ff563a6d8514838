#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// What keeps outputs from being determined: the effect, and what to add, in words.
struct Undetermined {
  std::string words;
  bool doubtful = false;  ///< The result is; else it is worth a note.
};

/// Who finds the effects.
enum class EffectsAre {
  kEstimated,  ///< The fit, in the readings: what it knows little of, these angles do not show.
  kStated,     ///< Nobody, but k2 and k3: the estimator takes the sizes as they are stated.
};

/// Outputs of which the readings say little: whose standard uncertainty is large and mostly that of effects.
/// A turn of the whole stage (alignment, mean step errors, initial turns together) no angle of a run shows:
/// it is known as well as it is stated, and a coarse statement is worth a note up to 2 % of the sensitivity.
/// @param unit  S_j: R, as the covariances
std::vector<Undetermined> undetermined_outputs(std::span<const EffectShare> shares,
                                               const Covariance12& covariance, const Eigen::Vector3d& unit,
                                               const EffectSizes& sizes, EffectsAre are);

}  // namespace abcal
