#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/compare/compared_result.h"
#include "app/laboratory/compare/consistent_subset.h"
#include "app/laboratory/compare/random_effects.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/uncertainty/analysis_of_variance.h"
#include "protocol/uncertainty/control_chart.h"

namespace abcal {

struct CompareOptions {
  bool shared_stage = false;  ///< All were measured on one stage: its type B is subtracted.
  bool any_item = false;      ///< Results of different items may be compared.
  std::string group_by;       ///< "day", "stage" or a label of the runs; empty: no groups.
  double ewma_weight = 0.2;
};

/// One result against another.
struct PairComparison {
  std::size_t first = 0;   ///< Position in the list.
  std::size_t second = 1;  ///< Position in the list.
  IntrinsicComparison intrinsic;
  std::optional<RotationBetween> rotation;  ///< Absent where one of the two has no matrix.
  /// Items of one run with a common fit: their common part is subtracted by their covariance.
  bool common_fit = false;
  bool agrees() const { return intrinsic.agrees() && (!rotation || rotation->same_handedness); }
  std::string why;  ///< One sentence.
};

/// One of the nine properties over several results. Absent values could not be determined.
struct PropertySeries {
  std::vector<double> values;  ///< In the order of `order`.
  std::optional<RunSpread> spread;
  std::optional<RandomEffectsMean> random_effects;  ///< In the order of `order`; type B included.
  std::optional<OneWayAnova> anova;
  std::optional<ControlChart> individuals, means, ewma;
};

struct ResultsComparison {
  std::vector<ComparedResult> results;  ///< In the given order, in common units.
  std::array<std::string, 9> units;
  bool shared_subtracted = false;
  /// Each of the others against the first; if that is an outlier, against the first result that is not one.
  std::vector<PairComparison> pairs;
  /// All results of one item together, of the properties that all of them give. Absent for two results, for
  /// items of one run, for more than kMostConsistent, and where no property is given by all.
  std::optional<ConsistentSubset> consistency;
  // From three results on.
  std::vector<std::size_t> order;                ///< Positions by time, or as given if times are not known.
  std::vector<std::string> group_names;          ///< Empty without groups.
  std::vector<std::vector<std::size_t>> groups;  ///< Positions in `results`.
  std::optional<std::array<PropertySeries, 9>> series;  ///< Absent for two.
  std::vector<std::string> notes;

  /// The verdict: that of all results together if they were tested so, else that of every pair; and the same
  /// handedness of all.
  bool agree() const;
};

/// @param results  at least two
/// @throws CompareError one measurement twice, different items, units of different kinds, nothing to group
/// by, a shared stage that
///         cannot be subtracted; std::runtime_error where the numbers do not allow the comparison
ResultsComparison compare_results(std::vector<ComparedResult> results, const CompareOptions& options);

}  // namespace abcal
