#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/uncertainty/analysis_of_variance.h"

namespace abcal {

/// One of the nine properties that do not depend on mounting, over the runs of a campaign.
struct CampaignProperty {
  std::string name;  ///< "s_u", ... as kIntrinsicSymbols
  std::string unit;
  /// Mean, spread between the runs, and the repeatability within them (root mean square of their type A).
  RunSpread spread;
  double type_a = 0.0;  ///< Type A of the mean: spread between runs, or the larger type A within runs.
  /// Type B uncertainty of the mean: the runs were measured on one stage, whose errors are the same each
  /// time.
  double type_b = 0.0;
  double standard_uncertainty = 0.0;
  double degrees_of_freedom = 0.0;  ///< Effective (Welch and Satterthwaite): type A has runs - 1.
  double coverage_factor = 0.0;     ///< Student's t for 95 % at these degrees of freedom.
  double expanded_uncertainty() const { return coverage_factor * standard_uncertainty; }
};

/// The mean of several runs of one accelerometer.
struct CampaignSummary {
  std::string estimator;
  int runs = 0;
  std::vector<CampaignProperty> properties;  ///< Nine, or empty: then `why` gives the reason.
  std::string why;
};

/// @param results  of one estimator, one for each run, in the same response unit
CampaignSummary summarise_campaign(std::span<const CalibrationResult> results);

}  // namespace abcal
