#include "protocol/uncertainty/published_tables.h"

#include <stdexcept>

namespace abcal {

namespace {

StudyOutput table(const std::array<double, kStudyOutputs>& numbers) {
  return to_output(OutputVector(numbers.data()));
}

}  // namespace

const StudyOutput& published_table_2() {
  static const StudyOutput kTable = table({+1.084557444843417, -0.047097516966133, +0.037216463393415,  //
                                           +0.369246379560599, +0.920196068359764, +0.285771705579544,  //
                                           -0.117336380485872, +0.263805007662141, +0.819879210182046,  //
                                           +0.053766713954610, +0.183388501459509, -0.225884686100365,  //
                                           +1.086217332036812, +1.031876523985898, +0.869231170369473,  //
                                           +70.845583191199623, +61.081782813884068, +96.639644038935558});
  return kTable;
}

const StudyOutput& published_table_3_and_4_mean() {
  static const StudyOutput kTable =
      table({+2.610e-07, +1.596e-07, +6.213e-07, -8.222e-07, +6.825e-08, +8.041e-07, -1.624e-06, +6.073e-07,
             -4.201e-07, -1.677e-07, -4.273e-07, +1.272e-07, +7.514e-08, -1.192e-07, +4.152e-07, -4.079e-06,
             +1.539e-05, +2.324e-05});
  return kTable;
}

const StudyOutput& published_table_3_and_4_standard_deviation() {
  static const StudyOutput kTable =
      table({+1.709e-05, +7.289e-05, +1.274e-04, +7.403e-05, +1.002e-05, +1.195e-04, +1.548e-04, +6.821e-05,
             +1.760e-05, +4.894e-05, +4.892e-05, +4.562e-05, +9.244e-06, +9.609e-06, +1.309e-05, +7.555e-04,
             +5.447e-03, +5.431e-03});
  return kTable;
}

const StudyOutput& published_table_5() {
  static const StudyOutput kTable =
      table({-9.748e-09, -6.981e-05, -6.981e-05, +6.981e-05, -9.748e-09, -6.981e-05, -9.252e-18, +9.252e-18,
             -1.950e-08, +4.654e-05, +4.654e-05, +1.950e-08, -4.874e-09, -4.874e-09, -1.950e-08, -2.793e-07,
             +4.000e-03, +4.000e-03});
  return kTable;
}

const StudyOutput& published_table_6() {
  static const StudyOutput kTable =
      table({-3.299e-06, -7.572e-05, -7.243e-05, +6.424e-05, -2.579e-05, -9.003e-05, +1.842e-05, +8.189e-06,
             -1.024e-05, +4.829e-05, +6.002e-05, +6.833e-06, -2.487e-06, -2.494e-05, -9.661e-06, +7.748e-04,
             +4.484e-03, +3.740e-03});
  return kTable;
}

const StudyOutput& published_table_7() {
  static const StudyOutput kTable =
      table({+2.220e-16, +7.601e-18, +1.396e-04, +1.950e-08, -1.110e-16, -1.485e-17, -2.094e-04, -6.981e-05,
             +8.882e-16, -1.124e-17, +2.030e-17, -4.654e-05, -9.748e-09, -1.110e-16, -1.462e-08, +0.000e+00,
             +4.000e-03, +4.000e-03});
  return kTable;
}

const StudyOutput& published_table_8() {
  static const StudyOutput kTable =
      table({-1.081e-05, -7.183e-05, +8.521e-05, -1.098e-06, -4.353e-05, -3.076e-05, -1.549e-04, -4.975e-05,
             -2.576e-05, +4.242e-05, +4.158e-05, -3.190e-05, -4.766e-06, -4.773e-05, -1.850e-05, +1.484e-03,
             +8.584e-03, +7.161e-03});
  return kTable;
}

StudyOutput published_bounds(const Eigen::Matrix3d& sensitivity_matrix) {
  if (!sensitivity_matrix.allFinite()) throw std::invalid_argument("sensitivity matrix is not finite");
  const Eigen::Vector3d norm = sensitivity_matrix.rowwise().norm();
  StudyOutput bounds;
  for (Eigen::Index j = 0; j < 3; ++j) {
    bounds.sensitivity_matrix.row(j).setConstant(2e-4 * norm(j));
    bounds.sensitivity_matrix(j, j) = 2e-5 * norm(j);
  }
  bounds.offset = 5e-5 * norm;
  bounds.intrinsic_sensitivity = 1e-5 * norm;
  bounds.intrinsic_angle_deg.setConstant(5e-3);
  return bounds;
}

}  // namespace abcal
