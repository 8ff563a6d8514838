#pragma once

#include <optional>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/noise_search.h"

namespace abcal {

/// An effect_fit() with its intermediate results, for a fit that continues from it (measurement_fit.h).
struct EffectSolution {
  EffectFit fit;
  std::optional<EffectModel> model;     ///< Model at the solution with white noise; refers to the readings.
  std::vector<AssumedNoise> noises;     ///< The probable noises.
  std::vector<double> weights;          ///< Their posterior probabilities.
  std::vector<double> log_likelihoods;  ///< Log-likelihoods of the readings at each noise.
  WhiteFound white;
};

/// As effect_fit(). The readings must outlive the solution.
EffectSolution solve_effects(std::span<const EffectReading> readings, const EffectFitOptions& options);

}  // namespace abcal
