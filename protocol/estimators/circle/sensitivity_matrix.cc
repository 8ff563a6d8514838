#include "protocol/estimators/circle/sensitivity_matrix.h"

namespace abcal {

namespace {

// The matrix of a linear function from its values at the unit vectors: the equations are written only once.
template <int kRows, typename Function>
Eigen::Matrix<double, kRows, 27> matrix_of(Function function) {
  Eigen::Matrix<double, kRows, 27> matrix;
  for (Eigen::Index c = 0; c < 27; ++c) matrix.col(c) = function(AbcCoefficients::Unit(c));
  return matrix;
}

}  // namespace

AbcOutputs abc_outputs(const AbcCoefficients& coefficients) {
  AbcOutputs outputs;
  for (int j = 0; j < 3; ++j) {
    const auto c = [&](int experiment, AbcTerm term) { return coefficients(abc_index(experiment, j, term)); };
    outputs(s_index(j, 0)) = -(c(2, kA) + c(3, kA)) / 2.0;
    outputs(s_index(j, 1)) = (c(1, kA) - c(3, kB)) / 2.0;
    outputs(s_index(j, 2)) = (c(1, kB) + c(2, kB)) / 2.0;
    outputs(offset_index(j)) = (c(1, kC) + c(2, kC) + c(3, kC)) / 3.0;
  }
  return outputs;
}

const Eigen::Matrix<double, 12, 27>& abc_equations() {
  static const Eigen::Matrix<double, 12, 27> matrix = matrix_of<12>(abc_outputs);
  return matrix;
}

AbcClosures abc_closures(const AbcCoefficients& coefficients) {
  AbcClosures closures;
  for (int j = 0; j < 3; ++j) {
    const auto c = [&](int experiment, AbcTerm term) { return coefficients(abc_index(experiment, j, term)); };
    closures(0 + j) = c(1, kA) + c(3, kB);
    closures(3 + j) = c(2, kA) - c(3, kA);
    closures(6 + j) = c(1, kB) - c(2, kB);
    closures(9 + j) = c(1, kC) - c(2, kC);
    closures(12 + j) = c(2, kC) - c(3, kC);
  }
  return closures;
}

const Eigen::Matrix<double, 15, 27>& closure_equations() {
  static const Eigen::Matrix<double, 15, 27> matrix = matrix_of<15>(abc_closures);
  return matrix;
}

Eigen::Matrix3d sensitivity_matrix_of(const AbcOutputs& outputs) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(outputs.data());
}

Eigen::Vector3d offset_of(const AbcOutputs& outputs) {
  return outputs.tail<3>();
}

}  // namespace abcal
