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

}  // namespace abcal
