#include "app/laboratory/compare/compared_result.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "app/laboratory/compare/check_chart.h"
#include "app/laboratory/compare/covariance_table.h"
#include "app/laboratory/compare/read_certificate.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/other_file.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/run_config.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) {
    if (!word.empty()) text += (text.empty() ? "" : " ") + word;
  }
  return text;
}

void describe_run(const StoredRun& run, ComparedResult& result) {
  result.kind = "run";
  result.date = run.header.created_utc;
  result.labels = run.header.labels;
  const ChartSubject subject = subject_of(run);
  result.item_serial_number = subject.serial_number;
  result.item = joined({subject.maker, subject.model, subject.serial_number});
  result.stage = subject.bench.stage;
  result.stage_serial_number = subject.bench.stage_serial_number;
  if (run.state != RunState::kComplete)
    result.notes.push_back(fmt::format("the run is {}", to_string(run.state)));
}

void set_values(const CalibrationResult& calibration, ComparedResult& result) {
  result.estimator = calibration.estimator;
  result.what = calibration.estimator + " estimator";
  result.unit_name = calibration.response_unit;
  result.unit = meaning_of_response_unit(calibration.response_unit);
  if (std::isfinite(calibration.g_loc.value)) {
    result.g_loc = calibration.g_loc;
    result.g_loc_source = calibration.g_loc_source;
  }
  result.values = intrinsic_values(calibration);
  IntrinsicValues type_a;
  for (Eigen::Index i = 0; i < 9; ++i)
    type_a(i) = intrinsic_property(calibration, i).type_a.value_or(std::nan(""));
  if (!calibration.covariance_intrinsic) {
    throw std::runtime_error(result.file + ": the " + calibration.estimator +
                             " estimator gives no uncertainties, so that nothing can be compared");
  }
  result.covariance = *calibration.covariance_intrinsic;
  if (type_a.allFinite()) result.type_a = type_a;
  if (calibration.sensitivity_matrix && calibration.covariance) {
    result.matrix = calibration.sensitivity_values();
    result.output_covariance = *calibration.covariance;
  }
  if (calibration.verdict == Verdict::kDoubtful)
    result.notes.push_back("its result is doubtful: " + calibration.why);
}

/// The nine intrinsic properties of the published formula take the place of those of the line response.
void set_published(const PublishedResult& published, ComparedResult& result) {
  IntrinsicValues type_a;
  const auto take = [&](const std::array<Quantity, 3>& of, Eigen::Index first) {
    for (Eigen::Index j = 0; j < 3; ++j) {
      const Quantity& quantity = of[static_cast<std::size_t>(j)];
      result.values(first + j) = quantity.value;
      type_a(first + j) = quantity.type_a.value_or(std::nan(""));
    }
  };
  take(published.intrinsic_sensitivity, 0);
  take(published.intrinsic_angle, 3);
  take(published.offset, 6);
  Eigen::Matrix3d matrix;
  for (Eigen::Index j = 0; j < 3; ++j)
    for (Eigen::Index k = 0; k < 3; ++k)
      matrix(j, k) =
          published.sensitivity_matrix[static_cast<std::size_t>(j)][static_cast<std::size_t>(k)].value;
  result.matrix = matrix;
  result.covariance = published.covariance_intrinsic;
  result.output_covariance = published.covariance;
  result.type_a = type_a.allFinite() ? std::optional(type_a) : std::nullopt;
  result.published = true;
  result.what += ", published formula";
}

/// Multiplies outputs by factors: sensitivities by one, offsets by another.
void scale(ComparedResult& result, double sensitivity, double offset) {
  IntrinsicValues factors = IntrinsicValues::Ones();
  factors.head<3>().setConstant(sensitivity);
  factors.tail<3>().setConstant(offset);
  result.values = result.values.cwiseProduct(factors);
  result.covariance = factors.asDiagonal() * result.covariance * factors.asDiagonal();
  if (result.type_a) result.type_a = result.type_a->cwiseProduct(factors);
  if (!result.matrix) return;
  *result.matrix *= sensitivity;
  Eigen::Matrix<double, 12, 1> output_factors = Eigen::Matrix<double, 12, 1>::Constant(sensitivity);
  output_factors.tail<3>().setConstant(offset);
  result.output_covariance =
      output_factors.asDiagonal() * result.output_covariance * output_factors.asDiagonal();
}

