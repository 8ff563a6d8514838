#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/words.h"
#include "drivers/text/names.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// A statement of conformity, as the certificate's schema names it ("pass", "conditionalPass", ...). None is
/// possible, "undecided", where the guard band leaves no value that could be accepted.
enum class Conformity { kPass, kConditionalPass, kConditionalFail, kFail, kUndecided };
std::string_view to_string(Conformity conformity);

/// How measured values and limits make a statement of conformity (ISO/IEC 17025 7.8.6). The acceptance limit
/// lies inside the tolerance limit by the guard band w.
enum class DecisionKind {
  kSimple,                ///< w = 0: pass or fail.
  kGuardBand,             ///< w = r U: pass or fail.
  kNonBinary,             ///< w = r U: pass, conditional pass, conditional fail, fail.
  kTestUncertaintyRatio,  ///< w from the ratio of tolerance to U, so that at most 2 % are accepted falsely.
};

/// Names of the rules, as laboratory files and certificates give them.
inline constexpr auto kDecisionRules =
    names<DecisionKind>({{DecisionKind::kSimple, "simple"},
                         {DecisionKind::kGuardBand, "guard_band"},
                         {DecisionKind::kNonBinary, "non_binary"},
                         {DecisionKind::kTestUncertaintyRatio, "test_uncertainty_ratio"}});

struct DecisionRule {
  DecisionKind kind = DecisionKind::kGuardBand;
  double guard_factor = 1.0;  ///< r of w = r U; not used by kSimple and kTestUncertaintyRatio.
  std::string agreement;      ///< Where the customer agreed to it before measuring: an order, a contract.
};

/// The rule in one sentence for the certificate. Its risk depends on the limits: Decision::risk.
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
  DecisionRule rule;
  Quantity quantity;  ///< The stated quantity that was decided on.
  double value = 0.0;
  double standard_uncertainty = 0.0;
  double coverage_factor = 2.0;
  double expanded_uncertainty = 0.0;  ///< U = k u
  double guard_band = 0.0;            ///< w
  std::optional<double> lower_acceptance, upper_acceptance;
  double conformance_probability = 0.0;  ///< JCGM 106: that the true value lies inside the limits.
  /// The largest probability with which the true value lies outside the limits although the measured one is
  /// inside the acceptance limits; both sides count. Absent: no value is accepted.
  std::optional<double> risk;
  Conformity conformity = Conformity::kFail;
};

/// Guard band for limits, for a value with expanded uncertainty U.
/// @throws std::invalid_argument  kTestUncertaintyRatio without both limits
double guard_band(const DecisionRule& rule, const SpecificationLimit& limit, double expanded_uncertainty);

/// Probability that a true value lies inside the limits (JCGM 106:2012, 7.2..7.4), if (true value - y)/u has
/// Student's distribution, that of U and k; exact also far in the tails.
/// @param degrees_of_freedom  infinite: the normal distribution
double conformance_probability(double value, double standard_uncertainty, double degrees_of_freedom,
                               const std::optional<double>& lower, const std::optional<double>& upper);

/// Decides from numbers as they are printed, so that a reader of the numbers comes to the same decision. The
/// acceptance limits are rounded to the last place of the value, towards the inside.
/// @param limit  in the SI unit of the quantity
/// @param quantity  the stated one, from whose degrees of freedom k and the probabilities follow
/// @param printed  its value and U = k u, in the limit's unit
/// @throws std::invalid_argument  value or uncertainty not finite, uncertainty negative, no limit at all
Decision decide_printed(const DecisionRule& rule, const SpecificationLimit& limit, const Quantity& quantity,
                        const RoundedValue& printed);

}  // namespace abcal
