#pragma once

#include <span>
#include <string>
#include <vector>

namespace abcal {

/// The rules by which later points are judged against a frozen baseline: limits in standard deviations of the
/// baseline.
struct ChartRules {
  double shewhart = 0.0;     ///< Single values are within +- this.
  double ewma_weight = 0.2;  ///< Weight of the newest value in the moving average.
  double ewma = 0.0;         ///< The average is within +- this of its own standard deviations.
  /// Half the shift that the sums should detect soonest, plus the possible error of the baseline's mean.
  double cusum_allowance = 0.5;
  double cusum = 0.0;  ///< The sums stay below this.

  /// Limit of the moving average in standard deviations of single values.
  double ewma_edge() const;
};

/// How rarely a chart may be wrong.
struct ChartDemand {
  int baseline_runs = 0;  ///< Runs for centre and standard deviation; at least 3.
  int rules = 1;  ///< Rules that judge each point, each of which may be wrong: properties times three.
  double run_length = 200;  ///< Points between two false alarms, all rules together; > 1.
  /// Share of baselines of this size with which the run length is reached at least.
  double certainty = 0.9;
};

/// The largest distance of one run of a baseline from the mean, in standard deviations of the runs, that
/// chance explains (Grubbs, Technometrics 11, 1969; two-sided).
/// @param significance  probability that a sound baseline has a run beyond it
double outlier_limit(int runs, double significance);

/// Limits that ensure the demanded run length although centre and standard deviation come from few runs: they
/// are widened until the run length, given the baseline's own errors, is reached by the wanted share of
/// baselines (guaranteed conditional performance; Albers and Kallenberg 2004, Gandy and Kvaloy 2013). Rates
/// of false alarms of the rules are added.
/// @throws std::invalid_argument
ChartRules design_rules(const ChartDemand& demand);

/// Points between two false alarms of one property, for a baseline without errors: rates of the rules added.
double false_alarm_run_length(const ChartRules& rules);

/// Points until a lasting shift of the mean, in standard deviations, is seen: by the quickest of the rules.
double detection_run_length(const ChartRules& rules, double shift);

/// One point judged.
struct JudgedValue {
  double z = 0.0;     ///< (value - centre) / standard deviation
  double ewma = 0.0;  ///< In standard deviations of single values.
  double cusum_high = 0.0, cusum_low = 0.0;
  bool shewhart_outside = false, ewma_outside = false, cusum_outside = false;

  bool outside() const { return shewhart_outside || ewma_outside || cusum_outside; }
  /// "single value, moving average, cumulative sum": the rules that it breaks.
  std::string broken() const;
};

/// Initial values of the average and the sums.
struct ChartState {
  double ewma = 0.0, cusum_high = 0.0, cusum_low = 0.0;
};

/// Judges one value and brings the state forward.
JudgedValue judge(const ChartRules& rules, double z, ChartState& state);

}  // namespace abcal
