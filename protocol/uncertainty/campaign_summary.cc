#include "protocol/uncertainty/campaign_summary.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "protocol/estimators/checks/comparison.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

CampaignProperty summarise(std::span<const CalibrationResult> results, std::size_t i) {
  CampaignProperty out;
  out.name = kIntrinsicSymbols[i];
  out.unit = intrinsic_property(results.front(), static_cast<Eigen::Index>(i)).unit;
  std::vector<double> values, type_a;
  double squares_b = 0.0;
  for (const CalibrationResult& result : results) {
    const Quantity& q = intrinsic_property(result, static_cast<Eigen::Index>(i));
    values.push_back(q.value);
    type_a.push_back(q.type_a.value_or(0.0));
    squares_b += q.type_b.value_or(0.0) * q.type_b.value_or(0.0);
  }
  out.spread = spread_between_runs(values, type_a);
  const auto runs = static_cast<double>(results.size());
  out.type_a = out.spread.mean_standard_uncertainty;
  out.type_b = std::sqrt(squares_b / runs);
  out.standard_uncertainty = std::hypot(out.type_a, out.type_b);
  const double share = out.type_a / out.standard_uncertainty;
  out.degrees_of_freedom = (runs - 1.0) / (share * share * share * share);
  out.coverage_factor = student_t_above(0.025, out.degrees_of_freedom);
  return out;
}

}  // namespace

CampaignSummary summarise_campaign(std::span<const CalibrationResult> results) {
  CampaignSummary summary;
  summary.runs = static_cast<int>(results.size());
  if (results.size() < 2) {
    summary.why = fmt::format("{} run; a spread between runs needs two or more", results.size());
    return summary;
  }
  summary.estimator = results.front().estimator;
  for (const CalibrationResult& result : results) {
    if (result.verdict == Verdict::kNotUsable) {
      summary.why = fmt::format("{}: not usable: {}", result.source, result.why);
    } else if (result.response_unit != results.front().response_unit) {
      summary.why = fmt::format("{} is in {}, {} in {}", result.source, result.response_unit,
                                results.front().source, results.front().response_unit);
    }
    for (std::size_t i = 0; i < kIntrinsicSymbols.size() && summary.why.empty(); ++i) {
      const Quantity& q = intrinsic_property(result, static_cast<Eigen::Index>(i));
      if (!std::isfinite(q.value) || !(q.type_a.value_or(0.0) > 0.0))
        summary.why = fmt::format("{} does not give {} with its type A uncertainty", result.source,
                                  kIntrinsicSymbols[i]);
    }
    if (!summary.why.empty()) return summary;
  }
  for (std::size_t i = 0; i < kIntrinsicSymbols.size(); ++i) {
    summary.properties.push_back(summarise(results, i));
  }
  return summary;
}

}  // namespace abcal
