#include "protocol/linear/pivoted_qr.h"

#include <Eigen/QR>
#include <cmath>

namespace abcal {

PivotedQr::PivotedQr(const MatrixView& design)
    : qr_(std::make_unique<Eigen::ColPivHouseholderQR<Eigen::MatrixXd>>(design)) {}

PivotedQr::~PivotedQr() = default;

Eigen::Index PivotedQr::rank() const {
  return qr_->rank();
}

Eigen::Index PivotedQr::rank_above(double threshold) const {
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr = *qr_;
  return qr.setThreshold(threshold).rank();
}

double PivotedQr::reciprocal_condition() const {
  const Eigen::Index last = qr_->cols() - 1;
  return std::abs(qr_->matrixR()(last, last) / qr_->matrixR()(0, 0));
}

Eigen::VectorXd PivotedQr::pivots() const {
  return qr_->matrixR().diagonal().cwiseAbs();
}

Eigen::VectorXd PivotedQr::solve_vector(const VectorView& right) const {
  return qr_->solve(right);
}

Eigen::MatrixXd PivotedQr::solve(const MatrixView& right) const {
  return qr_->solve(right);
}

Eigen::MatrixXd PivotedQr::orthonormal() const {
  return qr_->householderQ() * Eigen::MatrixXd::Identity(qr_->rows(), qr_->cols());
}

Eigen::MatrixXd PivotedQr::upper() const {
  return qr_->matrixR().topLeftCorner(qr_->cols(), qr_->cols()).triangularView<Eigen::Upper>();
}

Eigen::MatrixXd PivotedQr::solve_upper(const MatrixView& right) const {
  Eigen::MatrixXd x = right;
  qr_->matrixR().topLeftCorner(qr_->cols(), qr_->cols()).triangularView<Eigen::Upper>().solveInPlace(x);
  return qr_->colsPermutation() * x;
}

Eigen::MatrixXd PivotedQr::cofactor_root() const {
  return solve_upper(Eigen::MatrixXd::Identity(qr_->cols(), qr_->cols()));
}

}  // namespace abcal
