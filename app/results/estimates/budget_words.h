#pragma once

#include <string>
#include <utility>
#include <vector>

#include "protocol/uncertainty/budget.h"

namespace abcal {

/// Degrees of freedom of a line's contributions to these outputs, without decimals: "33", "12 to 40"; empty:
/// a thousand or more, as those of a stated value.
std::string degrees_words(const BudgetLine& line, const std::vector<int>& outputs);

/// Each source of a standard uncertainty of the budget, with the inputs that have it: keys of the bench file,
/// or names of inputs without a key.
std::vector<std::pair<std::string, std::string>> budget_sources(const Budget& budget);

/// The part of g_loc in an output in SI units and per standard g; empty for an output that has nothing of it,
/// and where g_loc is not known.
std::string gravity_words(const Budget& budget, int output, const std::string& response_unit);

}  // namespace abcal
