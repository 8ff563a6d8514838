#pragma once

#include <span>
#include <string>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// Hausman's test of the joint fit against the norm fit (NormAgreement).
/// D = (A_N - A_J) V (A_N - A_J)' with the gain matrices of both fits and the covariance V that the model
/// gives the readings: noise, process, step errors, stage and item at their stated sizes. Both fits have the
/// same priors of the item, noise and poses. Only directions in which D is more than 0.05 of the norm fit's
/// own covariance count: in the others both fits use the readings alike, and round-off would decide.
NormAgreement compare_norm_with_joint(std::span<const EffectReading> readings, const EffectFit& fit,
                                      const EffectFitOptions& options);

/// "the stage has errors that the model does not have: norm less joint is ... (probability ...)".
Message words_of(const NormAgreement& test, const std::string& response_unit);

}  // namespace abcal
