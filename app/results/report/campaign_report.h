#pragma once

#include <cstdio>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/uncertainty/campaign_summary.h"

namespace abcal {

/// The runs of one campaign for one item, each with the results of all estimators.
struct CampaignReport {
  struct Run {
    std::filesystem::path path;
    std::vector<CalibrationResult> results;  ///< The same estimators in the same order for every run.
    std::string estimator;                   ///< Estimator whose result is reported.
    const CalibrationResult& result() const;
  };
  std::vector<Run> runs;
  std::string title;  ///< "Campaign of 3 runs", and of which item.

  /// Whether the reported result of every run may be used at all.
  bool usable() const;
  /// One summary for each estimator.
  std::vector<CampaignSummary> summaries() const;
};

/// Text for each item: verdicts, then mean, spread and uncertainty of the mean.
std::string campaign_text(std::span<const CampaignReport> items, std::FILE* stream);

/// Schema abcal.campaign/1. Several items have an object each, under `items`.
nlohmann::ordered_json campaign_json(std::span<const CampaignReport> items);

}  // namespace abcal
