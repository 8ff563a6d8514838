#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The smallest expanded uncertainty (k = 2) that a laboratory is accredited for, or claims, in a range: its
/// calibration and measurement capability (CMC).
struct ScopeLimit {
  std::string quantity;  ///< "sensitivity", "angle", "offset"
  std::string unit;      ///< Unit of a result: "V/g_loc".
  double from = 0.0, to = 0.0;
  double cmc = 0.0;  ///< In `unit`, or a part of the value.
  bool relative = false;
  std::uint32_t line = 0;  ///< In the laboratory file; 0: from the register.
};

/// How the uncertainty of a quantity stands to the laboratory's scope.
enum class ScopeMark {
  kNone,     ///< The laboratory states neither a scope nor an accreditation.
  kWithin,   ///< U is at least the smallest of the scope.
  kRaised,   ///< U was raised, because that of the measurement is smaller.
  kOutside,  ///< No entry of the scope covers the quantity or its size.
};

/// RefTypes of the marks in the XML.
inline constexpr const char* kRaisedToScopeMark = "abc_raisedToScope";
inline constexpr const char* kOutsideScopeMark = "abc_outsideScope";

/// Permitted values of `quantity`.
const std::vector<std::string>& scope_quantities();

/// The smallest expanded uncertainty that may be stated for a quantity of a result, in its unit: the largest
/// of the entries that cover its size. Entries and quantities may be in different units of one kind
/// ("V/g_loc", "mV/g_n", "V/(m/s2)"; "degree", "mrad"; "V", "mV"). "mV/g" is per standard gravity here.
/// Absent: the scope has none.
/// @param name  name of a quantity of a result or derived from it: "sensitivity_ux", "offset_u", "bias_u";
/// the transverse
///              sensitivity and the misalignment, which depend on the mounting, are in no scope
std::optional<double> smallest_uncertainty(const std::vector<ScopeLimit>& scope,
                                           const CalibrationResult& result, const std::string& name,
                                           const Quantity& quantity);

}  // namespace abcal
