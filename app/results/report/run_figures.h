#pragma once

#include <optional>

#include "app/document/document.h"
#include "app/results/analysis/report_data.h"

namespace abcal {

/// Readings with the fitted curve, and the residuals; of one experiment (1, 2, 3).
Figure response_figure(const ReportData& data, int experiment);

/// Amplitudes of harmonics 2 to 5 of the three experiments.
Figure harmonics_figure(const CalibrationResult& result);

/// Rotation-step errors of the three experiments, as the joint estimator finds them.
Figure step_error_figure(const RunRecord& record, const JointResult& joint);

/// Amplitude relative to rest and phase at each rate of a run at constant rates, with bars of the expanded
/// uncertainty.
Figure rate_response_figure(const MotionResult& motion);

/// How far a result is from an ideal accelerometer, with bars of the expanded uncertainty: s_j from the
/// nominal sensitivity, phi from 90 degrees, O from zero.
/// @param nominal  response to one g_loc, R; nothing: s_j are compared with their mean
Figure deviation_figure(const CalibrationResult& result, std::optional<double> nominal);

}  // namespace abcal
