#pragma once

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "protocol/analysis/calibration_result.h"
#include "protocol/uncertainty/campaign.h"

namespace abcal {

/// The runs of one campaign, each with the results of all estimators.
struct CampaignReport {
  struct Run {
    std::filesystem::path path;
    std::vector<CalibrationResult> results;  ///< The same estimators in the same order for every run.
    std::string estimator;                   ///< Whose result is reported.
    const CalibrationResult& result() const;
  };
  std::vector<Run> runs;

  /// Whether the reported result of every run may be used at all.
  bool usable() const;
  /// One summary for each estimator.
  std::vector<CampaignSummary> summaries() const;
};

/// As text: verdicts, then mean, spread and uncertainty of the mean.
std::string campaign_text(const CampaignReport& report, std::FILE* stream);

/// Schema abcal.campaign/1.
nlohmann::ordered_json campaign_json(const CampaignReport& report);

}  // namespace abcal
