#include "abcal/compare.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "app/laboratory/compare/compare_json.h"
#include "app/laboratory/compare/compare_results.h"
#include "app/laboratory/compare/compare_text.h"
#include "app/library/no_colours.h"
#include "app/results/analysis/estimators.h"
#include "protocol/plan/run_config.h"

namespace abcal::v1 {

struct [[gnu::visibility("hidden")]] Comparison::Data {
  ::abcal::ResultsComparison comparison;
};

bool Comparison::agree() const {
  return data_->comparison.agree();
}

std::vector<std::string> Comparison::why() const {
  std::vector<std::string> list;
  for (const ::abcal::PairComparison& pair : data_->comparison.pairs) list.push_back(pair.why);
  return list;
}

std::vector<double> Comparison::largest_e_n() const {
  std::vector<double> list;
  for (const ::abcal::PairComparison& pair : data_->comparison.pairs)
    list.push_back(pair.intrinsic.largest_e_n);
  return list;
}

std::string Comparison::to_json() const {
  return ::abcal::compare_json(data_->comparison).dump(2);
}
std::string Comparison::to_text() const {
  return ::abcal::compare_text(data_->comparison, no_colours());
}

Comparison compare(const std::vector<std::filesystem::path>& files, const CompareChoices& choices) {
  if (files.size() < 2)
    throw std::invalid_argument("compare: found " + std::to_string(files.size()) +
                                " file; required: two at least");
  ::abcal::CompareOptions options;
  options.shared_stage = choices.shared_stage;
  options.any_item = choices.any_item;
  options.group_by = choices.group_by;
  const std::string estimator = ::abcal::estimator_to_compare(choices.estimator, choices.shared_stage);
  const std::vector<std::string> names(files.begin(), files.end());
  return Comparison(std::make_shared<const Comparison::Data>(Comparison::Data{::abcal::compare_results(
      ::abcal::load_compared(names, estimator, ::abcal::ResultSource::kReadings), options)}));
}

}  // namespace abcal::v1
