#pragma once

#include <optional>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/noise_search.h"

namespace abcal {

/// An effect_fit() with what it was made of, for a fit that goes on from it (tray_fit.h).
struct EffectSolution {
  EffectFit fit;
  std::optional<EffectModel> model;     ///< At its solution with white noise. It reads the readings given.
  std::vector<AssumedNoise> noises;     ///< The probable ones.
  std::vector<double> weights;          ///< Their posterior probabilities.
  std::vector<double> log_likelihoods;  ///< Of the readings, at each of them.
  WhiteFound white;
};

/// As effect_fit(). The readings must outlive the solution.
EffectSolution solve_effects(std::span<const EffectReading> readings, const EffectFitOptions& options);

}  // namespace abcal