/// R/g_loc to R/(m/s2): all sensitivities take part in the uncertainty of g_loc together.
void divide_by_gravity(ComparedResult& result) {
  const double g = result.g_loc->value;
  const double u = result.g_loc->standard_uncertainty / g;
  scale(result, 1.0 / g, 1.0);
  result.per_g_loc = false;
  if (!(u > 0.0)) return;
  IntrinsicValues change = IntrinsicValues::Zero();
  change.head<3>() = -u * result.values.head<3>();
  result.covariance += change * change.transpose();
  if (!result.matrix) return;
  Eigen::Matrix<double, 12, 1> output_change = Eigen::Matrix<double, 12, 1>::Zero();
  for (Eigen::Index j = 0; j < 3; ++j)
    output_change.segment<3>(3 * j) = -u * result.matrix->row(j).transpose();
  result.output_covariance += output_change * output_change.transpose();
}

bool same_gravity(const ComparedResult& a, const ComparedResult& b) {
  return a.g_loc && b.g_loc && a.g_loc->value == b.g_loc->value && a.g_loc_source == b.g_loc_source;
}

void convert_response(const ComparedResult& first, ComparedResult& result) {
  if (result.unit_name == first.unit_name) return;
  UnitMeaning meaning = result.unit;
  UnitMeaning wanted = first.unit;
  // A certificate has no unit for counts: it uses \one and explains it in words.
  const auto is_count = [](const UnitMeaning& unit) {
    return unit.powers == std::map<std::string, int>{{"LSB", 1}};
  };
  if (meaning.powers.empty() && is_count(wanted)) meaning.powers = wanted.powers;
  if (wanted.powers.empty() && is_count(meaning)) wanted.powers = meaning.powers;
  if (!meaning.same_kind(wanted)) {
    throw CompareError(
        fmt::format("{} is in {} and {} in {}: these cannot be made into one another; required: results in "
                    "units of one kind",
                    first.file, first.unit_name, result.file, result.unit_name));
  }
  const double factor = meaning.factor / wanted.factor;
  if (factor != 1.0) scale(result, factor, factor);
  result.notes.push_back(fmt::format("given in {}, here in {}", result.unit_name, first.unit_name));
  result.unit_name = first.unit_name;
  result.unit = first.unit;
}

}  // namespace

namespace {

void identify(const std::filesystem::path& path, ComparedResult& result) {
  result.sha256 = sha256_of_file(path);
  if (RunFile::looks_like_run_file(path)) result.chains = {last_dwell_link(path)};
}

void take_result(const CalibrationResult& calibration, ComparedResult& result) {
  if (calibration.verdict == Verdict::kNotUsable)
    throw std::runtime_error(fmt::format("{}: no usable result: {}", result.file, calibration.why));
  set_values(calibration, result);
}

ComparedResult compared_certificate(const std::string& file) {
  ComparedResult certified = read_certificate(file);
  identify(file, certified);
  return certified;
}

ComparedResult compared_item(const std::string& file, std::shared_ptr<const AnalysedRun> run, int k) {
  const AnalysedItem& item = run->item(k);
  ComparedResult result;
  result.file = name_of_item(file, item.stored);
  result.kind = "CSV";
  identify(file, result);
  if (RunFile::looks_like_run_file(file) || !run->runs.empty()) describe_run(item.stored, result);
  if (!run->runs.empty()) result.kind = "measurement";
  for (const RunOfMeasurement& part : run->runs) result.chains.push_back(last_dwell_link(part.file));
  take_result(item.results.front(), result);
  result.run = std::move(run);
  result.item_of_run = k;
  if (result.estimator == "joint" && !result.of_common_fit())
    result.notes.push_back("not in the common fit of its run: " + result.joint().why_not);
  result.record = item.stored.record;
  return result;
}

}  // namespace

const TrayItemResult& ComparedResult::joint() const {
  return run->joint.items.at(static_cast<std::size_t>(item_of_run) - 1);
}

bool ComparedResult::of_common_fit() const {
  return run && estimator == "joint" && joint().in_common_fit;
}

