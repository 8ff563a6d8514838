#include "app/results/analysis/estimators.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/norm/norm_fit.h"

namespace abcal {

const std::vector<Estimator>& estimators() {
  static const std::vector<Estimator> kAll{
      {.name = "abc",
       .words = " as published, corrected for non-linearity (k2, k3)",
       .certifiable = true,
       .rests_on_stated_sizes = true,
       .fit = [](const RunRecord& record) { return analyse_abc(record); }},
      {.name = "joint",
       .words = ", one least-squares fit of all readings with the stage's errors as unknowns",
       .certifiable = true,
       .fits_stage_errors = true},
      {.name = "norm",
       .words = ", which uses only the magnitude of gravity and no angles, and therefore gives no matrix; "
                "where a table states the directions of its poses, these as well",
       .needs_angles = false,
       .fits_stage_errors = true,
       .fit = [](const RunRecord& record) { return analyse_norm(record); }},
  };
  return kAll;
}

const std::vector<std::string>& estimator_names() {
  static const std::vector<std::string> kNames = [] {
    std::vector<std::string> names;
    for (const Estimator& estimator : estimators()) names.push_back(estimator.name);
    return names;
  }();
  return kNames;
}

std::string estimator_choice() {
  std::string text;
  const std::vector<std::string>& names = estimator_names();
  for (std::size_t i = 0; i < names.size(); ++i)
    text += (i == 0 ? "" : i + 1 == names.size() ? " or " : ", ") + names[i];
  return text;
}

const Estimator& find_estimator(std::string_view name) {
  for (const Estimator& estimator : estimators()) {
    if (estimator.name == name) return estimator;
  }
  throw std::invalid_argument(fmt::format("estimator \"{}\"; required: {}", name, estimator_choice()));
}

const Estimator& declared_estimator(const RunRecord& record) {
  return find_estimator(record.estimator.empty() ? kPublishedEstimator : std::string_view(record.estimator));
}

const CalibrationResult& result_of(const std::vector<CalibrationResult>& results,
                                   std::string_view estimator) {
  const auto found = std::find_if(results.begin(), results.end(), [&](const CalibrationResult& result) {
    return result.estimator == estimator;
  });
  if (found == results.end()) throw std::logic_error(fmt::format("no result of estimator {}", estimator));
  return *found;
}

}  // namespace abcal
