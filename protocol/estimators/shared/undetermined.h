#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// The cause that keeps outputs from being determined, and the remedy, in words.
struct Undetermined {
  Message words;
  bool doubtful = false;  ///< True: the result is doubtful; false: a note is sufficient.
};

/// Origin of the effects.
enum class EffectsAre {
  kEstimated,  ///< The fit estimates them; an effect that it hardly determines does not show at these angles.
  kStated,     ///< The estimator takes the sizes as stated, except for k2 and k3.
};

/// The variance that one effect gives to an output.
struct JudgedShare {
  std::string effect;  ///< As in EffectShare.
  std::string key;
  double variance = 0.0;
};

/// An output and the effects in its uncertainty.
struct JudgedOutput {
  std::string name;  ///< "s_ux", "phi_uv"
  Quantity quantity;
  double unit = 1.0;                ///< S_j; of an angle one radian, in the unit of the quantity.
  bool angle = false;               ///< An angle between axes.
  std::vector<JudgedShare> shares;  ///< The same effects in the same order for all outputs.
};

/// The rule of all estimators: outputs that the readings hardly determine. The half of an expanded
/// uncertainty (a standard uncertainty, widened where few residuals show the scatter) from 0.2 % of the
/// sensitivity on is large, for the angle between two axes 2e-3 radian. Where an effect that more angles
/// would show is the largest cause, the result is doubtful. Where it is one that no reading shows, or the
/// scatter of the readings, it is a note up to 2 % (more than a degree). No angle of a run shows a turn of
/// the whole stage (alignment, mean step errors, initial turns together): it is known as well as it is
/// stated.
std::vector<Undetermined> undetermined_outputs(std::span<const JudgedOutput> outputs,
                                               const EffectSizes& sizes, EffectsAre are);

/// The twelve outputs of a result that has a matrix.
/// @param unit  S_j: R, as the covariances
std::vector<JudgedOutput> judged_outputs(const CalibrationResult& result, std::span<const EffectShare> shares,
                                         const Eigen::Vector3d& unit);

}  // namespace abcal
