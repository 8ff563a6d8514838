#include "protocol/plan/run_config.h"

#include "drivers/text/names.h"

namespace abcal {

constexpr auto kAxesOrders =
    names<AxesOrder>({{AxesOrder::kXThenZ, "x then z"}, {AxesOrder::kTogether, "together"}});

std::string_view to_string(AxesOrder order) {
  return kAxesOrders.of(order);
}

std::optional<AxesOrder> axes_order_named(std::string_view word) {
  return kAxesOrders.value(word);
}

std::string to_string(const Problem& problem) {
  std::string text = problem.where;
  if (!problem.found.empty()) text.append(": found ").append(problem.found);
  if (!problem.required.empty())
    text.append(problem.found.empty() ? ": " : "; required: ").append(problem.required);
  return text;
}

std::string list_of(const std::vector<Problem>& problems) {
  std::string text;
  for (const Problem& problem : problems) {
    text += "\n  " + to_string(problem);
    if (!problem.excerpt.empty()) text += "\n      " + problem.excerpt;
    if (!problem.excerpt.empty() && problem.column > 0)
      text += "\n      " + std::string(problem.column - 1, ' ') + "^";
    if (!problem.corrected.empty()) text += "\n      " + problem.corrected + "   <- as it may be meant";
  }
  return text;
}

}  // namespace abcal
