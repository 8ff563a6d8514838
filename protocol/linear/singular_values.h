#pragma once

#include <Eigen/Core>

#include "protocol/linear/products.h"

namespace abcal {

/// M = U diag(values) V' of a square M.
struct SingularValues {
  Eigen::VectorXd values;  ///< Descending.
  Eigen::MatrixXd u, v;    ///< Orthonormal columns.
};
SingularValues singular_value_decomposition(const MatrixView& m);

/// Singular values of a square M, descending.
Eigen::VectorXd singular_values(const MatrixView& m);

}  // namespace abcal
