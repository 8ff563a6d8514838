#pragma once

#include <Eigen/Core>
#include <span>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// Contribution of the voltmeter of an item with voltage outputs to the uncertainty. No angle of a run
/// separates its gain from the item's sensitivity, or its offset from the item's, so that both are added to a
/// finished result. The gain is one unknown for the three outputs (one voltmeter reads them all), the offset
/// one for each of them.
struct VoltmeterShare {
  Covariance12 gain = Covariance12::Zero();    ///< For s row by row and O, R^2 (s in R/g_loc).
  Covariance12 offset = Covariance12::Zero();  ///< Likewise.
};

/// @param s  R/g_loc, rows u v w
/// @param o  offsets, R
VoltmeterShare voltmeter_share(const Eigen::Matrix3d& s, const Eigen::Vector3d& o, const EffectSizes& sizes);

/// Change of the outputs for one standard uncertainty of the gain, in the order of Covariance12.
Eigen::Matrix<double, 12, 1> effect_of_gain(const Eigen::Matrix3d& s, const Eigen::Vector3d& o,
                                            const EffectSizes& sizes);

/// Whether one voltmeter reads two items: the gain of both is from the same calibration in the register,
/// which names one instrument. Its error is then common to them.
bool share_voltmeter(const EffectSizes& a, const EffectSizes& b);

/// The result of an item, and the sizes that are stated with it.
struct ReadItem {
  const CalibrationResult* result;
  const EffectSizes* sizes;
};
/// Adds the gain of a voltmeter that reads several items to the covariance of their outputs: it is not an
/// unknown of the fit, but common to them. Of one item it is in the covariance already.
/// @param items       of one fit, each with its voltmeter
/// @param covariance  of the outputs, 12 for each item
void add_shared_voltmeters(std::span<const ReadItem> items, Eigen::MatrixXd& covariance);

/// Whether `sizes` state a gain or an offset of the voltmeter.
bool states_voltmeter(const EffectSizes& sizes);

/// Adds the voltmeter to the type B of every output, to the covariances and to the model equation of `result`
/// of any estimator. Effective degrees of freedom follow (Welch-Satterthwaite; stated values have infinitely
/// many).
void add_voltmeter(const EffectSizes& sizes, CalibrationResult& result);

}  // namespace abcal
