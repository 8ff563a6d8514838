#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/model/effects.h"

namespace abcal {

/// One pose of the norm fit. The caller scales all readings by one factor, to about 1.
struct NormPose {
  Eigen::Vector3d reading = Eigen::Vector3d::Zero();
  /// Standard uncertainties; absent: `NormModel::common_variance` is the variance of the norm of every pose.
  std::optional<Eigen::Vector3d> u;
  double t = 0.0;                                       ///< -1/2 to 1/2 over the run.
  Eigen::Vector3d came_from = Eigen::Vector3d::Zero();  ///< As in ItemPoint.
  /// Direction of the specific force in the axes of the mount, of length 1, as it is stated. The poses of a
  /// fit have it all or none.
  std::optional<Eigen::Vector3d> up{};
};

/// Assumptions of the norm fit.
struct NormModel {
  EffectSizes sizes;         ///< Sizes of the item's effects to be estimated; zero: left out.
  bool drift = true;         ///< false: no drift of offset and sensitivity.
  bool nonlinearity = true;  ///< false: k2 and k3 are zero exactly.
  /// Standard deviation from 90 degrees of the angles between the item's axes, radian; 0: not known.
  double orthogonality = 0.0;
  double common_variance = 0.0;  ///< Added to the variance of every pose's norm.
  /// Variance of a stated direction against the readings, about either axis across it (radian squared); that
  /// of stated uncertainties of the readings is added. Above 0 where directions are stated.
  double turn_variance = 0.0;
  /// Factor of the weights that `common_variance` gives; the covariance of an orientation takes it into
  /// account.
  double norm_weight = 1.0;
};

/// Derivatives of the nine intrinsic outputs by the readings of the poses.
using NormGain = Eigen::Matrix<double, 9, Eigen::Dynamic>;

/// Orientation of the item in its mount, from the stated directions of the poses; with it the whole line
/// response is known. Poses of one direction share its error.
struct NormOrientation {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();  ///< Columns: the axes of the fit's gauge in the mount.
  Eigen::Matrix2Xd residual;       ///< For each direction, about two axes across it (radian).
  std::vector<std::size_t> first;  ///< The first pose of each direction.
  // As NormSolution has them for the norm.
  double weighted_squares = 0.0, redundancy = 0.0, scatter_degrees = 0.0;
  /// Covariance of the line response in the axes of the mount, and its parts from the variances of the norm
  /// (with stated uncertainties of the readings) and of the directions.
  Covariance12 covariance, of_norm, of_turn;
};

struct NormSolution {
  Eigen::VectorXd unknowns;  ///< Upper triangle of B (6), offset (3), then the effects of u, v, w, over S_j.
  Eigen::MatrixXd cofactor;  ///< Covariance of the unknowns, if the variances are right.
  Eigen::VectorXd residual;  ///< |a| - 1 of each pose.
  Eigen::VectorXd variance;  ///< Variance of the residual.
  double weighted_squares = 0.0;  ///< Priors and directions included.
  double redundancy = 0.0;        ///< Expectation of the poses' part of weighted_squares.
  /// Degrees of freedom of a variance of the poses that is estimated from the residuals: tr((I - H)^2) with H
  /// the hat matrix, twice the squared mean of that estimate over its variance. Poses - 9 without priors.
  double scatter_degrees = 0.0;
  /// 1 less the leverage of each pose: the part of its variance that its residual shows.
  Eigen::VectorXd free_share;
  /// Expectation of the sum of the products of successive residuals over their standard deviations, if the
  /// readings have white noise: the fit itself makes it negative.
  double successive_products = 0.0;
  double reciprocal_condition = 0.0;
  std::vector<Eigen::Vector3d> direction;

  std::optional<NormOrientation> orientation;  ///< Absent: the directions of the poses are not stated.

  /// The line response in the gauge of the fit: s (upper triangular inverse of B, scaled) and offset. With an
  /// orientation in the axes of the mount.
  Eigen::Matrix3d line_sensitivity;
  Eigen::Vector3d line_offset;
  /// s_u, s_v, s_w, phi_uv, phi_vw, phi_wu (degree), O_u, O_v, O_w of the line response.
  Eigen::Matrix<double, 9, 1> intrinsic;
  Covariance9 covariance;
  Covariance9 covariance_of_poses;  ///< The part from the variances of the poses.
  std::vector<NormEffectShare>
      shares;     ///< The rest of its diagonal: effects and the angles between the axes.
  NormGain gain;  ///< Derivative of `intrinsic` by the readings: 9 x 3 n, u, v, w of each pose.
};

/// Weighted least squares of |B (l - O)| = 1, with l the readings free of the effects of the item
/// (protocol/model/effects.h), by Gauss-Newton. Derivatives are exact but for products of two effects (a
/// hundredth of a hundredth at k2 = k3 = 1e-2), the model is exact. Where directions d are stated, the turn Q
/// of the mount is unknown as well, and Q B (l - O) has no part across the mean of the poses of each d.
/// @param from  unknowns of an earlier solution of the same poses or a part of them; empty: none
/// @throws UnusableData the poses do not determine the unknowns, or the fit does not converge
NormSolution solve_norm(std::span<const NormPose> poses, const NormModel& model,
                        const Eigen::VectorXd& from = {});

/// An unknown of an effect of the item; each output has one.
struct NormUnknown {
  std::string_view key;  ///< Key of its size in the bench file.
  double prior = 0.0;    ///< Standard deviation.
};
/// The unknowns of a model, in the order in which NormSolution::unknowns has them for u, then for v and w.
std::vector<NormUnknown> norm_unknowns(const NormModel& model);

/// The reading at a pose of a known direction (unit: g_loc), and the nine intrinsic outputs, as the model has
/// them. @param unknowns  as in NormSolution
Eigen::Vector3d norm_reading(const NormPose& pose, const Eigen::Vector3d& direction,
                             const Eigen::VectorXd& unknowns, const NormModel& model);
Eigen::Matrix<double, 9, 1> norm_outputs(const Eigen::VectorXd& unknowns, const NormModel& model);
/// The sensitivities of the line response in the gauge of the fit.
Eigen::Matrix3d norm_line_sensitivity(const Eigen::VectorXd& unknowns, const NormModel& model);

/// The six unknowns of B of an item with these sensitivities and angles between its axes.
/// @param intrinsic  s_u, s_v, s_w, phi_uv, phi_vw, phi_wu (degree)
Eigen::Matrix<double, 6, 1> norm_triangle(const Eigen::Matrix<double, 6, 1>& intrinsic);

/// Fills `came_from` of the poses, in the order given: the sign of the change of each reading, 0 where the
/// change is below five times its uncertainty.
void find_directions(std::vector<NormPose>& poses);

}  // namespace abcal
