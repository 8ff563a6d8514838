#include "app/results/export/formats.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/results/analysis/result_json.h"
#include "app/results/export/fixed_point.h"
#include "app/results/export/mat_format.h"
#include "app/system/output.h"
#include "drivers/text/letters.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

/// The heading as lines, each with the format's sign of a comment in front.
std::string heading(const CorrectionConstants& c, std::string_view comment) {
  const std::string frame =
      c.frame == ExportFrame::kItem
          ? "x along the axis of u, y in the plane of u and v (not the platter of the stage)"
          : "the platter of the stage at its default orientation";
  std::string text;
  const auto line = [&](const std::string& words) {
    text += fmt::format("{} {}\n", comment, printable_line(words));
  };
  line("Constants of an accelerometer, by abcal");
  if (!c.item.empty()) line("Item: " + c.item);
  line("From: " + c.source + (c.performed.empty() ? "" : ", " + c.performed) + ", verdict: " + c.verdict);
  line("Axes: " + frame);
  return text;
}

Json rows(const Eigen::Matrix3d& m) {
  Json all = Json::array();
  for (Eigen::Index j = 0; j < 3; ++j) all.push_back({m(j, 0), m(j, 1), m(j, 2)});
  return all;
}

Json list(const Eigen::Vector3d& v) {
  return {v[0], v[1], v[2]};
}

std::string_view frame_name(ExportFrame frame) {
  return frame == ExportFrame::kItem ? "item" : "platter";
}

std::string as_json(const CorrectionConstants& c) {
  Json json{
      {"schema", "abcal.constants/1"},
      {"rule", "a = M (r - b)"},
      {"item", c.item},
      {"source", c.source},
      {"performed", c.performed},
      {"verdict", c.verdict},
      {"frame", frame_name(c.frame)},
      {"response_unit", c.response_unit},
      {"g_loc_mps2", c.g_loc_mps2},
      {"M",
       {{"value", rows(c.M)},
        {"standard_uncertainty", rows(c.u_matrix())},
        {"unit", "m/s2 per response unit"}}},
      {"b", {{"value", list(c.b)}, {"standard_uncertainty", list(c.u_b())}, {"unit", "response unit"}}}};
  Json names = Json::array(), covariance = Json::array();
  for (const char* axis : kPlatterAxes)
    for (const char* output : kOutputNames) names.push_back(fmt::format("M_{}{}", axis, output));
  for (const char* output : kOutputNames) names.push_back(fmt::format("b_{}", output));
  for (const auto& row : c.covariance.rowwise())
    covariance.push_back(std::vector<double>(row.begin(), row.end()));
  json["covariance"] = {{"of", std::move(names)}, {"value", std::move(covariance)}};
  json["outputs"] = Json::object();
  for (const auto& [name, q] : c.outputs)
    json["outputs"][name] = {
        {"value", q.value}, {"standard_uncertainty", json_number(q.standard_uncertainty)}, {"unit", q.unit}};
  if (c.noise) {
    json["noise"] = {{"density", c.noise->density},
                     {"unit", "response unit per root hertz"},
                     {"tau_s", c.noise->tau_s},
                     {"rate_hz", c.noise->rate_hz}};
  }
  return printable_text(json.dump(2)) + "\n";
}

std::string as_csv(const CorrectionConstants& c) {
  std::string text = heading(c, "#");
  text += fmt::format("# a = M (r - b); r and b in {}, M in m/s2 per {}\n", c.response_unit, c.response_unit);
  text += "name,value,standard_uncertainty\n";
  for (Eigen::Index j = 0; j < 3; ++j) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      text += fmt::format("M_{}{},{},{}\n", kPlatterAxes[static_cast<std::size_t>(j)],
                          kOutputNames[static_cast<std::size_t>(k)], c.M(j, k), c.u_matrix()(j, k));
    }
  }
  for (Eigen::Index j = 0; j < 3; ++j)
    text += fmt::format("b_{},{},{}\n", kOutputNames[static_cast<std::size_t>(j)], c.b[j], c.u_b()[j]);
  for (const auto& [name, q] : c.outputs)
    text += fmt::format("{},{},{}\n", name, q.value, q.standard_uncertainty);
  return text;
}

