#include "app/laboratory/certificate/decision.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "app/formats/dsi_unit.h"
#include "app/laboratory/certificate/derived.h"
#include "drivers/text/names.h"
#include "protocol/statistics/distributions.h"

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

  /// Whether no value of a range lies within.
  bool is_empty(const QuantityRange& range) const {
    return std::max(lower.value_or(range.least), range.least) >
           std::min(upper.value_or(range.most), range.most);
  }
};

/// The probability to lie inside the limits is largest in their middle and falls to both sides: outside, it
/// is largest at an acceptance limit.
double largest_risk(const Interval& acceptance, const Decision& decision) {
  const auto outside = [&](const std::optional<double>& value) {
    return value ? 1.0 - conformance_probability(*value, decision.standard_uncertainty,
                                                 decision.quantity.degrees_of_freedom, decision.limit.lower,
                                                 decision.limit.upper)
                 : 0.0;
  };
  return std::max(outside(acceptance.lower), outside(acceptance.upper));
}

Conformity judge(const DecisionRule& rule, const Decision& decision, const std::optional<int>& place) {
  if (!decision.risk) return Conformity::kUndecided;
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

constexpr auto kConformities = names<Conformity>({{Conformity::kPass, "pass"},
                                                  {Conformity::kConditionalPass, "conditionalPass"},
                                                  {Conformity::kConditionalFail, "conditionalFail"},
                                                  {Conformity::kFail, "fail"},
                                                  {Conformity::kUndecided, "undecided"}});

}  // namespace

Decision decide_printed(const DecisionRule& rule, const SpecificationLimit& limit, const Quantity& quantity,
                        const RoundedValue& printed) {
  const double value = printed_number(printed.value), expanded = printed_number(printed.expanded),
               factor = coverage_factor(quantity);
  if (!std::isfinite(value) || !(expanded >= 0.0) || !std::isfinite(expanded))
    throw std::invalid_argument("no decision on " + limit.quantity + ": it has no value with an uncertainty");
  if (!limit.lower && !limit.upper)
    throw std::invalid_argument("no decision on " + limit.quantity + ": no limit is given");
  Decision decision;
  decision.stated = decision.limit = limit;
  decision.rule = rule;
  decision.quantity = quantity;
  decision.value = value;
  decision.standard_uncertainty = expanded / factor;
  decision.coverage_factor = factor;
  decision.expanded_uncertainty = expanded;
  decision.guard_band = guard_band(rule, limit, expanded);
  const Interval acceptance = Interval::of(limit, decision.guard_band, printed.place);
  const double in_si = unit_in_dsi(quantity.unit).factor;
  const QuantityRange range = range_of_quantity(limit.quantity, quantity.unit);
  if (!acceptance.is_empty({range.least * in_si, range.most * in_si})) {
    decision.lower_acceptance = acceptance.lower;
    decision.upper_acceptance = acceptance.upper;
    decision.risk = largest_risk(acceptance, decision);
  }
  decision.conformance_probability = conformance_probability(
      value, decision.standard_uncertainty, quantity.degrees_of_freedom, limit.lower, limit.upper);
  decision.conformity = judge(rule, decision, printed.place);
  return decision;
}

std::string_view to_string(Conformity conformity) {
  return kConformities.of(conformity, "fail");
}

Wording describe(const DecisionRule& rule, const Words& words) {
  std::string factor = fmt::format("{:.4g}", rule.guard_factor);
  if (const std::size_t point = factor.find('.'); point != std::string::npos)
    factor.replace(point, 1, words(".").text);
  switch (rule.kind) {
    case DecisionKind::kSimple:
      return words(
          "Simple acceptance: the acceptance limits are the tolerance limits (guard band w = 0); pass or "
          "fail.");
    case DecisionKind::kGuardBand:
      return words(
          "Binary decision with acceptance limits inside the tolerance limits by the guard band w = "
          "{guard_band} U; pass or fail.",
          factor);
    case DecisionKind::kNonBinary:
      return words(
          "Non-binary decision with acceptance limits inside the tolerance limits by the guard band w = "
          "{guard_band} U: pass inside the acceptance limits, conditional pass between acceptance and "
          "tolerance limit, conditional fail up to w outside the tolerance limit, fail beyond.",
          factor);
    case DecisionKind::kTestUncertaintyRatio:
      break;
  }
  return words(
      "Binary decision with a guard band from the ratio TUR of tolerance to U, w = U max(0, 1.04 - exp(0.38 "
      "ln TUR - 0.54)); pass or fail. At most 2 % of items are accepted falsely, however the items scatter.");
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

double conformance_probability(double value, double standard_uncertainty, double degrees_of_freedom,
                               const std::optional<double>& lower, const std::optional<double>& upper) {
  if (standard_uncertainty == 0.0)
    return (!lower || value >= *lower) && (!upper || value <= *upper) ? 1.0 : 0.0;
  constexpr double kFar = std::numeric_limits<double>::infinity();
  return student_t_between(lower ? (*lower - value) / standard_uncertainty : -kFar,
                           upper ? (*upper - value) / standard_uncertainty : kFar, degrees_of_freedom);
}

}  // namespace abcal
