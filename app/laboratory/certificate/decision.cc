#include "app/laboratory/certificate/decision.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "app/results/estimates/report_data.h"
#include "protocol/uncertainty/normal_probability.h"

namespace abcal {
namespace {

/// Distance from the nearest limit, positive inside.
double distance_inside(const SpecificationLimit& limit, double value) {
  double distance = std::numeric_limits<double>::infinity();
  if (limit.lower) distance = std::min(distance, value - *limit.lower);
  if (limit.upper) distance = std::min(distance, *limit.upper - value);
  return distance;
}

Conformity judge(DecisionKind kind, double distance, double guard) {
  if (distance >= guard) return Conformity::kPass;
  if (kind != DecisionKind::kNonBinary) return Conformity::kFail;
  if (distance >= 0.0) return Conformity::kConditionalPass;
  return distance >= -guard ? Conformity::kConditionalFail : Conformity::kFail;
}

}  // namespace

std::string_view to_string(Conformity conformity) {
  switch (conformity) {
    case Conformity::kPass:
      return "pass";
    case Conformity::kConditionalPass:
      return "conditionalPass";
    case Conformity::kConditionalFail:
      return "conditionalFail";
    case Conformity::kFail:
      break;
  }
  return "fail";
}

Wording describe(const DecisionRule& rule, const Words& words) {
  // A value right at an acceptance limit, of which the limit that matters is r U = 2 r u away.
  const auto in_language = [&](std::string number) {
    if (const std::size_t point = number.find('.'); point != std::string::npos)
      number.replace(point, 1, words.known("."));
    return number;
  };
  const std::string worst =
      in_language(fmt::format("{:.2g}", 100.0 * normal_below(-kCoverageFactor * rule.guard_factor)));
  const std::string factor = in_language(fmt::format("{:.4g}", rule.guard_factor));
  switch (rule.kind) {
    case DecisionKind::kSimple:
      return words(
          "Simple acceptance: the acceptance limits are the tolerance limits (guard band w = 0); pass or "
          "fail. "
          "A value at a limit is accepted with a probability of up to 50 % that the true value is outside.");
    case DecisionKind::kGuardBand:
      return words(
          "Binary decision with acceptance limits inside the tolerance limits by the guard band w = {} U; "
          "pass or "
          "fail. An accepted value lies outside with a probability of at most {} %.",
          factor, worst);
    case DecisionKind::kNonBinary:
      return words(
          "Non-binary decision with acceptance limits inside the tolerance limits by the guard band w = {} "
          "U: pass "
          "inside the acceptance limits, conditional pass between acceptance and tolerance limit, "
          "conditional fail "
          "up to w outside the tolerance limit, fail beyond. A value that passes lies outside with a "
          "probability "
          "of at most {} %, one that passes conditionally of at most 50 %.",
          factor, worst);
    case DecisionKind::kTestUncertaintyRatio:
      break;
  }
  return words(
      "Binary decision with a guard band from the ratio TUR of tolerance to U, w = U max(0, 1.04 - exp(0.38 "
      "ln "
      "TUR - 0.54)); pass or fail. At most 2 % of items are accepted falsely, however the items scatter.");
}

double guard_band(const DecisionRule& rule, const SpecificationLimit& limit, double expanded_uncertainty) {
  if (rule.kind == DecisionKind::kSimple) return 0.0;
  if (rule.kind != DecisionKind::kTestUncertaintyRatio) return rule.guard_factor * expanded_uncertainty;
  if (!limit.lower || !limit.upper) {
    throw std::invalid_argument(
        "a guard band from the test uncertainty ratio needs a lower and an upper limit");
  }
  if (expanded_uncertainty == 0.0) return 0.0;
  const double ratio = (*limit.upper - *limit.lower) / (2.0 * expanded_uncertainty);
  // M. Dobbert, A Guard-Band Strategy for Managing False-Accept Risk, NCSLI 2008: fit to the worst case over
  // all spreads of the items.
  return expanded_uncertainty * std::max(0.0, 1.04 - std::exp(0.38 * std::log(ratio) - 0.54));
}

double conformance_probability(double value, double standard_uncertainty, const std::optional<double>& lower,
                               const std::optional<double>& upper) {
  if (standard_uncertainty == 0.0)
    return (!lower || value >= *lower) && (!upper || value <= *upper) ? 1.0 : 0.0;
  constexpr double kFar = std::numeric_limits<double>::infinity();
  return normal_between(lower ? (*lower - value) / standard_uncertainty : -kFar,
                        upper ? (*upper - value) / standard_uncertainty : kFar);
}

Decision decide(const DecisionRule& rule, const SpecificationLimit& limit, double value,
                double standard_uncertainty, double factor) {
  if (!std::isfinite(value) || !(standard_uncertainty >= 0.0) || !std::isfinite(standard_uncertainty))
    throw std::invalid_argument("no decision on " + limit.quantity + ": it has no value with an uncertainty");
  if (!limit.lower && !limit.upper)
    throw std::invalid_argument("no decision on " + limit.quantity + ": no limit is given");
  Decision decision;
  decision.limit = limit;
  decision.value = value;
  decision.standard_uncertainty = standard_uncertainty;
  decision.coverage_factor = factor;
  decision.expanded_uncertainty = factor * standard_uncertainty;
  const double guard = guard_band(rule, limit, decision.expanded_uncertainty);
  decision.guard_band = guard;
  if (limit.lower) decision.lower_acceptance = *limit.lower + guard;
  if (limit.upper) decision.upper_acceptance = *limit.upper - guard;
  decision.conformance_probability =
      conformance_probability(value, standard_uncertainty, limit.lower, limit.upper);
  decision.conformity = judge(rule.kind, distance_inside(limit, value), guard);
  return decision;
}

}  // namespace abcal
