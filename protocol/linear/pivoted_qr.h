#pragma once

#include <Eigen/Core>
#include <memory>

#include "protocol/linear/products.h"

namespace abcal {

/// D P = Q R of a design D (rows x columns, no fewer rows than columns) by Householder's reflections. P
/// permutes the columns so that the diagonal of R falls.
class PivotedQr {
 public:
  explicit PivotedQr(const MatrixView& design);
  ~PivotedQr();

  /// How many pivots are above round-off (the smaller size of D times the epsilon of double) of the largest.
  Eigen::Index rank() const;
  /// The rank with another threshold.
  Eigen::Index rank_above(double threshold) const;
  /// The last pivot over the first, absolute; NaN of a design of zeros.
  double reciprocal_condition() const;
  /// Absolute, in their order.
  Eigen::VectorXd pivots() const;
  /// x that makes |D x - right| smallest.
  Eigen::VectorXd solve_vector(const VectorView& right) const;
  /// Solution for each column.
  Eigen::MatrixXd solve(const MatrixView& right) const;
  /// Q, rows x columns.
  Eigen::MatrixXd orthonormal() const;
  /// R, columns x columns; zero below its diagonal.
  Eigen::MatrixXd upper() const;
  /// P R^-1 right, of as many rows as D has columns. With Q' it is the estimator: x = P R^-1 Q' b.
  Eigen::MatrixXd solve_upper(const MatrixView& right) const;
  /// P R^-1: times its transpose it is (D' D)^-1.
  Eigen::MatrixXd cofactor_root() const;

 private:
  std::unique_ptr<Eigen::ColPivHouseholderQR<Eigen::MatrixXd>> qr_;
};

}  // namespace abcal
