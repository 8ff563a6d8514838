#include "abcal/result.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/document/document_html.h"
#include "app/library/data.h"
#include "app/library/no_colours.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_text.h"
#include "app/results/analysis/series_of_runs.h"
#include "app/results/report/first_page.h"
#include "app/system/version.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/plan/limits.h"
#include "protocol/quantities/quantity_groups.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal::v1 {
namespace {

void set_value(Values& values, Eigen::Index row, Eigen::Index column, const ::abcal::Quantity& from) {
  values.value(row, column) = from.value;
  values.u(row, column) = from.standard_uncertainty;
  values.type_a(row, column) = from.type_a.value_or(kNan);
  values.type_b(row, column) = from.type_b.value_or(kNan);
  values.degrees_of_freedom(row, column) = from.degrees_of_freedom;
  values.unit = from.unit;
}

Values sized(Eigen::Index rows, Eigen::Index columns) {
  const Eigen::MatrixXd unknown = Eigen::MatrixXd::Constant(rows, columns, kNan);
  return {unknown, unknown, unknown, unknown, unknown, ""};
}

std::vector<QuantityGroup> quantities_of(const ::abcal::CalibrationResult& result) {
  std::vector<QuantityGroup> groups;
  for (const auto& [about, found] : ::abcal::found_groups(result)) {
    const std::size_t columns = std::max<std::size_t>(1, about.columns);
    Values values =
        sized(static_cast<Eigen::Index>(found.size() / columns), static_cast<Eigen::Index>(columns));
    for (std::size_t i = 0; i < found.size(); ++i)
      set_value(values, static_cast<Eigen::Index>(i / columns), static_cast<Eigen::Index>(i % columns),
                found[i].quantity);
    groups.push_back({about.key, std::string(about.heading.english()), about.meaning,
                      std::string(::abcal::to_string(about.kind)),
                      std::string(::abcal::to_string(about.frame)), about.symbols, std::move(values)});
  }
  return groups;
}

/// The values of a group; no values: the result does not have it.
const Values& values_of(const std::vector<QuantityGroup>& groups, std::string_view key) {
  static const Values kNone;
  const auto found = std::ranges::find(groups, key, &QuantityGroup::key);
  return found == groups.end() ? kNone : found->values;
}

Covariance outputs_covariance(const ::abcal::CalibrationResult& result) {
  Covariance covariance;
  if (!result.covariance || !result.sensitivity_matrix) return covariance;
  covariance.matrix = *result.covariance;
  covariance.values.resize(12);
  for (int i = 0; i < 12; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const ::abcal::Quantity& quantity =
        i < 9 ? (*result.sensitivity_matrix)[at / 3][at % 3] : result.offset[at - 9];
    covariance.labels.emplace_back(::abcal::output_symbol(i));
    covariance.units.push_back(quantity.unit);
    covariance.values[i] = quantity.value;
  }
  return covariance;
}

Covariance intrinsic_covariance(const ::abcal::CalibrationResult& result) {
  Covariance covariance;
  if (!result.covariance_intrinsic) return covariance;
  covariance.matrix = *result.covariance_intrinsic;
  covariance.values = ::abcal::intrinsic_values(result);
  for (std::size_t i = 0; i < ::abcal::kIntrinsicSymbols.size(); ++i) {
    covariance.labels.emplace_back(::abcal::kIntrinsicSymbols[i]);
    covariance.units.push_back(::abcal::intrinsic_property(result, static_cast<Eigen::Index>(i)).unit);
  }
  return covariance;
}

Published published_of(const ::abcal::PublishedResult& published) {
  const ::abcal::CalibrationResult result = ::abcal::as_result(published);
  const std::vector<QuantityGroup> groups = quantities_of(result);
  return {values_of(groups, "sensitivity_matrix"),
          values_of(groups, "offset"),
          values_of(groups, "intrinsic_sensitivity"),
          values_of(groups, "intrinsic_angle"),
          outputs_covariance(result),
          intrinsic_covariance(result)};
}

}  // namespace

const char* version() {
  return ::abcal::program_version();
}

