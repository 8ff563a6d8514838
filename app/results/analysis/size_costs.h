#pragma once

#include <string>
#include <vector>

#include "protocol/plan/effect_sizes.h"
#include "protocol/uncertainty/budget.h"

namespace abcal {

/// From this cost on a default is worth the work of stating its size.
inline constexpr double kNotableCost = 0.10;

/// An effect whose size is a default that nobody stated, and what this default costs.
struct DefaultCost {
  const EffectSizeKey* size = nullptr;
  /// The part, 0 to 1, by which U of `output` would be smaller if the size were zero: 1 - sqrt(1 - share of
  /// the variance), with the coverage factor and the weights of the fit as they are. The joint fit would
  /// choose other weights, which make U smaller still, so that for it the cost is a least value.
  double cost = 0.0;
  std::string output;  ///< The output of the 18 whose U the default raises most: "s_uy".
};

/// All defaults that the result contains, the most expensive first.
std::vector<DefaultCost> default_costs(const EffectSizes& sizes, const Budget& budget);

/// "[stage_uncertainty] step_deg"
std::string key_of(const EffectSizeKey& size);

/// A line for each default with its cost, its output, its key and its words.
std::string default_costs_text(const std::vector<DefaultCost>& costs);

}  // namespace abcal