std::string fixed_point_text(const CorrectionConstants& c) {
  const FixedPoint fixed = fixed_point(c);
  if (!fixed.why_not.empty()) return "\n// Not as integers: " + fixed.why_not + ".\n";
  std::string matrix;
  for (Eigen::Index j = 0; j < 3; ++j)
    matrix += fmt::format("    {{{}, {}, {}}},\n", fixed.M(j, 0), fixed.M(j, 1), fixed.M(j, 2));
  std::string text = fmt::format(
      "\n// The same as 32-bit integers: the matrix times 2^abcal_M_shift, the offset times "
      "2^abcal_b_shift.\n"
      "// With the reading as R = r 2^abcal_b_shift, rounded to an int32_t,\n"
      "//   a[j] 2^(abcal_M_shift + abcal_b_shift) = sum over k of\n"
      "//     (int64_t)abcal_M_fixed[j][k] * ((int64_t)R[k] - abcal_b_fixed[k])\n"
      "// Products and sum need 64 bits, and do not overflow for readings r within +-{:.6g} {}.\n",
      fixed.largest_reading, c.response_unit);
  text += fmt::format(
      "// Error of a[j] at 1 g against the floating-point rule: at most {:.2g} m/s2, {:.2g} of g_loc; "
      "standard\n"
      "// uncertainty of the corrected reading: {:.2g} m/s2 or more.\n",
      fixed.error_mps2, fixed.error_mps2 / c.g_loc_mps2, fixed.u_mps2);
  text += fmt::format(
      "#include <stdint.h>\n"
      "enum {{ abcal_M_shift = {}, abcal_b_shift = {} }};\n"
      "static const int32_t abcal_M_fixed[3][3] = {{\n{}}};\nstatic const int32_t abcal_b_fixed[3] = {{{}, "
      "{}, {}}};\n",
      fixed.M_shift, fixed.b_shift, matrix, fixed.b[0], fixed.b[1], fixed.b[2]);
  return text;
}

/// Constants that C output leaves out, for a message.
std::string left_out_of_c(const CorrectionConstants& c) {
  const FixedPoint fixed = fixed_point(c);
  return fixed.why_not.empty() ? "" : "the header has no integers: " + fixed.why_not;
}

std::string as_c(const CorrectionConstants& c) {
  std::string text = heading(c, "//");
  text += fmt::format(
      "// a = M (r - b), accelerations in m/s2, readings in {}.\n#ifndef ABCAL_CONSTANTS_H\n#define "
      "ABCAL_CONSTANTS_H\n\n",
      c.response_unit);
  std::string matrix, bias;
  for (Eigen::Index j = 0; j < 3; ++j) {
    matrix += fmt::format("    {{{:.9g}, {:.9g}, {:.9g}}},\n", c.M(j, 0), c.M(j, 1), c.M(j, 2));
    bias += fmt::format("{}{:.9g}", j == 0 ? "" : ", ", c.b[j]);
  }
  text +=
      fmt::format("static const double abcal_M[3][3] = {{\n{}}};\nstatic const double abcal_b[3] = {{{}}};\n",
                  matrix, bias);
  return text + fixed_point_text(c) + "\n#endif\n";
}

/// Remaining error of a format that only scales, as a comment.
std::string remainder(const CorrectionConstants& c) {
  return fmt::format(
      "# Scales and offsets only: angles between the axes are not corrected. At 1 g that leaves up to {:.2g} "
      "m/s2.\n",
      c.diagonal_remainder_mps2());
}

/// Constants of each axis for a format that only scales.
struct ScaledAxis {
  char axis = 'X';
  double offset_mps2 = 0.0, scale = 1.0;
};

/// corrected = (raw - offset) scale, for each axis by itself.
std::array<ScaledAxis, 3> scaled_axes(const CorrectionConstants& c) {
  const Eigen::Vector3d scale = c.matrix_si().diagonal();
  const Eigen::Vector3d offset = c.bias_si();
  return {{{'X', offset[0], scale[0]}, {'Y', offset[1], scale[1]}, {'Z', offset[2], scale[2]}}};
}

/// PX4: corrected = (raw - offset) scale, in m/s2 and the sensor's axes
/// (sensor_calibration/Accelerometer.hpp). QGroundControl's parameter file: vehicle, component, name, value,
/// type 9 (float).
std::string as_px4(const CorrectionConstants& c) {
  std::string text = heading(c, "#") + remainder(c);
  text += "# corrected = (raw - CAL_ACC0_?OFF) * CAL_ACC0_?SCALE, for the accelerometer of CAL_ACC0_ID\n";
  for (const auto& [axis, offset, scale] : scaled_axes(c)) {
    text += fmt::format("1\t1\tCAL_ACC0_{}OFF\t{:.9g}\t9\n", axis, offset);
    text += fmt::format("1\t1\tCAL_ACC0_{}SCALE\t{:.9g}\t9\n", axis, scale);
  }
  return text;
}

/// ArduPilot: corrected = (raw - INS_ACCOFFS) INS_ACCSCAL, in m/s2 (AP_InertialSensor_Backend).
std::string as_ardupilot(const CorrectionConstants& c) {
  std::string text = heading(c, "#") + remainder(c);
  text += "# corrected = (raw - INS_ACCOFFS) * INS_ACCSCAL, of the first inertial sensor\n";
  for (const auto& [axis, offset, scale] : scaled_axes(c))
    text += fmt::format("INS_ACCOFFS_{},{:.9g}\nINS_ACCSCAL_{},{:.9g}\n", axis, offset, axis, scale);
  return text;
}

