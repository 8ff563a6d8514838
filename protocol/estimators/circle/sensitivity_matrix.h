#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

namespace abcal {

/// A, B, C of A sin(alpha) + B cos(alpha) + C for 3 experiments x 3 accelerometers (R): 27 numbers,
/// experiment by experiment, in each u v w, in each A B C.
using AbcCoefficients = Eigen::Matrix<double, 27, 1>;

enum AbcTerm : int { kA = 0, kB = 1, kC = 2 };

/// Index of a coefficient: experiment 1..3, accelerometer 0..2.
constexpr Eigen::Index abc_index(int experiment, int accelerometer, AbcTerm term) {
  return 9 * (experiment - 1) + 3 * accelerometer + static_cast<int>(term);
}

/// The twelve outputs: s row by row, then O (the order of Covariance12).
using AbcOutputs = Eigen::Matrix<double, 12, 1>;

/// Position of s_jk and O_j among the outputs; j = 0..2 is u v w, k = 0..2 is x y z.
constexpr Eigen::Index s_index(int accelerometer, int component) {
  return 3 * accelerometer + component;
}
constexpr Eigen::Index offset_index(int accelerometer) {
  return 9 + accelerometer;
}

/// s_jx = -(A2 + A3)/2, s_jy = (A1 - B3)/2, s_jz = (B1 + B2)/2, O_j = (C1 + C2 + C3)/3
/// (docs/theory/abc_protocol.md).
AbcOutputs abc_outputs(const AbcCoefficients& coefficients);

/// abc_outputs() as a matrix: outputs = abc_equations() * coefficients.
const Eigen::Matrix<double, 12, 27>& abc_equations();

/// Sums that vanish for a perfect stage and a linear accelerometer (docs/theory/abc_protocol.md): A1+B3,
/// A2-A3, B1-B2, C1-C2, C2-C3, in this order, u v w for each.
inline constexpr std::array<const char*, 5> kClosureNames{"A1+B3", "A2-A3", "B1-B2", "C1-C2", "C2-C3"};
using AbcClosures = Eigen::Matrix<double, 15, 1>;
AbcClosures abc_closures(const AbcCoefficients& coefficients);
const Eigen::Matrix<double, 15, 27>& closure_equations();

/// The outputs as matrix (rows u v w) and offset.
Eigen::Matrix3d sensitivity_matrix_of(const AbcOutputs& outputs);
Eigen::Vector3d offset_of(const AbcOutputs& outputs);

}  // namespace abcal
