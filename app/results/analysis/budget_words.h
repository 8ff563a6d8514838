#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"
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

/// The budget of a result; nothing: it has no matrix, or nothing may be read from it.
std::optional<Budget> budget_of_result(const RunRecord& record, const CalibrationResult& result);

/// An input that dominates the uncertainty of some outputs.
struct DominatingInput {
  Message input;  ///< As in BudgetLine.
  std::vector<std::pair<std::string, double>>
      outputs;  ///< Symbol, and the input's share of the variance, 0..1.
};

/// The largest line of the budget for the worst output of each kind; outputs with the same line together.
std::vector<DominatingInput> dominating_inputs(const Budget& budget);

}  // namespace abcal
