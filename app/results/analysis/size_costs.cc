#include "app/results/analysis/size_costs.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "app/system/text_layout.h"

namespace abcal {

std::vector<DefaultCost> default_costs(const EffectSizes& sizes, const Budget& budget) {
  std::vector<DefaultCost> costs;
  for (const EffectSizeKey& size : effect_size_keys()) {
    if (!(size.get(sizes) > 0.0) || sizes.sources.contains(size.key)) continue;
    OutputVector share = OutputVector::Zero();
    for (const BudgetLine& line : budget.lines) {
      if (line.key != size.key) continue;
      for (int k = 0; k < kStudyOutputs; ++k) share(k) += budget.share(line, k);
    }
    int most = 0;
    const double largest = share.maxCoeff(&most);
    costs.push_back(
        {&size, 1.0 - std::sqrt(1.0 - std::clamp(largest, 0.0, 1.0)), std::string(output_symbol(most))});
  }
  std::ranges::stable_sort(costs, std::greater{}, &DefaultCost::cost);
  return costs;
}

std::string key_of(const EffectSizeKey& size) {
  return fmt::format("[{}] {}", size.section, size.key);
}

std::string default_costs_text(const std::vector<DefaultCost>& costs) {
  constexpr std::size_t kBehindOutput = 26;
  std::string text;
  for (const DefaultCost& each : costs)
    text += wrapped(fmt::format("{}: {}", key_of(*each.size), each.size->words),
                    fmt::format("  {:>5.1f} % of U of {:<6}  ", 100.0 * each.cost, each.output),
                    std::string(kBehindOutput, ' '), kTerminalColumns);
  return text;
}

}  // namespace abcal
