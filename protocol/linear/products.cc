#include "protocol/linear/products.h"

namespace abcal {

Eigen::MatrixXd product(const MatrixView& a, const MatrixView& b) {
  return a * b;
}

Eigen::MatrixXd transposed_product(const MatrixView& a, const MatrixView& b) {
  return a.transpose() * b;
}

Eigen::MatrixXd product_transposed(const MatrixView& a, const MatrixView& b) {
  return a * b.transpose();
}

Eigen::VectorXd product_with_vector(const MatrixView& a, const VectorView& x) {
  return a * x;
}

Eigen::VectorXd transposed_product_with_vector(const MatrixView& a, const VectorView& x) {
  return a.transpose() * x;
}

Eigen::MatrixXd transposed_product_by_rows(const RowMajorView& x, const RowMajorView& y) {
  return product_transposed(x.transpose(), y.transpose());
}

Eigen::VectorXd transposed_product_by_rows_with_vector(const RowMajorView& x, const VectorView& v) {
  return product_with_vector(x.transpose(), v);
}

Eigen::MatrixXd carried_covariance(const MatrixView& jacobian, const MatrixView& covariance) {
  return product_transposed(product(jacobian, covariance), jacobian);
}

Eigen::MatrixXd covariance_of_root(const MatrixView& root) {
  return product_transposed(root, root);
}

Eigen::MatrixXd lower_of_products_of_columns(const MatrixView& a) {
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(a.cols(), a.cols());
  out.selfadjointView<Eigen::Lower>().rankUpdate(a.transpose());
  return out;
}

Eigen::MatrixXd scaled_on_both_sides(const MatrixView& m, const VectorView& scale) {
  return scale.asDiagonal() * m * scale.asDiagonal();
}

Eigen::MatrixXd scaled_rows(const VectorView& scale, const MatrixView& m) {
  return scale.asDiagonal() * m;
}

Eigen::MatrixXd scaled_columns(const MatrixView& m, const VectorView& scale) {
  return m * scale.asDiagonal();
}

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

}  // namespace abcal
