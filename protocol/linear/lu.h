#pragma once

#include <Eigen/Core>

#include "protocol/linear/products.h"

namespace abcal {

/// M^-1 right of a square M by Gauss's elimination with partial pivoting. A singular M gives numbers that are
/// not finite, or that are as large as round-off permits: the caller must check them.
Eigen::VectorXd solve_by_lu(const MatrixView& m, const VectorView& right);

}  // namespace abcal
