#include "app/laboratory/certificate/raised_covariance.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace abcal {

Covariance12 raised_covariance(const Covariance12& covariance, const std::vector<LeastVariance>& least) {
  const auto n = static_cast<Eigen::Index>(least.size());
  Eigen::Matrix<double, 12, Eigen::Dynamic> directions(12, n);
  Eigen::VectorXd lacking(n);  // in the directions of unit length
  for (Eigen::Index i = 0; i < n; ++i) {
    const LeastVariance& one = least[static_cast<std::size_t>(i)];
    const double length = one.gradient.norm();
    if (one.variance > 0.0 && !(length > 0.0))
      throw std::invalid_argument("the uncertainty of " + one.name +
                                  " cannot be raised: no output changes it");
    directions.col(i) = length > 0.0 ? Eigen::VectorXd(one.gradient / length) : Eigen::VectorXd::Zero(12);
    lacking[i] = (one.variance / (length * length)) - directions.col(i).dot(covariance * directions.col(i));
    constexpr double kRounding = 1e-12;
    if (!(lacking[i] * length * length > kRounding * one.variance)) lacking[i] = std::min(0.0, lacking[i]);
  }
  Covariance12 raised = covariance;
  if (n == 0 || !(lacking.maxCoeff() > 0.0)) return raised;
  // Each raise is 0 or brings its own combination exactly to its variance: the conditions of the smallest
  // x' shared x / 2 - lacking' x with x >= 0, which Gauss-Seidel with projection finds, as `shared` (squares
  // of cosines) is positive semidefinite.
  const Eigen::MatrixXd shared = (directions.transpose() * directions).array().square();
  Eigen::VectorXd raise = Eigen::VectorXd::Zero(n);
  constexpr int kMostSweeps = 10'000;
  const double small = 1e-14 * lacking.maxCoeff();
  for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
    double change = 0.0;
    for (Eigen::Index i = 0; i < n; ++i) {
      const double next = std::max(0.0, lacking[i] - shared.row(i).dot(raise) + raise[i]);
      change = std::max(change, std::abs(next - raise[i]));
      raise[i] = next;
    }
    if (!(change > small)) break;
  }
  for (Eigen::Index i = 0; i < n; ++i)
    if (raise[i] > 0.0) raised += raise[i] * directions.col(i) * directions.col(i).transpose();
  return raised;
}

}  // namespace abcal
