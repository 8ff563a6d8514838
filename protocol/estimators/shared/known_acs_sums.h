#pragma once

#include <Eigen/Core>
#include <cstddef>

#include "protocol/estimators/shared/known_acs_fit.h"

namespace abcal {

/// Sums of the weighted fit of s and O: over all readings, of a row (x, y, z, 1) of the specific force.
struct KnownAcsSums {
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();                         ///< row' row
  Eigen::Matrix<double, 4, 3> right = Eigen::Matrix<double, 4, 3>::Zero();  ///< row' (r_u, r_v, r_w)

  void add(const Eigen::Vector3d& gravity, const Eigen::Vector3d& reading, double weight) {
    const Eigen::Vector4d row(gravity.x(), gravity.y(), gravity.z(), 1.0);
    const Eigen::Vector4d weighted = weight * row;
    normal.noalias() += weighted * row.transpose();
    right.noalias() += weighted * reading.transpose();
  }
};

/// The fit of these sums.
/// @param readings  how many, for the message
/// @throws std::invalid_argument a sum is not a finite number
/// @throws UnusableData the forces do not determine the four unknowns
KnownAcsFit fit_of_sums(const KnownAcsSums& sums, std::size_t readings);

}  // namespace abcal
