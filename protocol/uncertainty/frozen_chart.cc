#include "protocol/uncertainty/frozen_chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>

#include "protocol/statistics/distributions.h"
#include "protocol/uncertainty/run_length.h"

namespace abcal {
namespace {

constexpr int kCentres = 6, kSpreads = 12;  // Baselines that represent all, with equal probability.
constexpr int kHalvings = 24;  // Bisections of an interval of limits: to 1e-5 of a standard deviation.
constexpr double kWidestLimit = 100.0;  // Beyond it nothing would be seen.

/// The true process seen from a baseline of this number of runs: its mean is off by a normal error, its
/// standard deviation by one of chi-squared, independent of each other. Quantiles at equal steps; the run
/// length depends on the size of the shift only, so that one side of the mean represents both.
std::vector<ChartedProcess> processes_seen(int runs) {
  std::vector<ChartedProcess> seen;
  for (int i = 0; i < kCentres; ++i) {
    const double error = normal_quantile(0.5 + 0.5 * (i + 0.5) / kCentres) / std::sqrt(runs);
    for (int j = 0; j < kSpreads; ++j) {
      const double ratio = std::sqrt(chi2_quantile((j + 0.5) / kSpreads, runs - 1) / (runs - 1));
      seen.push_back({error / ratio, 1.0 / ratio});
    }
  }
  return seen;
}

/// Error of the mean of a baseline, in its own standard deviations, that is exceeded in one case of ten
/// (two-sided). Sums with a smaller allowance would accumulate that error.
double mean_is_off_by(int runs) {
  return student_t_above(0.05, runs - 1) / std::sqrt(runs);
}

/// The run length that the wanted share of processes reaches.
double reached_by(double certainty, const std::vector<ChartedProcess>& seen,
                  const std::function<double(const ChartedProcess&)>& run_length) {
  std::vector<double> lengths;
  lengths.reserve(seen.size());
  for (const ChartedProcess& process : seen) lengths.push_back(run_length(process));
  std::sort(lengths.begin(), lengths.end());
  const auto place = static_cast<std::size_t>((1.0 - certainty) * static_cast<double>(lengths.size()));
  return lengths[std::min(place, lengths.size() - 1)];
}

/// The smallest limit with which the run length is reached; run lengths grow with the limit.
double limit_for(double wanted, const std::function<double(double)>& reached) {
  double low = 0.5, high = 4.0;
  while (reached(high) < wanted) {
    low = high;
    high *= 2.0;
    if (high > kWidestLimit)
      throw std::invalid_argument(
          fmt::format("control chart: no limit gives {} points between false alarms; required: more runs in "
                      "the baseline, or a shorter run length",
                      wanted));
  }
  for (int i = 0; i < kHalvings && high - low > 1e-5; ++i) {
    const double middle = 0.5 * (low + high);
    (reached(middle) < wanted ? low : high) = middle;
  }
  return high;
}

}  // namespace

double ChartRules::ewma_edge() const {
  return ewma * std::sqrt(ewma_weight / (2.0 - ewma_weight));
}

double outlier_limit(int runs, double significance) {
  if (runs < 3 || !(significance > 0.0 && significance < 1.0))
    throw std::invalid_argument(fmt::format(
        "outliers of {} runs at {}; required: at least 3 runs, between 0 and 1", runs, significance));
  const double n = runs;
  const double t = student_t_above(significance / (2.0 * n), n - 2.0);
  return (n - 1.0) / std::sqrt(n) * std::sqrt(t * t / (n - 2.0 + t * t));
}

ChartRules design_rules(const ChartDemand& demand) {
  if (demand.baseline_runs < 3 || demand.rules < 1 || !(demand.run_length > 1.0) ||
      !(demand.certainty > 0.0 && demand.certainty < 1.0))
    throw std::invalid_argument(
        fmt::format("control chart: {} runs, {} rules, {} points between false alarms, certainty {}; "
                    "required: at least 3 runs, 1 rule, more than 1 point, a certainty between 0 and 1",
                    demand.baseline_runs, demand.rules, demand.run_length, demand.certainty));
  const std::vector<ChartedProcess> seen = processes_seen(demand.baseline_runs);
  const double each = demand.run_length * demand.rules;
  const auto find = [&](const auto& run_length_with) {
    return limit_for(each, [&](double limit) {
      return reached_by(demand.certainty, seen,
                        [&](const ChartedProcess& process) { return run_length_with(limit, process); });
    });
  };
  ChartRules rules;
  rules.shewhart =
      find([](double limit, const ChartedProcess& process) { return shewhart_run_length(limit, process); });
  rules.ewma = find([&](double limit, const ChartedProcess& process) {
    return ewma_run_length(rules.ewma_weight, limit, process);
  });
  rules.cusum_allowance = 0.5 + mean_is_off_by(demand.baseline_runs);
  rules.cusum = find([&](double limit, const ChartedProcess& process) {
    return cusum_run_length(rules.cusum_allowance, limit, process);
  });
  return rules;
}

double false_alarm_run_length(const ChartRules& rules) {
  return 1.0 /
         (1.0 / shewhart_run_length(rules.shewhart) + 1.0 / ewma_run_length(rules.ewma_weight, rules.ewma) +
          1.0 / cusum_run_length(rules.cusum_allowance, rules.cusum));
}

double detection_run_length(const ChartRules& rules, double shift) {
  const ChartedProcess process{shift, 1.0};
  return std::min({shewhart_run_length(rules.shewhart, process),
                   ewma_run_length(rules.ewma_weight, rules.ewma, process),
                   cusum_run_length(rules.cusum_allowance, rules.cusum, process)});
}

std::string JudgedValue::broken() const {
  std::string words;
  const auto add = [&](bool is_broken, const char* word) {
    if (is_broken) words.append(words.empty() ? "" : ", ").append(word);
  };
  add(shewhart_outside, "single value");
  add(ewma_outside, "moving average");
  add(cusum_outside, "cumulative sum");
  return words;
}

JudgedValue judge(const ChartRules& rules, double z, ChartState& state) {
  state.ewma = rules.ewma_weight * z + (1.0 - rules.ewma_weight) * state.ewma;
  state.cusum_high = std::max(0.0, state.cusum_high + z - rules.cusum_allowance);
  state.cusum_low = std::max(0.0, state.cusum_low - z - rules.cusum_allowance);
  JudgedValue judged{z, state.ewma, state.cusum_high, state.cusum_low, false, false, false};
  judged.shewhart_outside = !(std::abs(z) <= rules.shewhart);
  judged.ewma_outside = !(std::abs(state.ewma) <= rules.ewma_edge());
  judged.cusum_outside = !(std::max(state.cusum_high, state.cusum_low) <= rules.cusum);
  return judged;
}

}  // namespace abcal
