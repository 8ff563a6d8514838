#pragma once

#include <Eigen/Core>

// Products and decompositions of matrices of any size, computed by Eigen. Here they are compiled once: the
// compiler needs seconds for each combination of expressions in a product, and as many for each size of a
// decomposition. For code that runs once in an analysis. An inner loop with matrices of fixed size is faster
// with Eigen's own operators, which need no memory from the heap.

namespace abcal {

/// Any matrix of double whose columns are contiguous: fixed or dynamic size, or a block. Nothing is copied.
/// Another expression is evaluated first.
using MatrixView = Eigen::Ref<const Eigen::MatrixXd>;
using VectorView = Eigen::Ref<const Eigen::VectorXd>;
/// A view of a matrix that is stored row by row.
using RowMajorView = Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;

/// A B; the columns of A are as many as the rows of B.
Eigen::MatrixXd product(const MatrixView& a, const MatrixView& b);
/// A' B; both have as many rows.
Eigen::MatrixXd transposed_product(const MatrixView& a, const MatrixView& b);
/// A B'; both have as many columns.
Eigen::MatrixXd product_transposed(const MatrixView& a, const MatrixView& b);
/// A x.
Eigen::VectorXd product_with_vector(const MatrixView& a, const VectorView& x);
/// A' x.
Eigen::VectorXd transposed_product_with_vector(const MatrixView& a, const VectorView& x);

/// X' Y and X' v of matrices that are stored row by row, which MatrixView would copy.
Eigen::MatrixXd transposed_product_by_rows(const RowMajorView& x, const RowMajorView& y);
Eigen::VectorXd transposed_product_by_rows_with_vector(const RowMajorView& x, const VectorView& v);

/// J V J': the covariance of J x where V is that of x.
Eigen::MatrixXd carried_covariance(const MatrixView& jacobian, const MatrixView& covariance);
/// R R': the covariance of which R is a root.
Eigen::MatrixXd covariance_of_root(const MatrixView& root);
/// A' A, of which only the lower triangle is computed; the rest is zero.
Eigen::MatrixXd lower_of_products_of_columns(const MatrixView& a);
/// diag(scale) M diag(scale); M is square.
Eigen::MatrixXd scaled_on_both_sides(const MatrixView& m, const VectorView& scale);
/// diag(scale) M.
Eigen::MatrixXd scaled_rows(const VectorView& scale, const MatrixView& m);
/// M diag(scale).
Eigen::MatrixXd scaled_columns(const MatrixView& m, const VectorView& scale);
/// The matrix whose product with a vector is the cross product of v with it.
Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v);

}  // namespace abcal
