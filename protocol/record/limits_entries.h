#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>

#include "protocol/plan/limits.h"

namespace abcal {

/// What the analysis compares a run with, as named texts: they stand in a run file's meta table and above the
/// header line of its CSV copy. What is absent follows from tolerances and noise.
std::map<std::string, std::string> limits_entries(const LimitsConfig& limits, const ExpectedItem& expected);

/// The reverse. `number` and `text` give what stands behind a name, nothing if the name is absent; what is
/// absent (in files of before there were limits, everything) stays as it is.
void read_limits_entries(const std::function<std::optional<double>(const std::string&)>& number,
                         const std::function<std::optional<std::string>(const std::string&)>& text,
                         LimitsConfig& limits, ExpectedItem& expected);

}  // namespace abcal
