#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>

#include "protocol/plan/limits.h"

namespace abcal {

/// The limits and expectations of the analysis as named texts, for a run file's meta table and for the lines
/// above the header of its CSV copy. Absent entries follow from tolerances and noise.
std::map<std::string, std::string> limits_entries(const LimitsConfig& limits, const ExpectedItem& expected);

/// The reverse. `number` and `text` return the value of a name, nullopt if it is absent; a limit without an
/// entry is left unchanged (all of them in older files without limits).
void read_limits_entries(const std::function<std::optional<double>(const std::string&)>& number,
                         const std::function<std::optional<std::string>(const std::string&)>& text,
                         LimitsConfig& limits, ExpectedItem& expected);

}  // namespace abcal
