#include "protocol/uncertainty/study_output.h"

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "protocol/quantities/output_names.h"

namespace abcal {

OutputVector to_vector(const StudyOutput& output) {
  OutputVector v;
  for (Eigen::Index j = 0; j < 3; ++j) {
    v.segment<3>(3 * j) = output.sensitivity_matrix.row(j).transpose();
  }
  v.segment<3>(kFirstOffset) = output.offset;
  v.segment<3>(kFirstIntrinsicSensitivity) = output.intrinsic_sensitivity;
  v.segment<3>(kFirstIntrinsicAngle) = output.intrinsic_angle_deg;
  return v;
}

StudyOutput to_output(const OutputVector& vector) {
  StudyOutput output;
  for (Eigen::Index j = 0; j < 3; ++j) {
    output.sensitivity_matrix.row(j) = vector.segment<3>(3 * j).transpose();
  }
  output.offset = vector.segment<3>(kFirstOffset);
  output.intrinsic_sensitivity = vector.segment<3>(kFirstIntrinsicSensitivity);
  output.intrinsic_angle_deg = vector.segment<3>(kFirstIntrinsicAngle);
  return output;
}

StudyOutput outputs_of(const Eigen::Matrix3d& sensitivity_matrix, const Eigen::Vector3d& offset) {
  StudyOutput output;
  output.sensitivity_matrix = sensitivity_matrix;
  output.offset = offset;
  output.intrinsic_sensitivity = sensitivity_matrix.rowwise().norm();
  for (Eigen::Index j = 0; j < 3; ++j) {
    const Eigen::Vector3d a = sensitivity_matrix.row(j);
    const Eigen::Vector3d b = sensitivity_matrix.row((j + 1) % 3);
    // atan2, not acos: acos loses half the digits near 0 and 180 degrees.
    output.intrinsic_angle_deg(j) = std::atan2(a.cross(b).norm(), a.dot(b)) * (180.0 / std::numbers::pi);
  }
  return output;
}

OutputVector outputs_of_line(const Eigen::Matrix<double, 12, 1>& line) {
  Eigen::Matrix3d s;
  for (Eigen::Index j = 0; j < 3; ++j) s.row(j) = line.segment<3>(3 * j).transpose();
  return to_vector(outputs_of(s, line.tail<3>()));
}

std::string_view output_symbol(int k) {
  return kOutputSymbols.at(static_cast<std::size_t>(k));
}

std::string output_unit(int k, std::string_view response_unit) {
  if (k < 0 || k >= kStudyOutputs) throw std::out_of_range("output " + std::to_string(k) + " of 18");
  if (k >= kFirstIntrinsicAngle) return "degree";
  const bool offset = k >= kFirstOffset && k < kFirstIntrinsicSensitivity;
  return std::string(response_unit) + (offset ? "" : "/g_loc");
}

std::vector<Quantity> quantities_of_outputs(const CalibrationResult& result) {
  std::vector<Quantity> out;
  if (result.sensitivity_matrix) {
    for (const auto& row : *result.sensitivity_matrix) out.insert(out.end(), row.begin(), row.end());
  } else {
    out.resize(kFirstOffset);
  }
  for (const auto* three : {&result.offset, &result.intrinsic_sensitivity, &result.intrinsic_angle})
    out.insert(out.end(), three->begin(), three->end());
  return out;
}

std::vector<int> worst_of_each_kind(const OutputVector& u) {
  std::vector<int> worst;
  const auto largest = [&](const std::vector<int>& members) {
    int best = members.front();
    for (const int k : members) {
      if (u(k) > u(best)) best = k;
    }
    if (!std::isnan(u(best))) worst.push_back(best);
  };
  largest({0, 4, 8});
  largest({1, 2, 3, 5, 6, 7});
  largest({9, 10, 11});
  largest({12, 13, 14});
  largest({15, 16, 17});
  return worst;
}

}  // namespace abcal
