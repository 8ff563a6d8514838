#include "protocol/plan/run_config.h"

namespace abcal {

std::string to_string(const Problem& problem) {
  std::string text = problem.where;
  if (!problem.found.empty()) text.append(": found ").append(problem.found);
  if (!problem.required.empty())
    text.append(problem.found.empty() ? ": " : "; required: ").append(problem.required);
  return text;
}

}  // namespace abcal
