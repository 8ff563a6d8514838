#pragma once

#include <optional>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/measurand.h"
#include "app/laboratory/certificate/stated_result.h"
#include "app/laboratory/certificate/words.h"

namespace abcal {

/// RefTypes of the state, which readers of certificates look for.
inline constexpr const char *kStateType = "abc_state", *kStateValues = "abc_stateValues",
                            *kStateGravity = "abc_stateGravity", *kStateDegrees = "abc_stateDegreesOfFreedom",
                            *kStateCovariance = "abc_stateCovariance",
                            *kMeasuredCovariance = "abc_stateCovarianceAsMeasured",
                            *kEquationCovariance = "abc_stateCovarianceEquation",
                            *kCovarianceRow = "abc_covarianceRow";

/// Adds the state from which every number of a calibration follows, in SI units with twelve digits: the
/// sensitivities row by row and the offsets, local gravity and its standard uncertainty, the finite effective
/// degrees of freedom of each output without local gravity, the covariance of the outputs as it is stated,
/// that before it was raised to a scope where it was, and that of M and b. Each row of a covariance is as
/// many lists as the outputs have units, since a list has one unit (decision 21). The stated mounting is a
/// quantity of the item.
void add_state(XmlElement& results, const Words& words, const StatedResult& stated,
               const std::optional<CustomerEquation>& equation);

}  // namespace abcal