std::vector<ComparedResult> load_compared(const std::vector<std::string>& names, const std::string& estimator,
                                          int item, const TableOptions& options) {
  std::map<std::filesystem::path, std::shared_ptr<const AnalysedRun>> runs;
  std::vector<ComparedResult> results;
  for (const std::string& name : names) {
    NamedItem named = named_item(name);
    const std::string file = named.file.string();
    if (looks_like_xml(file)) {
      results.push_back(compared_certificate(file));
      continue;
    }
    if (looks_like_covariance_table(file)) {
      results.push_back(read_covariance_table(file));
      continue;
    }
    if (named.item == 0) named.item = item;
    const auto count = static_cast<int>(items_of_file(file));
    const bool all = named.item == 0 && (count == 1 || names.size() == 1);
    if (!all && (named.item < 1 || named.item > count))
      throw CompareError(
          fmt::format("{}: {} has {} items; required: {}#1 to {}#{}, or this run alone, which compares its "
                      "items with one another",
                      name, file, count, file, file, count));
    std::error_code ignored;
    std::shared_ptr<const AnalysedRun>& run = runs[std::filesystem::weakly_canonical(file, ignored)];
    if (!run)
      run = std::make_shared<const AnalysedRun>(
          analyse_file_by(file, estimator, RunFile::looks_like_run_file(file) ? TableOptions() : options));
    for (const AnalysedItem& each : run->items)
      if (all || each.stored.item == named.item)
        results.push_back(compared_item(file, run, each.stored.item));
  }
  return results;
}

std::string estimator_to_compare(const std::string& stated, bool shared_stage) {
  return stated.empty() && shared_stage ? std::string(kPublishedEstimator) : stated;
}

void take_published_formula(std::vector<ComparedResult>& results) {
  std::vector<std::string> problems;
  for (ComparedResult& result : results) {
    if (!result.run) {
      if (!result.estimator.empty())
        problems.push_back(
            fmt::format("{}: a certificate of the line response; required: the run that it certifies, or a "
                        "certificate of another program",
                        result.file));
      continue;
    }
    const std::optional<PublishedResult>& published =
        result.run->item(result.item_of_run).results.front().published;
    if (!published) {
      problems.push_back(fmt::format("{}: a result of the {} estimator; required: --estimator {}",
                                     result.file, result.estimator, kPublishedEstimator));
      continue;
    }
    set_published(*published, result);
  }
  if (!problems.empty()) throw CompareError("--published: " + fmt::format("{}", fmt::join(problems, "; ")));
}

std::vector<std::string> convert_to_common_units(std::vector<ComparedResult>& results) {
  std::vector<std::string> notes;
  const ComparedResult& first = results.front();
  const bool all_per_g_loc =
      std::all_of(results.begin(), results.end(), [](const ComparedResult& r) { return r.per_g_loc; });
  const bool all_known = std::all_of(results.begin(), results.end(), [](const ComparedResult& r) {
    return r.g_loc.has_value() || !r.per_g_loc;
  });
  const bool one_place = std::all_of(results.begin(), results.end(),
                                     [&](const ComparedResult& r) { return same_gravity(first, r); });
  if (!all_per_g_loc && !all_known) {
    std::string missing;
    for (const ComparedResult& r : results) {
      if (r.per_g_loc && !r.g_loc) missing += (missing.empty() ? "" : ", ") + r.file;
    }
    throw CompareError(missing +
                       ": local gravity is not known, so that sensitivities per g_loc cannot be compared "
                       "with a certificate's per m/s2; required: a run file");
  }
  if (all_per_g_loc && !all_known) {
    notes.push_back(
        "local gravity is not known of every result: sensitivities are per g_loc, and equal only if gravity "
        "was the same");
  } else if (!(all_per_g_loc && one_place)) {
    for (ComparedResult& result : results) {
      if (result.per_g_loc) divide_by_gravity(result);
    }
    notes.push_back("sensitivities are per m/s2, with the uncertainty of each local gravity");
  }
  for (ComparedResult& result : results) convert_response(first, result);
  return notes;
}

SameStage on_same_stage(const ComparedResult& first, const ComparedResult& second) {
  if (first.run && first.run == second.run) return SameStage::kYes;
  if (first.stage.empty() || second.stage.empty()) return SameStage::kUnknown;
  if (first.stage != second.stage) return SameStage::kNo;
  return first.stage_serial_number.empty() ? SameStage::kUnknown : SameStage::kYes;
}

std::array<std::string, 9> units_of_properties(const ComparedResult& result) {
  const std::string& unit = result.unit_name;
  const std::string output = unit.find('/') == std::string::npos ? unit : "(" + unit + ")";
  const std::string sensitivity = output + (result.per_g_loc ? "/g_loc" : "/(m/s2)");
  return {sensitivity, sensitivity, sensitivity, "degree", "degree", "degree", unit, unit, unit};
}

}  // namespace abcal
