#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/words.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// A statement of conformity, as the certificate's schema names it ("pass", "conditionalPass", ...).
enum class Conformity { kPass, kConditionalPass, kConditionalFail, kFail };
std::string_view to_string(Conformity conformity);

/// How measured values and limits make a statement of conformity (ISO/IEC 17025 7.8.6). The acceptance limit
/// lies inside the tolerance limit by the guard band w.
enum class DecisionKind {
  kSimple,                ///< w = 0: pass or fail.
  kGuardBand,             ///< w = r U: pass or fail.
  kNonBinary,             ///< w = r U: pass, conditional pass, conditional fail, fail.
  kTestUncertaintyRatio,  ///< w from the ratio of tolerance to U, so that at most 2 % are accepted falsely.
};

struct DecisionRule {
  DecisionKind kind = DecisionKind::kGuardBand;
  double guard_factor = 1.0;  ///< r of w = r U; not used by kSimple and kTestUncertaintyRatio.
  std::string agreement;      ///< Where the customer agreed to it before measuring: an order, a contract.
};

/// The rule and its level of risk, in one sentence for the certificate.
Wording describe(const DecisionRule& rule, const Words& words);

/// Requirement on a quantity. At least one of the two limits is present.
struct SpecificationLimit {
  std::string quantity;  ///< "intrinsic_sensitivity_u", "offset_w", "transverse_sensitivity_v", ...
  std::string unit;      ///< Unit of the limits.
  std::optional<double> lower, upper;
  std::string source;      ///< The specification: a data sheet and its revision.
  std::uint32_t line = 0;  ///< In the laboratory file.
};

/// One decision and its reasons; its numbers are those that the certificate prints, in the SI unit of the
/// quantity.
struct Decision {
  SpecificationLimit stated;  ///< The limit as the customer states it.
  SpecificationLimit limit;   ///< The same limit, converted to the SI unit of the quantity.
  Quantity quantity;          ///< The stated quantity that was decided on.
  double value = 0.0;
  double standard_uncertainty = 0.0;
  double coverage_factor = 2.0;
  double expanded_uncertainty = 0.0;  ///< U = k u
  double guard_band = 0.0;            ///< w
  std::optional<double> lower_acceptance, upper_acceptance;
  double conformance_probability = 0.0;  ///< JCGM 106: that the true value lies inside the limits.
  Conformity conformity = Conformity::kFail;
};

/// Guard band for limits, for a value with expanded uncertainty U.
/// @throws std::invalid_argument  kTestUncertaintyRatio without both limits
double guard_band(const DecisionRule& rule, const SpecificationLimit& limit, double expanded_uncertainty);

/// Probability that a normally distributed true value lies inside the limits (JCGM 106:2012, 7.2..7.4):
/// Phi((upper - y)/u) - Phi((lower - y)/u), exact also far in the tails.
double conformance_probability(double value, double standard_uncertainty, const std::optional<double>& lower,
                               const std::optional<double>& upper);

/// @param value, standard_uncertainty in the limit's unit
/// @param factor  k of U = k u
/// @throws std::invalid_argument  value or uncertainty not finite, uncertainty negative, no limit at all
Decision decide(const DecisionRule& rule, const SpecificationLimit& limit, double value,
                double standard_uncertainty, double factor = 2.0);

/// Decides from numbers as they are printed, so that a reader of the numbers comes to the same decision. The
/// acceptance limits are rounded to the last place of the value, towards the inside.
/// @param printed  value and U = k u, in the limit's unit
/// @throws as decide()
Decision decide_printed(const DecisionRule& rule, const SpecificationLimit& limit,
                        const RoundedValue& printed, double factor);

}  // namespace abcal
