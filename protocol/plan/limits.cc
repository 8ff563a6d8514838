#include "protocol/plan/limits.h"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <locale>
#include <numbers>
#include <sstream>
#include <string>

#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

/// 0.1 mg at 1 g for each kelvin, in offset or sensitivity: usual accelerometers.
constexpr double kUsualTemperatureCoefficient = 1e-4;  // 1/K

/// Nine numbers that are the rows of a rotation, made exact; nullopt if they are not.
std::optional<Eigen::Matrix3d> rotation_of_numbers(std::string_view text) {
  constexpr double kDigits = 2e-3;
  std::istringstream words{std::string(text)};
  words.imbue(std::locale::classic());
  Eigen::Matrix3d matrix;
  for (Eigen::Index k = 0; k < 9; ++k) {
    if (!(words >> matrix(k / 3, k % 3))) return std::nullopt;
  }
  std::string rest;
  if (words >> rest || !matrix.allFinite()) return std::nullopt;
  const double off = (matrix * matrix.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (off > kDigits || matrix.determinant() < 0.0) return std::nullopt;
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

}  // namespace

Angle slip_limit(const LimitsConfig& limits, const Tolerances& tolerances) {
  const Angle once = std::max(tolerances.zero, tolerances.initial_turn);
  return limits.slip.value_or(once * (kFalseAlarmDeviate * std::numbers::sqrt2));
}

Angle angle_limit(const LimitsConfig& limits, const Tolerances& tolerances) {
  return limits.angle.value_or(tolerances.step * kFalseAlarmDeviate);
}

double drift_limit(const LimitsConfig& limits, const Tolerances& tolerances) {
  return limits.drift.value_or(tolerances.drift * kFalseAlarmDeviate);
}

double gain_limit(const Tolerances& tolerances) {
  return tolerances.sensitivity_drift * kFalseAlarmDeviate;
}

double temperature_change_limit_degc(const LimitsConfig& limits, const Tolerances& tolerances) {
  return limits.temperature_change_degc.value_or(drift_limit(limits, tolerances) /
                                                 kUsualTemperatureCoefficient);
}

double stability_limit(const LimitsConfig& limits, const Tolerances& tolerances) {
  return limits.stability.value_or(tolerances.drift);
}

double stability_limit_degc(const LimitsConfig& limits, const Tolerances& tolerances) {
  return limits.stability_degc.value_or(tolerances.drift / kUsualTemperatureCoefficient);
}

std::optional<double> nominal_response(const ExpectedItem& item, std::string_view response_unit,
                                       double g_loc_mps2) {
  if (item.nominal_sensitivity) return *item.nominal_sensitivity * g_loc_mps2 / kStandardGravity;
  const auto unit_mps2 = acceleration_unit_mps2(response_unit);
  return unit_mps2 ? std::optional(g_loc_mps2 / *unit_mps2) : std::nullopt;
}

std::optional<Eigen::Matrix3d> mounting_matrix(std::string_view mounting) {
  if (const auto rotation = rotation_of_numbers(mounting)) return rotation;
  std::istringstream words{std::string(mounting)};
  Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
  Eigen::Index row = 0;
  for (std::string word; words >> word; ++row) {
    if (row == 3) return std::nullopt;
    const double sign = word.front() == '-' ? -1.0 : 1.0;
    if (word.front() == '-' || word.front() == '+') word.erase(0, 1);
    const auto axis = std::string_view("xyz").find(word);
    if (word.size() != 1 || axis == std::string_view::npos) return std::nullopt;
    matrix(row, static_cast<Eigen::Index>(axis)) = sign;
  }
  const bool each_once = row == 3 && (matrix.cwiseAbs().colwise().sum().array() == 1.0).all();
  return each_once ? std::optional(matrix) : std::nullopt;
}

}  // namespace abcal
