#pragma once

#include <Eigen/Core>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/xml/xml_tree.h"
#include "protocol/analysis/calibration_result.h"

namespace abcal {

/// A number that is not finite where the certificate needs one.
class NumberNotFinite : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The shortest digits that read back as the same number, whatever the locale: "1e-05", "9.80101".
/// @throws NumberNotFinite  naming `what`
std::string dsi_number(double value, std::string_view what);

/// Several values with their uncertainty, as D-SI lists them (si:realListXMLList). Values in `units`; where
/// D-SI does not know one of these, an si:hybrid gives them in SI units first and then as they are, with the
/// unit behind each label ("O_u[|g]").
struct ValueList {
  std::vector<std::string> labels;  ///< Without blanks.
  Eigen::VectorXd values;
  Eigen::VectorXd standard_uncertainty;
  std::vector<std::string> units;             ///< As in a result, one for each value: "V/g_loc".
  std::optional<Eigen::MatrixXd> covariance;  ///< In products of `units`.
};

/// Takes values, uncertainties and units of quantities.
ValueList list_of(const std::vector<std::string>& labels, const std::vector<Quantity>& quantities,
                  std::optional<Eigen::MatrixXd> covariance = {});

/// Adds the list: expanded uncertainty with k = 2, and where there is a covariance, it and the factor of an
/// ellipsoid of 95 % (JCGM 102:2011, 6.5.2.2).
/// @throws NumberNotFinite
void add_value_list(XmlElement& quantity, const ValueList& list);

/// Adds one value (si:real, or si:hybrid), with expanded uncertainty if there is one.
/// @throws NumberNotFinite
void add_value(XmlElement& quantity, const Quantity& value, std::string_view what);

/// Factor k_p of an ellipsoid in m dimensions that holds the fraction p of a normal distribution: square root
/// of the p-quantile of chi-squared with m degrees of freedom.
double ellipsoid_factor(int dimensions, double probability);

}  // namespace abcal
