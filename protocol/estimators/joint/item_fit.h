#pragma once

#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_solution.h"
#include "protocol/estimators/joint/joint_options.h"
#include "protocol/estimators/joint/joint_verdict.h"

namespace abcal {

/// The joint fit of one item's own readings, from which a common fit of several items goes on. The dwells in
/// `data` live in the record. It may be moved, not copied: the solution reads the readings where they lie.
struct ItemFit {
  CollectedReadings data;
  EffectFitOptions options;
  std::optional<EffectSolution> solution;  ///< Absent: `why` says why.
  std::string why;
  JointTests tests;
  std::vector<std::string> hidden;  ///< What the noise process hides of the stage, in words.

  ItemFit() = default;
  ItemFit(ItemFit&&) = default;
  ItemFit& operator=(ItemFit&&) = default;
  ItemFit(const ItemFit&) = delete;
  ItemFit& operator=(const ItemFit&) = delete;
  ~ItemFit() = default;
};

/// @throws UnusableData as collect_readings()
ItemFit fit_item(const RunRecord& record, const JointOptions& options);

}  // namespace abcal
