#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

namespace abcal {

/// Whether results of one quantity agree with their generalised least-squares mean.
struct ConsistencyTest {
  double chi2 = 0.0;
  int degrees_of_freedom = 0;
  double probability = 1.0;  ///< P(chi2 >= found) if all agree.
};

/// The largest subset of results that agree with one another (M. G. Cox, Metrologia 44, 187, 2007).
struct ConsistentSubset {
  ConsistencyTest all;
  /// Whether more than half of the results agree. If not, there are no outliers: it is unknown which are
  /// right.
  bool found = false;
  std::vector<std::size_t> outliers;  ///< Those that are not in the subset, in ascending order.
  ConsistencyTest subset;             ///< Test of the subset; of all if there are no outliers.
  /// Further subsets of this size that agree too. Of all of them, the one with the smallest chi2 is named.
  int alternatives = 0;
  /// False: there are too many subsets to try all; outliers were removed one by one, each time the one that
  /// lowers chi2 most.
  bool exhaustive = true;
  /// False: the covariances contradict one another (they are not positive definite), so that only the
  /// uncertainties were used.
  bool covariances_used = true;

  /// Whether all results agree.
  bool agree(double level) const { return all.probability >= level; }
};

/// The most results that are tested together: the covariance of all is one matrix.
inline constexpr std::size_t kMostConsistent = 150;

/// @param values      one vector for each result, all of one length p
/// @param covariance  of all values, result by result, n p x n p
/// @param level       a subset agrees if its probability is at least this
/// @throws std::invalid_argument fewer than two results or more than kMostConsistent, other sizes, a variance
/// that is not above 0
ConsistentSubset largest_consistent_subset(const std::vector<Eigen::VectorXd>& values,
                                           const Eigen::MatrixXd& covariance, double level);

}  // namespace abcal
