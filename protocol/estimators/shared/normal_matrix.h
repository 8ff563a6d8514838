#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <utility>

namespace abcal {

/// The normal matrix N of a least-squares problem, priors included, solved by Cholesky's decomposition with
/// its diagonal scaled to 1: the unknowns may differ by many orders of magnitude.
class NormalMatrix {
 public:
  NormalMatrix() = default;
  explicit NormalMatrix(Eigen::MatrixXd normal) { compute(std::move(normal)); }

  /// @param normal  N, symmetric
  void compute(Eigen::MatrixXd normal);
  /// False: an unknown is not determined.
  bool solvable() const;
  /// N^-1 right.
  Eigen::VectorXd solve(const Eigen::VectorXd& right) const;
  Eigen::MatrixXd solve_columns(const Eigen::MatrixXd& right) const;
  /// R with N^-1 = R R', upper triangular: the root of the covariance of the unknowns.
  Eigen::MatrixXd covariance_root() const;
  /// log det N.
  double log_determinant() const;
  /// Square root of the reciprocal condition of the scaled matrix.
  double reciprocal_condition() const;

 private:
  Eigen::VectorXd scale_;
  Eigen::LLT<Eigen::MatrixXd> llt_;  ///< Cholesky factor of the scaled matrix.
};

}  // namespace abcal
