#pragma once

#include <Eigen/Core>

#include "protocol/linear/products.h"

namespace abcal {

/// A lower triangular R with R R' = N of a positive semidefinite N. An element that follows from those before
/// it, to rounding, has no column. Unlike eigenvectors, R depends on the last bits of N no more than they do.
/// @param n  N, whose diagonal elements are of one size, or zero
Eigen::MatrixXd semidefinite_root(const MatrixView& n);

}  // namespace abcal