/// The ROS package imu_calib: corrected = SM raw - bias, in m/s2.
std::string as_ros(const CorrectionConstants& c) {
  const Eigen::Matrix3d M = c.matrix_si();
  const Eigen::Vector3d bias = M * c.bias_si();
  std::string text = heading(c, "#") + "# imu_calib: corrected = SM * raw - bias (m/s2)\nSM:\n";
  for (Eigen::Index j = 0; j < 3; ++j)
    for (Eigen::Index k = 0; k < 3; ++k) text += fmt::format("  - {:.12g}\n", M(j, k));
  text += "bias:\n";
  for (Eigen::Index j = 0; j < 3; ++j) text += fmt::format("  - {:.12g}\n", bias[j]);
  return text;
}

/// Kalibr's imu.yaml, with the values that a calibration by gravity determines.
std::string as_kalibr(const CorrectionConstants& c) {
  if (!c.noise) {
    throw std::invalid_argument(
        "the noise of single readings is not known; required: a run file with its readings, and dwells of at "
        "least 5 readings");
  }
  static_cast<void>(c.matrix_si());  // Accelerations only.
  std::string text = heading(c, "#");
  text += fmt::format(
      "# From the Allan deviation inside the dwells at {:.3g} s. A calibration does not know the rest: "
      "complete it.\n",
      c.noise->tau_s);
  text += fmt::format("accelerometer_noise_density: {:.6g}   # m/s^2/sqrt(Hz)\n",
                      c.noise->density * *c.unit_mps2);
  text += "# accelerometer_random_walk:   not determined (needs hours at rest), m/s^3/sqrt(Hz)\n";
  text += "# gyroscope_noise_density:     not determined, rad/s/sqrt(Hz)\n";
  text += "# gyroscope_random_walk:       not determined, rad/s^2/sqrt(Hz)\n";
  text += fmt::format("update_rate: {:.6g}   # Hz\n# rostopic: /imu0\n", c.noise->rate_hz);
  return text;
}

/// imucal's FerrarisCalibrationInfo: corrected = R_a^-1 K_a^-1 (raw - b_a), K_a diagonal. The gyroscope's
/// entries change nothing.
std::string as_imucal(const CorrectionConstants& c) {
  const Eigen::Matrix3d KR = c.matrix_si().partialPivLu().solve(Eigen::Matrix3d::Identity());
  const Eigen::Vector3d K = KR.rowwise().norm();
  const Eigen::Matrix3d R = K.cwiseInverse().asDiagonal() * KR;
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  const Json json{
      {"cal_type", "Ferraris"},
      {"acc_unit", "m/s^2"},
      {"gyr_unit", "deg/s"},
      {"from_acc_unit", "m/s^2"},
      {"from_gyr_unit", "deg/s"},
      {"comment",
       fmt::format("{}; {}; the gyroscope was not calibrated, its entries change nothing", c.item, c.source)},
      {"K_a", rows(K.asDiagonal())},
      {"R_a", rows(R)},
      {"b_a", list(c.bias_si())},
      {"K_g", rows(I)},
      {"R_g", rows(I)},
      {"K_ga", rows(Eigen::Matrix3d::Zero())},
      {"b_g", list(Eigen::Vector3d::Zero())}};
  return printable_text(json.dump(2)) + "\n";
}

}  // namespace

const std::vector<ExportFormat>& export_formats() {
  static const std::vector<ExportFormat> formats{
      {"json", "matrix and offset with uncertainties, a = M (r - b); also over temperature", as_json,
       /*is_text=*/true, temperature_constants_json},
      {"csv", "the same as a table; also over temperature", as_csv, /*is_text=*/true,
       temperature_constants_csv},
      {"mat", "the same as a MATLAB file (version 5); also over temperature",
       [](const CorrectionConstants& c) { return as_mat(as_json(c)); }, /*is_text=*/false,
       [](const TemperatureConstants& c) { return as_mat(temperature_constants_json(c)); }},
      {"c", "the same as a C header, also in fixed point; over temperature as floating point", as_c,
       /*is_text=*/true, temperature_constants_c, left_out_of_c},
      {"px4", "parameter file of PX4 (QGroundControl): scales and offsets", as_px4},
      {"ardupilot", "parameter file of ArduPilot: scales and offsets", as_ardupilot},
      {"ros", "YAML of the ROS package imu_calib", as_ros},
      {"kalibr", "imu.yaml of Kalibr: noise density and rate", as_kalibr},
      {"imucal", "JSON of imucal's FerrarisCalibrationInfo", as_imucal},
  };
  return formats;
}

const ExportFormat& export_format(std::string_view name) {
  const std::vector<ExportFormat>& formats = export_formats();
  const auto found = std::ranges::find(formats, name, &ExportFormat::name);
  if (found != formats.end()) return *found;
  std::string names;
  for (const ExportFormat& format : formats)
    names += fmt::format("{}{}", names.empty() ? "" : ", ", format.name);
  throw std::invalid_argument(fmt::format("--as {}: required: one of {}", name, names));
}

}  // namespace abcal
