#include "protocol/linear/singular_values.h"

#include <Eigen/SVD>

namespace abcal {

SingularValues singular_value_decomposition(const MatrixView& m) {
  const Eigen::JacobiSVD<Eigen::MatrixXd, Eigen::NoQRPreconditioner> svd(
      m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return {svd.singularValues(), svd.matrixU(), svd.matrixV()};
}

Eigen::VectorXd singular_values(const MatrixView& m) {
  return Eigen::JacobiSVD<Eigen::MatrixXd, Eigen::NoQRPreconditioner>(m).singularValues();
}

}  // namespace abcal
