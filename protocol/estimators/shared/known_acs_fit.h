#pragma once

#include <Eigen/Core>
#include <limits>
#include <span>

#include "protocol/model/forward_model.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Sensitivity matrix and offset from readings at known specific forces.
struct KnownAcsFit {
  Eigen::Matrix3d sensitivity_matrix = Eigen::Matrix3d::Constant(std::numeric_limits<double>::quiet_NaN());
  Eigen::Vector3d offset = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Inverse of the normal matrix, order x, y, z, constant: the covariance of one accelerometer's (s_j, O_j)
  /// is this matrix where weights are 1/u^2, and sigma^2 times this matrix for weights of 1 and scatter
  /// sigma.
  Eigen::Matrix4d cofactor = Eigen::Matrix4d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Smallest over largest pivot of the normal matrix: the squared scale of the design's reciprocal
  /// condition.
  double reciprocal_condition = 0.0;
};

/// Given the ACS errors the response is linear in (s, O): one weighted 4x4 normal matrix, shared by the three
/// accelerometers, and one solve (paper, section 6; docs/theory/uncertainty.md).
/// @param gravity   specific force (g_loc) seen from the accelerometer at each angle
/// @param readings  r_u, r_v, r_w (R) at the same angles
/// @param weights   one a reading triple; empty: all 1
/// @throws std::invalid_argument sizes differ; a number is not finite; a weight is negative
/// @throws UnusableData the forces do not determine the four unknowns
KnownAcsFit linear_fit_given_acs(std::span<const Eigen::Vector3d> gravity,
                                 std::span<const Eigen::Vector3d> readings,
                                 std::span<const double> weights = {});

/// The same for a record (closing angles left out), with the forces of the forward model under `errors`.
/// Weights: 1 / mean square of u_u, u_v, u_w where every dwell has u_mean greater than zero, else 1.
KnownAcsFit linear_fit_given_acs(const RunRecord& record, const AcsErrors& errors);

/// The same for dwells of experiments 1 to 3 on a perfect stage, all with weight 1: good to 1e-3, enough for
/// derivatives and signs.
KnownAcsFit linear_fit_on_perfect_stage(std::span<const DwellRecord* const> dwells);

}  // namespace abcal
