#include "app/laboratory/certificate/decision.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "app/results/analysis/report_data.h"
#include "drivers/text/names.h"
#include "protocol/uncertainty/normal_probability.h"

namespace abcal {
namespace {

/// Limits within which a value lies. With a place (a power of ten) they are rounded to it, towards the
/// inside, as a value of that place is.
struct Interval {
  std::optional<double> lower, upper;

  static Interval of(const SpecificationLimit& limit, double guard, const std::optional<int>& place) {
    Interval interval;
    // Far below one digit: of 0.98 + 0.00012 the sum in binary is not 0.98012.
    constexpr double kOfOneDigit = 1e-6;
    const double digit = place ? std::pow(10.0, *place) : 0.0;
    const auto inside = [&](double bound, double towards) {
      if (!place) return bound;
      const double digits = bound / digit;
      return (towards > 0.0 ? std::ceil(digits - kOfOneDigit) : std::floor(digits + kOfOneDigit)) * digit;
    };
    if (limit.lower) interval.lower = inside(*limit.lower + guard, 1.0);
    if (limit.upper) interval.upper = inside(*limit.upper - guard, -1.0);
    return interval;
  }

  /// @param slack  half a digit of values that have a place
  bool contains(double value, double slack) const {
    return (!lower || value >= *lower - slack) && (!upper || value <= *upper + slack);
  }
};

Conformity judge(const DecisionRule& rule, const Decision& decision, const std::optional<int>& place) {
  const double slack = place ? 0.5 * std::pow(10.0, *place) : 0.0;
  const auto is_within = [&](double guard) {
    return Interval::of(decision.limit, guard, place).contains(decision.value, slack);
  };
  if (is_within(decision.guard_band)) return Conformity::kPass;
  if (rule.kind != DecisionKind::kNonBinary) return Conformity::kFail;
  if (is_within(0.0)) return Conformity::kConditionalPass;
  return is_within(-decision.guard_band) ? Conformity::kConditionalFail : Conformity::kFail;
}

/// A number that rounded_value() wrote.
double printed_number(const std::string& text) {
  double number = std::numeric_limits<double>::quiet_NaN();
  std::from_chars(text.data(), text.data() + text.size(), number);
  return number;
}

Decision decide_at(const DecisionRule& rule, const SpecificationLimit& limit, double value,
                   const std::pair<double, double>& expanded_and_factor, const std::optional<int>& place) {
  const auto [expanded, factor] = expanded_and_factor;
  if (!std::isfinite(value) || !(expanded >= 0.0) || !std::isfinite(expanded))
    throw std::invalid_argument("no decision on " + limit.quantity + ": it has no value with an uncertainty");
  if (!limit.lower && !limit.upper)
    throw std::invalid_argument("no decision on " + limit.quantity + ": no limit is given");
  Decision decision;
  decision.stated = decision.limit = limit;
  decision.value = value;
  decision.standard_uncertainty = expanded / factor;
  decision.coverage_factor = factor;
  decision.expanded_uncertainty = expanded;
  decision.guard_band = guard_band(rule, limit, expanded);
  const Interval acceptance = Interval::of(limit, decision.guard_band, place);
  decision.lower_acceptance = acceptance.lower;
  decision.upper_acceptance = acceptance.upper;
  decision.conformance_probability =
      conformance_probability(value, decision.standard_uncertainty, limit.lower, limit.upper);
  decision.conformity = judge(rule, decision, place);
  return decision;
}

constexpr auto kConformities = names<Conformity>({{Conformity::kPass, "pass"},
                                                  {Conformity::kConditionalPass, "conditionalPass"},
                                                  {Conformity::kConditionalFail, "conditionalFail"},
                                                  {Conformity::kFail, "fail"}});

}  // namespace

std::string_view to_string(Conformity conformity) {
  return kConformities.of(conformity, "fail");
}

Wording describe(const DecisionRule& rule, const Words& words) {
  // A value right at an acceptance limit, of which the limit that matters is r U = 2 r u away.
  const auto in_language = [&](std::string number) {
    if (const std::size_t point = number.find('.'); point != std::string::npos)
      number.replace(point, 1, words(".").text);
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
          "Binary decision with acceptance limits inside the tolerance limits by the guard band w = "
          "{guard_band} U; "
          "pass or "
          "fail. An accepted value lies outside with a probability of at most {risk} %.",
          factor, worst);
    case DecisionKind::kNonBinary:
      return words(
          "Non-binary decision with acceptance limits inside the tolerance limits by the guard band w = "
          "{guard_band} "
          "U: pass "
          "inside the acceptance limits, conditional pass between acceptance and tolerance limit, "
          "conditional fail "
          "up to w outside the tolerance limit, fail beyond. A value that passes lies outside with a "
          "probability "
          "of at most {risk} %, one that passes conditionally of at most 50 %.",
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
  return decide_at(rule, limit, value, {factor * standard_uncertainty, factor}, {});
}

Decision decide_printed(const DecisionRule& rule, const SpecificationLimit& limit,
                        const RoundedValue& printed, double factor) {
  return decide_at(rule, limit, printed_number(printed.value), {printed_number(printed.expanded), factor},
                   printed.place);
}

}  // namespace abcal
