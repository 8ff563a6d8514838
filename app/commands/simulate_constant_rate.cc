#include "app/commands/simulate_constant_rate.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "app/commands/study_bar.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {

int simulate_constant_rate(const ConstantRateOptions& options, bool json) {
  const ConstantRateStudy study = with_bar(options, run_constant_rate_study);
  if (json) {
    print_result("{}\n", constant_rate_json(study).dump(2));
  } else {
    print_result("{}", constant_rate_text(study));
  }
  if (study.interrupted) return kExitInterrupted;
  const auto is_met = [](const NamedErrorGroup& each) {
    return !(each.group.limit > 0.0) || each.group.rms_u <= each.group.limit;
  };
  const auto agrees_as_often_as_expected = [](const ConstantRateOutcome& outcome) {
    // 184 to 197 of 200: the distribution is binomial, and skewed.
    const double expected = 0.95 * outcome.pairs;
    const double spread = std::sqrt(0.05 * expected);
    return outcome.agreeing >= expected - 2.0 * spread && outcome.agreeing <= expected + 2.3 * spread;
  };
  const bool all_met = std::ranges::all_of(study.outcomes, [&](const ConstantRateOutcome& outcome) {
    return outcome.failed == 0 && std::ranges::all_of(outcome.groups, is_met) &&
           agrees_as_often_as_expected(outcome);
  });
  return all_met ? kExitDone : kExitFailed;
}

}  // namespace abcal
