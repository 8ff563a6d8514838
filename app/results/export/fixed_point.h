#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>

#include "app/results/export/constants.h"

namespace abcal {

/// The constants as 32-bit integers, and how far readings that they correct differ from those of M and b.
///
/// With the reading as R = r 2^b_shift, rounded, the acceleration is a 2^(M_shift + b_shift) = M_fixed (R -
/// b_fixed). The elements of M_fixed are up to 2^30 and those of R - b_fixed up to 2^31, so that products and
/// their sums are exact in 64-bit integers.
struct FixedPoint {
  Eigen::Matrix<std::int32_t, 3, 3> M = Eigen::Matrix<std::int32_t, 3, 3>::Zero();
  Eigen::Matrix<std::int32_t, 3, 1> b = Eigen::Matrix<std::int32_t, 3, 1>::Zero();
  int M_shift = 0;
  int b_shift = 0;
  double largest_reading = 0.0;  ///< Readings up to this magnitude do not overflow; response unit.
  /// Largest error of an axis at 1 g in any direction: rounding of M, b and the reading; m/s2.
  double error_mps2 = 0.0;
  /// Least standard uncertainty of a corrected reading, with 1 g along its axis; m/s2.
  double u_mps2 = 0.0;
  std::string why_not;  ///< Reason why the constants do not fit; empty: they may be used.
};

FixedPoint fixed_point(const CorrectionConstants& constants);

}  // namespace abcal
