#pragma once

#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_solution.h"
#include "protocol/estimators/joint/joint_options.h"
#include "protocol/estimators/joint/joint_verdict.h"

namespace abcal {

/// The joint fit of one item's own readings, from which a common fit of several items continues. The record
/// owns the dwells in `data`. It may be moved, not copied: the solution refers to the readings in `data`.
struct ItemFit {
  CollectedReadings data;
  EffectFitOptions options;
  std::optional<EffectSolution> solution;  ///< Absent: `why` gives the reason.
  Message why;
  JointTests tests;
  std::vector<Message> hidden;  ///< Stage errors that the noise process hides, in words.

  ItemFit() = default;
  ItemFit(ItemFit&&) = default;
  ItemFit& operator=(ItemFit&&) = default;
  ItemFit(const ItemFit&) = delete;
  ItemFit& operator=(const ItemFit&) = delete;
  ~ItemFit() = default;
};

/// Options of the fit of these readings.
/// @param sizes  those of the record
EffectFitOptions fit_options(const CollectedReadings& data, const EffectSizes& sizes,
                             const JointOptions& options);

/// @throws UnusableData as collect_readings()
ItemFit fit_item(const RunRecord& record, const JointOptions& options);

}  // namespace abcal
