#include "app/results/estimates/size_costs.h"

#include <algorithm>
#include <cmath>

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

}  // namespace abcal
