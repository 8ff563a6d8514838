#pragma once

#include <Eigen/Core>
#include <memory>

#include "protocol/linear/products.h"

namespace abcal {

/// N = L L' of a symmetric, positive definite N.
class Cholesky {
 public:
  /// An empty decomposition.
  Cholesky() = default;
  /// @param n  N, of which only the lower triangle is read
  explicit Cholesky(const MatrixView& n);

  /// False: N is not positive definite to rounding, and nothing else may be asked.
  bool positive_definite() const { return positive_definite_; }
  /// N^-1 right, column by column.
  Eigen::MatrixXd solve(const MatrixView& right) const;
  Eigen::VectorXd solve_vector(const VectorView& right) const;
  /// L^-1 right.
  Eigen::MatrixXd solve_lower(const MatrixView& right) const;
  Eigen::VectorXd solve_lower_vector(const VectorView& right) const;
  /// L'^-1 right.
  Eigen::MatrixXd solve_upper(const MatrixView& right) const;
  /// N^-1.
  Eigen::MatrixXd inverse() const;
  /// log det N.
  double log_determinant() const;

 private:
  Eigen::MatrixXd lower_;  ///< L; elements above its diagonal are not read.
  bool positive_definite_ = false;
};

/// N = P' L D L' P of a symmetric N that may be singular.
class PivotedCholesky {
 public:
  /// @param n  N, of which only the lower triangle is read
  explicit PivotedCholesky(const MatrixView& n);
  ~PivotedCholesky();

  /// False: N has a negative eigenvalue, or the decomposition failed.
  bool positive_semidefinite() const;
  /// x of N x = right; of a singular N one of them, if there is any.
  Eigen::VectorXd solve_vector(const VectorView& right) const;
  /// N^-1.
  Eigen::MatrixXd inverse() const;

 private:
  std::unique_ptr<Eigen::LDLT<Eigen::MatrixXd>> ldlt_;
};

}  // namespace abcal
