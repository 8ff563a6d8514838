#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "app/document/document.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/derived.h"
#include "app/laboratory/certificate/page_parts.h"
#include "app/laboratory/certificate/stated_result.h"
#include "app/laboratory/certificate/statements.h"

namespace abcal {

/// The customer's equation a = M (r - b) in the axes of the platter: b are the offsets of the result.
struct CustomerEquation {
  std::vector<DerivedQuantity> M;  ///< Row by row (x: u, v, w; y; z), (m/s2)/R.
  /// Covariance of M row by row and b, local gravity included.
  Covariance12 covariance = Covariance12::Zero();
};

/// Names of the parts of an item's identity, in their order.
inline constexpr Term kIdentityWords[]{"Manufacturer", "Type", "Serial number"};

/// Unit of the elements of M: "(m/s2)/V".
std::string correction_unit(const std::string& response_unit);

/// The equation of a stated result with a matrix. M and its derivatives are those of correction_matrix(),
/// which `abcal export` uses; its uncertainty follows from that of the stated sensitivities per m/s2 and
/// offsets.
/// @return nothing where the outputs do not determine an acceleration, or its numbers are not finite
std::optional<CustomerEquation> customer_equation(const StatedResult& stated);

/// The statements that define the measurand and that say how the item's identity is known.
Statement measurand_statement(const Words& words);
Statement identity_statement(const Words& words, const ReportData& data);

/// Adds the result abc_customerEquation: M with its uncertainties. Its covariance is in the state.
void add_customer_equation(XmlElement& results, const Words& words, const CustomerEquation& equation);

/// Labels of M row by row and b.
std::vector<std::string> equation_labels();

/// Settings and mounting of the item, for its description.
void add_item_quantities(XmlElement& item, const Words& words, const ReportData& data);

/// A part of the item's identity as a page shows it: "17 (stated, not read)" where nobody read it.
/// @param part  "Serial number", as identity_statement() names it
std::string identity_value(const PageSource& from, Term part, const std::string& value);

/// Pages: the equation of a calibration; empty without numbers.
Section equation_section(const PageSource& from, xmlNode* measurement);

/// Pages: how the item was mounted, with a drawing.
Section mounting_section(const PageSource& from);

}  // namespace abcal
