#include "protocol/linear/lu.h"

#include <Eigen/LU>

namespace abcal {

Eigen::VectorXd solve_by_lu(const MatrixView& m, const VectorView& right) {
  return Eigen::PartialPivLU<Eigen::MatrixXd>(m).solve(right);
}

}  // namespace abcal
