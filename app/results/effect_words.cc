#include "app/results/effect_words.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <vector>

namespace abcal {

std::string default_effects_words(const EffectSizes& sizes) {
  const std::vector<std::string> effects = unstated_effects(sizes);
  if (effects.empty()) return {};
  return fmt::format(
      "not stated, so default sizes are used: {}; state them in [stage_uncertainty] and [item_uncertainty] "
      "of the bench file (docs/effects.md)",
      fmt::join(effects, "; "));
}

std::string uncovered_effects_words(const EffectSizes& sizes) {
  if (sizes.sources.contains("cyclic_drift") || sizes.cyclic_drift > 0.0) return {};
  return "not stated, so not covered: an offset that comes and goes 2 to 6 times in the run, as with air "
         "conditioning; state its size, or 0, as [item_uncertainty] cyclic_drift (docs/effects.md)";
}

}  // namespace abcal
