#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// Number of outputs of a study: 9 elements of s row by row, 3 O, 3 intrinsic sensitivities, 3 intrinsic
/// angles.
inline constexpr int kStudyOutputs = 18;
inline constexpr int kFirstOffset = 9;
inline constexpr int kFirstIntrinsicSensitivity = 12;
inline constexpr int kFirstIntrinsicAngle = 15;

using OutputVector = Eigen::Matrix<double, kStudyOutputs, 1>;
using OutputCovariance = Eigen::Matrix<double, kStudyOutputs, kStudyOutputs>;

/// The four groups of outputs of the ABC protocol, as values, errors or uncertainties.
struct StudyOutput {
  Eigen::Matrix3d sensitivity_matrix = Eigen::Matrix3d::Zero();  ///< Rows u, v, w; columns x, y, z; R/g_loc.
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();              ///< R
  Eigen::Vector3d intrinsic_sensitivity = Eigen::Vector3d::Zero();  ///< R/g_loc
  Eigen::Vector3d intrinsic_angle_deg = Eigen::Vector3d::Zero();    ///< phi_uv, phi_vw, phi_wu, degrees.
};

/// The outputs in a row, in the order of kStudyOutputs, and back.
OutputVector to_vector(const StudyOutput& output);
StudyOutput to_output(const OutputVector& vector);

/// The outputs that belong to a sensitivity matrix and an offset: norms of the rows and the angles between
/// them (by atan2; docs/theory/model.md).
StudyOutput outputs_of(const Eigen::Matrix3d& sensitivity_matrix, const Eigen::Vector3d& offset);
/// The same in a row, of a line response: s row by row and O.
OutputVector outputs_of_line(const Eigen::Matrix<double, 12, 1>& line);

/// The outputs of a result as quantities, in the order of kStudyOutputs; NaN: those of a matrix that it does
/// not have.
std::vector<Quantity> quantities_of_outputs(const CalibrationResult& result);

/// Whether output k is a sensitivity, so that it is per g_loc.
constexpr bool is_sensitivity(int k) {
  return k < kFirstOffset || (k >= kFirstIntrinsicSensitivity && k < kFirstIntrinsicAngle);
}

/// One output for each kind (diagonal and other elements of s, O, s_j, phi) that has uncertainties: that with
/// the largest. Positions as in study_output.h.
std::vector<int> worst_of_each_kind(const OutputVector& u);

/// Symbol of output k: "s_ux" ... "s_wz", "O_u", "s_u" (intrinsic), "phi_uv" ...
std::string_view output_symbol(int k);

/// Unit of output k for a response unit ("R/g_loc", "R" or "degree").
std::string output_unit(int k, std::string_view response_unit);

}  // namespace abcal
