#pragma once

#include <Eigen/Core>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// What the voltmeter of an item with voltage outputs adds to the uncertainty. No angle of a run tells its
/// gain from the item's sensitivity, nor its offset from the item's, so that both are added to a finished
/// result. The gain is one unknown for the three outputs (one voltmeter reads them all), the offset one for
/// each of them.
struct VoltmeterShare {
  Covariance12 gain = Covariance12::Zero();    ///< Of s row by row and O, R^2 (s in R/g_loc).
  Covariance12 offset = Covariance12::Zero();  ///< Likewise.
};

/// @param s  R/g_loc, rows u v w
/// @param o  offsets, R
VoltmeterShare voltmeter_share(const Eigen::Matrix3d& s, const Eigen::Vector3d& o, const EffectSizes& sizes);

/// The part of the gain for one standard uncertainty of it, in the order of Covariance12.
Eigen::Matrix<double, 12, 1> effect_of_gain(const Eigen::Matrix3d& s, const Eigen::Vector3d& o,
                                            const EffectSizes& sizes);

/// Whether one voltmeter reads two items: the gain of both is a value of the same calibration of the
/// register, which names one instrument. Its error is common to them then.
bool share_voltmeter(const EffectSizes& a, const EffectSizes& b);

/// Whether `sizes` state anything of the voltmeter.
bool states_voltmeter(const EffectSizes& sizes);

/// Adds it to the type B of every output, to the covariances and to the model equation of `result`, which may
/// be that of any estimator. Effective degrees of freedom follow (Welch-Satterthwaite; what is stated has
/// infinitely many).
void add_voltmeter(const EffectSizes& sizes, CalibrationResult& result);

}  // namespace abcal
