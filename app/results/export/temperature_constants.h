#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "protocol/temperature/temperature_fit.h"

namespace abcal {

/// Constants that turn readings into accelerations at the item's temperature T: a = M(T) (r - b(T)), in the
/// item's own axes (ExportFrame::kItem). Each element of M and b is a polynomial in T - T0, T measured by the
/// item's own sensor.
struct TemperatureConstants {
  /// Coefficients of the elements of M, row by row, m/s2 per response unit / K^n. They approximate the
  /// inverse of the polynomials of sensitivities and angles, which is no polynomial, to `largest_error` in
  /// the range.
  std::array<std::vector<double>, 9> M;
  double largest_error = 0.0;  ///< Largest error of M times S, 1.
  /// The polynomials of the series, with covariance: s_u, s_v, s_w, phi_uv, phi_vw, phi_wu, O_u, O_v, O_w.
  /// The last three are b.
  std::vector<TemperaturePolynomial> outputs;
  double reference_degc = 23.0;              ///< T0
  double least_degc = 0.0, most_degc = 0.0;  ///< Where the polynomials hold.
  std::string response_unit;
  double g_loc_mps2 = 9.80665;
  bool by_item = true;  ///< T is that of the item's own sensor; else of the set points.

  // For the heading of a file.
  std::string item, source, performed, verdict;

  Eigen::Matrix3d matrix_at(double degc) const;
  Eigen::Vector3d offset_at(double degc) const;
};

/// @param g_loc_mps2  local gravity at the runs
/// @throws std::invalid_argument  axes in one plane
TemperatureConstants temperature_constants(const TemperatureResult& result, double g_loc_mps2);

/// JSON (abcal.temperature_constants/1), CSV and a C header. @{
std::string temperature_constants_json(const TemperatureConstants& constants);
std::string temperature_constants_csv(const TemperatureConstants& constants);
std::string temperature_constants_c(const TemperatureConstants& constants);
/// @}

}  // namespace abcal
