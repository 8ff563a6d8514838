#include "protocol/linear/symmetric_eigen.h"

#include <Eigen/Eigenvalues>

namespace abcal {

SymmetricEigen symmetric_eigen(const MatrixView& m) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(m);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

SymmetricEigen generalized_eigen(const MatrixView& a, const MatrixView& b) {
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> solver(a, b);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

}  // namespace abcal
