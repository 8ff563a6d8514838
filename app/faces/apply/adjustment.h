#pragma once

#include <Eigen/Core>

#include "app/results/export/constants.h"
#include "drivers/instrument/correction_registers.h"

namespace abcal {

/// By how much an output differs from the acceleration along its axis: output = (1 + gain) a + offset, in the
/// output unit, and in the axes of the constants that it comes from.
struct ResponseErrors {
  Eigen::Matrix3d gain = Eigen::Matrix3d::Zero();  ///< Diagonal: scales; else: cross-axis (1).
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
  Eigen::Matrix3d u_gain = Eigen::Matrix3d::Zero();  ///< Standard uncertainties.
  Eigen::Vector3d u_offset = Eigen::Vector3d::Zero();

  /// Largest error of an output at 1 g in any direction, the uncertainties left out; output unit.
  double worst_at_1g(double unit_mps2) const;
};

/// What the registers of an instrument would have to do, by a result of the output as it was with
/// `in_force`, so that the output is right: the result undoes what is left after `in_force`, which stays in
/// it. What `shape` cannot hold is as in `in_force`: offsets only, or no cross-axis elements.
/// @throws std::invalid_argument if the output is no acceleration, or `in_force` is singular
OutputCorrection composed(const CorrectionConstants& constants, const OutputCorrection& in_force,
                          CorrectionShape shape);

/// What is wrong with the output once `held` is in the registers, by a result of the output as it was with
/// `in_force`. With `held` as `in_force`: what was found.
ResponseErrors errors_with(const CorrectionConstants& constants, const OutputCorrection& in_force,
                           const OutputCorrection& held);

/// What a run of the output as it is says.
ResponseErrors errors_of(const CorrectionConstants& constants);

/// Whether what was measured afterwards is what was predicted: each of the twelve numbers within three
/// standard uncertainties of both and of the steps of the registers.
/// @return the worst of them in words; empty: all are
std::string disagreement(const ResponseErrors& left, const ResponseErrors& predicted,
                         const CorrectionAbility& ability);

/// Whether registers hold the same numbers, to half a step.
bool same_correction(const OutputCorrection& a, const OutputCorrection& b, const CorrectionAbility& ability);

}  // namespace abcal
