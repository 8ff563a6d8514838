#include "app/commands/apply/adjustment.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "drivers/text/letters.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

/// Numbers that are read back differ by their last digit.
constexpr double kRounding = 1e-6;

Eigen::Matrix3d inverse_of(const Eigen::Matrix3d& matrix, const char* what) {
  const Eigen::FullPivLU<Eigen::Matrix3d> lu(matrix);
  if (!lu.isInvertible())
    throw std::invalid_argument(fmt::format("{} is singular; required: a matrix that can be inverted", what));
  return lu.inverse();
}

}  // namespace

double ResponseErrors::worst_at_1g(double unit_mps2) const {
  const double one_g = kStandardGravity / unit_mps2;
  return (gain.rowwise().norm() * one_g + offset.cwiseAbs()).maxCoeff();
}

OutputCorrection composed(const CorrectionConstants& constants, const OutputCorrection& in_force,
                          CorrectionShape shape) {
  const Eigen::Matrix3d M = constants.matrix_si();
  OutputCorrection wanted = in_force;
  // a = M (A0 (raw - b0) - b) = M A0 (raw - b0 - A0^-1 b)
  wanted.offset += inverse_of(in_force.matrix, "the matrix in force") * constants.b;
  if (shape == CorrectionShape::kFull) wanted.matrix = M * in_force.matrix;
  if (shape == CorrectionShape::kDiagonal) wanted.matrix = M.diagonal().asDiagonal() * in_force.matrix;
  return wanted;
}

ResponseErrors errors_with(const CorrectionConstants& constants, const OutputCorrection& in_force,
                           const OutputCorrection& held) {
  const Eigen::Matrix3d inverse = inverse_of(in_force.matrix, "the matrix in force");
  const Eigen::Matrix3d S = inverse_of(constants.matrix_si(), "the matrix of the result");
  ResponseErrors errors;
  // raw = A0^-1 (S a + b) + b0
  errors.gain = held.matrix * inverse * S - Eigen::Matrix3d::Identity();
  errors.offset = held.matrix * (inverse * constants.b + in_force.offset - held.offset);
  errors.u_gain = constants.u_matrix() / constants.unit_mps2.value_or(1.0);
  errors.u_offset = constants.u_b();
  return errors;
}

ResponseErrors errors_of(const CorrectionConstants& constants) {
  return errors_with(constants, {}, {});
}

std::string disagreement(const ResponseErrors& left, const ResponseErrors& predicted,
                         const CorrectionAbility& ability) {
  constexpr double kCoverage = 3.0;
  std::string words;
  double worst = 1.0;
  const auto look = [&](const std::string& name, double found, double expected, double u) {
    const double ratio = std::abs(found - expected) / (kCoverage * u);
    if (ratio <= worst) return;
    worst = ratio;
    words = fmt::format("{} is {:.3g} afterwards; predicted: {:.3g}, within {:.2g}", name, found, expected,
                        kCoverage * u);
  };
  const double offset_step = ability.offset_step / std::sqrt(12.0);
  const double matrix_step = ability.matrix_step / std::sqrt(12.0);
  for (Eigen::Index j = 0; j < 3; ++j) {
    look(fmt::format("the offset of {}", kPlatterAxes[j]), left.offset[j], predicted.offset[j],
         std::hypot(left.u_offset[j], predicted.u_offset[j], offset_step));
    for (Eigen::Index k = 0; k < 3; ++k) {
      const std::string name =
          j == k ? fmt::format("the scale error of {}", kPlatterAxes[j])
                 : fmt::format("the cross-axis element {}{}", kPlatterAxes[j], kPlatterAxes[k]);
      look(name, left.gain(j, k), predicted.gain(j, k),
           std::max(std::hypot(left.u_gain(j, k), predicted.u_gain(j, k), matrix_step), kRounding));
    }
  }
  return words;
}

bool same_correction(const OutputCorrection& a, const OutputCorrection& b, const CorrectionAbility& ability) {
  const double offset_limit = 0.5 * ability.offset_step + kRounding * a.offset.cwiseAbs().maxCoeff();
  const double matrix_limit = 0.5 * ability.matrix_step + kRounding;
  return (a.offset - b.offset).cwiseAbs().maxCoeff() <= offset_limit &&
         (a.matrix - b.matrix).cwiseAbs().maxCoeff() <= matrix_limit;
}

}  // namespace abcal
