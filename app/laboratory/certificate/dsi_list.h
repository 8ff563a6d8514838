#pragma once

#include <Eigen/Core>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/scope.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// A number that is not finite where the certificate needs one.
class NumberNotFinite : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Twelve significant digits at most, independent of the locale: "1e-05", "9.80101", "296.15".
/// @throws NumberNotFinite  naming `what`
std::string dsi_number(double value, std::string_view what);

/// A value and its expanded uncertainty in decimals: two significant digits of the uncertainty (ILAC-P14),
/// the value to the same place.
struct RoundedValue {
  std::string value, expanded;
  std::optional<int> place;  ///< Power of ten of the last digit. Absent: no uncertainty, all digits.
};

/// @throws NumberNotFinite  naming `what`; std::invalid_argument  for a negative uncertainty
RoundedValue rounded_value(double value, double expanded, std::string_view what);

/// Value and U of a quantity as a certificate prints them in its SI unit (of D-SI).
/// @throws as rounded_value()
RoundedValue printed_in_si(const Quantity& quantity, std::string_view what);

/// Several values of one unit with their uncertainty, as D-SI lists them (si:realListXMLList). Where D-SI
/// does not know the unit, an si:hybrid gives them in SI units first and then in their own unit, which
/// follows each label ("O_u[|g]").
struct ValueList {
  std::vector<std::string> labels;  ///< Without blanks.
  Eigen::VectorXd values;
  Eigen::VectorXd standard_uncertainty;
  Eigen::VectorXd coverage_factor;
  Eigen::VectorXd degrees_of_freedom;
  std::string unit;                           ///< Unit of a result: "V/g_loc".
  std::optional<Eigen::MatrixXd> covariance;  ///< In the square of `unit`.
  std::vector<ScopeMark> marks;               ///< One for each value; empty: no scope.
  /// Values that belong together, as coefficients of a polynomial do, have more digits than U: rounded alone,
  /// their sum would be off by more than its uncertainty.
  bool all_digits = false;
};

/// Takes values, uncertainties, coverage factors and the unit of quantities.
/// @throws std::logic_error  for quantities of different units: lists of these draw warnings of the
/// Schematron
ValueList list_of(const std::vector<std::string>& labels, const std::vector<Quantity>& quantities,
                  std::optional<Eigen::MatrixXd> covariance = {});

/// Adds the list: expanded uncertainty with its coverage factors and, if the list has a covariance, this and
/// the factor of an ellipsoid of kCoverageProbability (JCGM 102:2011, 6.5.2.2).
/// @throws NumberNotFinite
void add_value_list(XmlElement& quantity, const ValueList& list);

/// Adds bare numbers, each with its label, in a unit of D-SI. @param numbers  as dsi_number() writes them
void add_number_list(XmlElement& quantity, const std::vector<std::string>& labels,
                     const std::vector<std::string>& numbers, const std::string& unit);

/// Adds one value (si:real, or si:hybrid), with expanded uncertainty if it has one.
/// @throws NumberNotFinite
void add_value(XmlElement& quantity, const Quantity& value, std::string_view what);

/// Factor k_p of an ellipsoid in m dimensions that holds the fraction p of a normal distribution: square root
/// of the p-quantile of chi-squared with m degrees of freedom.
double ellipsoid_factor(int dimensions, double probability);

}  // namespace abcal