Result public_result(::abcal::CalibrationResult result, const ::abcal::RunRecord& record) {
  Result::Data data;
  data.quantities = quantities_of(result);
  data.covariance = outputs_covariance(result);
  data.covariance_intrinsic = intrinsic_covariance(result);
  if (result.published) data.published = published_of(*result.published);
  data.nominal_response =
      ::abcal::nominal_response(record.expected, record.response_unit, record.g_loc.value_mps2);
  data.result = std::move(result);
  return Result(std::make_shared<const Result::Data>(std::move(data)));
}

std::string Result::estimator() const {
  return data_->result.estimator;
}

Usability Result::usability() const {
  switch (data_->result.verdict) {
    case ::abcal::Verdict::kUsable:
      return Usability::kUsable;
    case ::abcal::Verdict::kDoubtful:
      return Usability::kDoubtful;
    case ::abcal::Verdict::kNotUsable:
      break;
  }
  return Usability::kNotUsable;
}

std::string Result::verdict() const {
  return std::string(::abcal::to_string(data_->result.verdict));
}
std::string Result::why() const {
  return data_->result.why;
}
std::string Result::response_unit() const {
  return data_->result.response_unit;
}
std::vector<std::string> Result::notes() const {
  const std::vector<::abcal::Message>& notes = data_->result.diagnostics.notes;
  return {notes.begin(), notes.end()};
}
const Values& Result::sensitivity_matrix() const {
  return values_of(data_->quantities, "sensitivity_matrix");
}
const Values& Result::offset() const {
  return values_of(data_->quantities, "offset");
}
const Values& Result::intrinsic_sensitivity() const {
  return values_of(data_->quantities, "intrinsic_sensitivity");
}
const Values& Result::intrinsic_angle() const {
  return values_of(data_->quantities, "intrinsic_angle");
}
const Covariance& Result::covariance() const {
  return data_->covariance;
}
const Covariance& Result::covariance_intrinsic() const {
  return data_->covariance_intrinsic;
}

const std::vector<QuantityGroup>& Result::quantities() const {
  return data_->quantities;
}

std::vector<EffectFound> Result::effects() const {
  std::vector<EffectFound> effects;
  if (!data_->result.joint) return effects;
  for (const ::abcal::EffectTest& test : data_->result.joint->effects)
    effects.push_back({test.name, test.key, test.times_stated, test.probability, test.passed});
  return effects;
}

Values Result::alignment() const {
  return values_of(data_->quantities, "alignment");
}

const std::optional<Published>& Result::published() const {
  return data_->published;
}

std::string Result::to_json() const {
  return ::abcal::result_json(data_->result).dump(2);
}
std::string Result::to_text() const {
  return ::abcal::result_text(data_->result, no_colours());
}
std::string Result::to_html() const {
  return ::abcal::embedded_html(::abcal::result_section(data_->result, data_->nominal_response));
}

std::vector<std::string> estimators() {
  return ::abcal::estimator_names();
}

Result analyse(const Record& record, const std::string& estimator) {
  const ::abcal::RunRecord& data = record.data().record;
  return public_result(::abcal::analyse(data, estimator.empty() ? ::abcal::declared_estimator(data)
                                                                : ::abcal::find_estimator(estimator)),
                       data);
}

std::vector<Result> analyse_measurement(const std::vector<std::filesystem::path>& files) {
  std::vector<std::string> names;
  for (const std::filesystem::path& file : files) names.push_back(file.string());
  const ::abcal::AnalysedRun run = names.size() == 1 ? ::abcal::analyse_file(names.front(), "joint")
                                                     : ::abcal::analyse_series_of_runs(names, std::nullopt);
  std::vector<Result> out;
  for (const ::abcal::AnalysedItem& item : run.items)
    out.push_back(public_result(item.results.front(), item.stored.record));
  return out;
}

Result analyse_joint(const Record& record, const JointChoices& choices) {
  ::abcal::JointOptions options;
  options.nonlinearity =
      choices.nonlinearity ? ::abcal::Nonlinearity::kFitted : ::abcal::Nonlinearity::kLeftOut;
  options.drift = choices.drift;
  options.mean_step = choices.mean_step;
  options.noise_process = choices.noise_process;
  const ::abcal::RunRecord& data = record.data().record;
  options.measured_alignment = data.measured_alignment;
  return public_result(::abcal::analyse_joint(data, options), data);
}

}  // namespace abcal::v1
