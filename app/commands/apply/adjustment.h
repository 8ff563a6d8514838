#pragma once

#include <Eigen/Core>

#include "app/results/export/constants.h"
#include "drivers/instrument/correction_registers.h"

namespace abcal {

/// By how much an output differs from the acceleration along its axis: output = (1 + gain) a + offset, in the
/// output unit, and in the axes of the constants from which it is derived.
struct ResponseErrors {
  Eigen::Matrix3d gain = Eigen::Matrix3d::Zero();  ///< Diagonal: scales; else: cross-axis (1).
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
  Eigen::Matrix3d u_gain = Eigen::Matrix3d::Zero();  ///< Standard uncertainties.
  Eigen::Vector3d u_offset = Eigen::Vector3d::Zero();

  /// Largest error of an output at 1 g in any direction, the uncertainties left out; output unit.
  double worst_at_1g(double unit_mps2) const;
};

/// The correction that makes the output right: `in_force` followed by the constants of a result that was
/// measured with `in_force` in the registers. The parts that `shape` cannot hold (the matrix, or its
/// cross-axis elements) are those of `in_force`.
/// @throws std::invalid_argument if the output is not an acceleration, or `in_force` is singular
OutputCorrection composed(const CorrectionConstants& constants, const OutputCorrection& in_force,
                          CorrectionShape shape);

/// Errors of the output once `held` is in the registers, from a result that was measured with `in_force` in
/// them. `held` equal to `in_force` gives the errors as found.
ResponseErrors errors_with(const CorrectionConstants& constants, const OutputCorrection& in_force,
                           const OutputCorrection& held);

/// Errors of the output as a run measured it, the registers unchanged.
ResponseErrors errors_of(const CorrectionConstants& constants);

/// Compares the errors as left with the predicted ones: each of the twelve must agree within three standard
/// uncertainties, in which both results and the steps of the registers are combined.
/// @return the worst disagreement in words; empty: none
std::string disagreement(const ResponseErrors& left, const ResponseErrors& predicted,
                         const CorrectionAbility& ability);

/// Whether registers hold the same numbers, to half a step.
bool same_correction(const OutputCorrection& a, const OutputCorrection& b, const CorrectionAbility& ability);

}  // namespace abcal
