#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/limits.h"
#include "protocol/quantities/output_names.h"

namespace abcal {

/// One number that a customer may ask for, with its uncertainty by propagation of the twelve outputs and of
/// local gravity to first order (JCGM 100), correlations included.
struct DerivedQuantity {
  std::string name;  ///< "intrinsic_sensitivity_u", "bias_w", ...: as in a laboratory file.
  Quantity value;
  /// Derivatives with respect to s row by row, O, g_loc (m/s2).
  Eigen::Matrix<double, 13, 1> gradient = Eigen::Matrix<double, 13, 1>::Zero();
};

/// Several alike, one for each axis or pair of axes.
struct DerivedGroup {
  std::string name;  ///< "transverse_sensitivity"
  Message words;
  std::vector<DerivedQuantity> quantities;
};

/// A unit of sensitivity "OUTPUT/g_n" or "OUTPUT/(m/s2)" that a customer asks for.
struct SensitivityUnit {
  std::string name;
  double output_factor = 1.0;         ///< Number of these output units in one response unit.
  bool per_standard_gravity = false;  ///< Per g_n = 9.80665 m/s2; else per m/s2.
};

/// @throws std::invalid_argument  if the unit cannot be made from the response unit
SensitivityUnit sensitivity_unit(const std::string& name, const std::string& response_unit);

/// From what quantities are derived, beside the result.
struct DeriveFrom {
  std::vector<SensitivityUnit> units = {};  ///< Further units of the sensitivities.
  /// Directions of u, v, w on the platter as they are stated, as rows (mounting_matrix()). What depends on
  /// the mounting is about these directions: u along "-z" has its transverse sensitivity across z.
  Eigen::Matrix3d mounting = Eigen::Matrix3d::Identity();
  /// Covariance of the outputs as they were measured: degrees of freedom follow from it. Absent: that of the
  /// result, which was not raised.
  std::optional<Covariance12> measured = {};
};

/// Everything that can be derived from a result. Quantities per m/s2 and per g_n include the uncertainty of
/// g_loc.
///
///   sensitivity               s_jk / g_loc, R/(m/s2)
///   intrinsic_sensitivity     s_j / g_loc, R/(m/s2)
///   transverse_sensitivity    sqrt(sum of squares across) / |along| the stated direction, % (ISO 16063-31);
///                             mounting included
///   transverse_azimuth        its direction, degree: about the stated direction, from that of the next
///   output
///                             (of u: from v towards w, of v: from w towards u, of w: from u towards v); only
///                             where the transverse sensitivity exceeds its expanded uncertainty, else NaN
///   misalignment              angle between the sensitive direction and the stated one, mrad
///   non_orthogonality         phi_jk - 90 degrees, mrad
///   bias                      O_j / s_j as an acceleration, mg with g = 9.80665 m/s2
///
/// A transverse sensitivity that does not exceed its expanded uncertainty has no direction to speak of, so
/// that its derivatives say nothing: it and the misalignment then have the uncertainty of both their
/// components.
///
/// A group of sensitivities for each of the units follows, named after the unit ("sensitivity [mV/g_n]").
/// @throws std::invalid_argument  for a result without matrix, covariance or local gravity
std::vector<DerivedGroup> derive(const CalibrationResult& result, const DeriveFrom& from = {});

/// A value and its derivatives (columns as of DerivedQuantity::gradient).
struct ValueWithGradient {
  double value = 0.0;
  Eigen::Matrix<double, 13, 1> gradient = Eigen::Matrix<double, 13, 1>::Zero();
};

/// A quantity that was computed elsewhere, with uncertainty and degrees of freedom as those of derive().
DerivedQuantity derived_quantity(const CalibrationResult& result, const DeriveFrom& from,
                                 const std::string& name, const std::string& unit,
                                 const ValueWithGradient& value);

/// Covariance of two derived quantities of one result, local gravity included.
double covariance_of(const CalibrationResult& result, const DerivedQuantity& a, const DerivedQuantity& b);

/// Names of quantities that limits may be set on: those of the result itself and the derived ones.
std::vector<std::string> names_of_quantities();

/// The values that a quantity can have.
struct QuantityRange {
  double least = -std::numeric_limits<double>::infinity(), most = std::numeric_limits<double>::infinity();
};
/// @param unit  of the range; one that is not of the quantity's kind gives no bounds
QuantityRange range_of_quantity(const std::string& name, const std::string& unit);

/// "0 % or more", "0 to 1571 mrad", "any".
std::string to_string(const QuantityRange& range, const std::string& unit);

}  // namespace abcal
