#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace abcal {

/// The results of a certificate as JSON, read from its XML as the pages are, so that no program has another
/// number than the customer: "number", "issued" (null: a draft), "results", each with "statements" (quantity,
/// value, unit in D-SI, U, k, decision, mark of the scope, and "printed" as on the page). A value in a unit
/// outside the SI as well is two statements. Covariances, correlations and the budget are in the XML alone.
/// Null stands for a part that a number of the XML does not have.
/// @throws std::runtime_error  no certificate
nlohmann::ordered_json certificate_json(const std::string& xml);

}  // namespace abcal
