#include "app/results/export/fixed_point.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

namespace abcal {
namespace {

constexpr int kMatrixBits = 30;   // Three products with a difference up to 2^31 stay below 2^63.
constexpr int kReadingBits = 31;  // The difference of reading and offset.
// Readings up to this many g fit if the full scale is not known. Leaves 25 bits for 1 g.
constexpr double kLargestG = 64.0;
constexpr double kLargestShareOfU = 0.1;  // Adds 0.5 % to u.

/// The largest n with value 2^n <= 2^bits.
int shift_for(double value, int bits) {
  return bits - static_cast<int>(std::ceil(std::log2(value)));
}

std::int32_t rounded(double value, int shift) {
  return static_cast<std::int32_t>(std::llround(std::ldexp(value, shift)));
}

/// Least of the three, with 1 g along the axis. Correlations between the elements are left out.
double least_uncertainty(const CorrectionConstants& c, const Eigen::Matrix3d& response_at_g) {
  double least = std::numeric_limits<double>::infinity();
  for (Eigen::Index j = 0; j < 3; ++j) {
    const Eigen::Vector3d of_M = c.u_matrix().row(j).transpose().cwiseProduct(response_at_g.col(j));
    const Eigen::Vector3d of_b = c.M.row(j).transpose().cwiseProduct(c.u_b());
    least = std::min(least, std::hypot(of_M.norm(), of_b.norm()));
  }
  return least;
}

}  // namespace

FixedPoint fixed_point(const CorrectionConstants& c) {
  FixedPoint fixed;
  // Columns: r - b with 1 g along x, y, z.
  const Eigen::Matrix3d response_at_g = c.g_loc_mps2 * c.M.partialPivLu().solve(Eigen::Matrix3d::Identity());
  const double one_g = response_at_g.rowwise().norm().maxCoeff();
  const double offset = c.b.cwiseAbs().maxCoeff();
  fixed.u_mps2 = least_uncertainty(c, response_at_g);
  if (!std::isfinite(one_g + offset) || !(one_g > 0.0)) {
    fixed.why_not = "the constants are not finite";
    return fixed;
  }
  fixed.M_shift = shift_for(c.M.cwiseAbs().maxCoeff(), kMatrixBits);
  const double largest = std::max(c.full_scale.value_or(kLargestG * one_g), one_g) + offset;
  // Not negative: counts of a converter are used unchanged, or shifted to the left.
  fixed.b_shift = std::max(0, shift_for(largest + offset, kReadingBits));
  fixed.largest_reading = std::ldexp(std::ldexp(1.0, kReadingBits) - 1.0, -fixed.b_shift) - offset;
  if (fixed.largest_reading < one_g + offset) {
    fixed.why_not = fmt::format("readings at 1 g, up to {:.3g} {}, do not fit into 32-bit integers",
                                one_g + offset, c.response_unit);
    return fixed;
  }
  Eigen::Matrix3d M;
  Eigen::Vector3d b;
  for (Eigen::Index j = 0; j < 3; ++j) {
    fixed.b[j] = rounded(c.b[j], fixed.b_shift);
    b[j] = std::ldexp(fixed.b[j], -fixed.b_shift);
    for (Eigen::Index k = 0; k < 3; ++k) {
      fixed.M(j, k) = rounded(c.M(j, k), fixed.M_shift);
      M(j, k) = std::ldexp(fixed.M(j, k), -fixed.M_shift);
    }
  }
  const double half_unit = std::ldexp(0.5, -fixed.b_shift);
  for (Eigen::Index j = 0; j < 3; ++j) {
    const double of_M = ((M - c.M).row(j) * response_at_g).norm();
    const double of_b = std::abs(M.row(j).dot(b - c.b));
    const double of_reading = half_unit * M.row(j).lpNorm<1>();
    fixed.error_mps2 = std::max(fixed.error_mps2, of_M + of_b + of_reading);
  }
  if (!(fixed.error_mps2 <= kLargestShareOfU * fixed.u_mps2))
    fixed.why_not = fmt::format(
        "rounding to 32-bit integers makes an error of {:.2g} m/s2 at 1 g; required: at most a tenth of the "
        "standard uncertainty of a corrected reading, which is {:.2g} m/s2",
        fixed.error_mps2, fixed.u_mps2);
  return fixed;
}

}  // namespace abcal
