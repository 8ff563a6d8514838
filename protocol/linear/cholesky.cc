#include "protocol/linear/cholesky.h"

#include <Eigen/Cholesky>

namespace abcal {

Cholesky::Cholesky(const MatrixView& n) : lower_(n) {
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> in_place(lower_);
  positive_definite_ = in_place.info() == Eigen::Success;
}

Eigen::MatrixXd Cholesky::solve(const MatrixView& right) const {
  return solve_upper(solve_lower(right));
}

Eigen::VectorXd Cholesky::solve_vector(const VectorView& right) const {
  Eigen::VectorXd x = solve_lower_vector(right);
  lower_.triangularView<Eigen::Lower>().adjoint().solveInPlace(x);
  return x;
}

Eigen::MatrixXd Cholesky::solve_lower(const MatrixView& right) const {
  Eigen::MatrixXd x = right;
  lower_.triangularView<Eigen::Lower>().solveInPlace(x);
  return x;
}

Eigen::VectorXd Cholesky::solve_lower_vector(const VectorView& right) const {
  Eigen::VectorXd x = right;
  lower_.triangularView<Eigen::Lower>().solveInPlace(x);
  return x;
}

Eigen::MatrixXd Cholesky::solve_upper(const MatrixView& right) const {
  Eigen::MatrixXd x = right;
  lower_.triangularView<Eigen::Lower>().adjoint().solveInPlace(x);
  return x;
}

Eigen::MatrixXd Cholesky::inverse() const {
  return solve(Eigen::MatrixXd::Identity(lower_.rows(), lower_.rows()));
}

double Cholesky::log_determinant() const {
  return 2.0 * lower_.diagonal().array().log().sum();
}

PivotedCholesky::PivotedCholesky(const MatrixView& n)
    : ldlt_(std::make_unique<Eigen::LDLT<Eigen::MatrixXd>>(n)) {}

PivotedCholesky::~PivotedCholesky() = default;

bool PivotedCholesky::positive_semidefinite() const {
  return ldlt_->info() == Eigen::Success && ldlt_->isPositive();
}

Eigen::VectorXd PivotedCholesky::solve_vector(const VectorView& right) const {
  return ldlt_->solve(right);
}

Eigen::MatrixXd PivotedCholesky::inverse() const {
  return ldlt_->solve(Eigen::MatrixXd::Identity(ldlt_->rows(), ldlt_->rows()));
}

}  // namespace abcal
