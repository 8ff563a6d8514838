#pragma once

#include <Eigen/Core>

#include "protocol/linear/products.h"

namespace abcal {

/// Eigenvalues of a symmetric matrix.
struct SymmetricEigen {
  Eigen::VectorXd values;   ///< Ascending.
  Eigen::MatrixXd vectors;  ///< In columns, in the order of the values.
};

/// @param m  symmetric; only its lower triangle is read
/// The vectors are orthonormal.
SymmetricEigen symmetric_eigen(const MatrixView& m);

/// A v = lambda B v. The vectors have v' B v = 1.
/// @param a  symmetric
/// @param b  symmetric, positive definite
SymmetricEigen generalized_eigen(const MatrixView& a, const MatrixView& b);

}  // namespace abcal
