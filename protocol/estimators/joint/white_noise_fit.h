#pragma once

#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/step_strategy.h"

namespace abcal {

struct WhiteNoiseFit {
  Minimum minimum;
  double reciprocal_condition = 0.0;  ///< Square root of that of the scaled normal matrix at the minimum.
};

/// Takes the model to its least-squares solution with white noise of the uncertainties given; the step errors
/// without memory are eliminated. The signs for the hysteresis are those of the solution.
WhiteNoiseFit fit_with_white_noise(EffectModel& model);

}  // namespace abcal
