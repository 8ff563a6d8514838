#include "protocol/estimators/shared/normal_matrix.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace abcal {

void NormalMatrix::compute(Eigen::MatrixXd normal) {
  scale_ = normal.diagonal().cwiseSqrt().cwiseInverse();
  normal = scale_.asDiagonal() * normal * scale_.asDiagonal();
  llt_.compute(normal);
}

bool NormalMatrix::solvable() const {
  return scale_.allFinite() && llt_.info() == Eigen::Success;
}

Eigen::VectorXd NormalMatrix::solve(const Eigen::VectorXd& right) const {
  return scale_.cwiseProduct(llt_.solve(scale_.cwiseProduct(right)));
}

Eigen::MatrixXd NormalMatrix::solve_columns(const Eigen::MatrixXd& right) const {
  return scale_.asDiagonal() * llt_.solve(scale_.asDiagonal() * right);
}

Eigen::MatrixXd NormalMatrix::covariance_root() const {
  // Column by column of the inverse of an upper triangle: below its diagonal there is nothing to solve.
  constexpr Eigen::Index kTogether = 16;
  Eigen::MatrixXd inverse = Eigen::MatrixXd::Identity(scale_.size(), scale_.size());
  for (Eigen::Index first = 0; first < scale_.size(); first += kTogether) {
    const Eigen::Index columns = std::min(kTogether, scale_.size() - first);
    const Eigen::Index rows = first + columns;
    auto block = inverse.block(0, first, rows, columns);
    const auto lower = llt_.matrixLLT().topLeftCorner(rows, rows);
    lower.triangularView<Eigen::Lower>().transpose().solveInPlace(block);
  }
  return scale_.asDiagonal() * inverse;
}

double NormalMatrix::log_determinant() const {
  return 2.0 * (llt_.matrixLLT().diagonal().array().log().sum() - scale_.array().log().sum());
}

double NormalMatrix::reciprocal_condition() const {
  return std::sqrt(llt_.rcond());
}

}  // namespace abcal
