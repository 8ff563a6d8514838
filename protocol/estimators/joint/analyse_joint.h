#pragma once

#include "protocol/estimators/joint/joint_options.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The joint estimator (docs/joint_estimator.md) for a run of one item: the result that analyse_tray() gives
/// a tray of one. The line response of the item, with every effect of protocol/model/effects.h that the
/// record's sizes give a width as an unknown of one fit. The sensitivity matrix of the result is, as
/// everywhere, the one at rest in the LGCS at the default orientation (already tilted with Z). `type_a` of a
/// result is the part of its posterior variance that comes from the readings' noise, `type_b` the part that
/// comes from the priors.
///
/// Weights are 1/u_mean^2; where a dwell has none, or zero, the noise of each accelerometer is estimated from
/// the residuals of the fit, and chi2 is absent. Dwells with kFlagClipped, kFlagStuck or kFlagNotFinite are
/// left out and counted in the notes.
/// @throws UnusableData a reading that is not finite without its flag; an experiment number that is not 1, 2
/// or
/// 3
CalibrationResult analyse_joint(const RunRecord& record, const JointOptions& options = {});

}  // namespace abcal
