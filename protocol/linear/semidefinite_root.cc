#include "protocol/linear/semidefinite_root.h"

#include <cmath>

namespace abcal {

Eigen::MatrixXd semidefinite_root(const MatrixView& n) {
  constexpr double kFollows = 1e-12;
  Eigen::MatrixXd root = Eigen::MatrixXd::Zero(n.rows(), n.cols());
  for (Eigen::Index k = 0; k < n.rows(); ++k) {
    const double left = n(k, k) - root.row(k).head(k).squaredNorm();
    if (!(left > kFollows * n.diagonal().maxCoeff())) continue;
    root(k, k) = std::sqrt(left);
    for (Eigen::Index i = k + 1; i < n.rows(); ++i)
      root(i, k) = (n(i, k) - root.row(i).head(k).dot(root.row(k).head(k))) / root(k, k);
  }
  return root;
}

}  // namespace abcal
