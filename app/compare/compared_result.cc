#include "app/compare/compared_result.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>

#include "app/compare/check_chart.h"
#include "app/compare/read_certificate.h"
#include "app/results/analyses.h"
#include "app/results/load_record.h"
#include "app/results/other_file.h"
#include "protocol/analysis/intrinsic_properties.h"
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
  if (run.state != RunState::kComplete)
    result.notes.push_back(fmt::format("the run is {}", to_string(run.state)));
}

void set_values(const CalibrationResult& calibration, ComparedResult& result) {
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
    throw CompareError(fmt::format(
        "{} is in {} and {} in {}: these cannot be made into one another; required: results in units of one "
        "kind",
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
  if (RunFile::looks_like_run_file(path)) result.chain = last_dwell_link(path);
}

void take_result(const CalibrationResult& calibration, ComparedResult& result) {
  if (calibration.verdict == Verdict::kNotUsable)
    throw std::runtime_error(fmt::format("{}: no usable result: {}", result.file, calibration.why));
  set_values(calibration, result);
}

/// "a.run#2" is item 2 of a.run; 0: none is named.
std::pair<std::string, int> named_item(const std::string& name) {
  std::error_code ignored;
  const std::size_t mark = name.rfind('#');
  if (mark == std::string::npos || std::filesystem::exists(name, ignored)) return {name, 0};
  int item = 0;
  const char* end = name.data() + name.size();
  const auto [rest, error] = std::from_chars(name.data() + mark + 1, end, item);
  if (error != std::errc() || rest != end || item < 1)
    throw CompareError(
        fmt::format("{}: no such file; required: a file, or FILE#K for item K (from 1) of a "
                    "run with several",
                    name));
  return {name.substr(0, mark), item};
}

ComparedResult compared_item(const std::string& file, std::shared_ptr<const TrayRun> tray, std::size_t k,
                             const std::string& estimator) {
  ComparedResult result;
  result.file = fmt::format("{}#{}", file, k + 1);
  identify(file, result);
  const StoredRun& run = tray->items.at(k);
  describe_run(run, result);
  const TrayItemResult& item = tray->tray.items.at(k);
  if (estimator.empty() || estimator == "joint") {
    take_result(item.result, result);
    if (!item.in_common_fit) result.notes.push_back("not in the common fit of its run: " + item.why_not);
  } else {
    take_result(analyse(run.record, estimator), result);
  }
  result.record = run.record;
  result.tray = std::move(tray);
  result.tray_item = k;
  return result;
}

}  // namespace

ComparedResult load_compared(const std::filesystem::path& path, const std::string& estimator) {
  if (looks_like_xml(path)) {
    ComparedResult certified = read_certificate(path);
    identify(path, certified);
    return certified;
  }
  ComparedResult result;
  result.file = path.string();
  result.kind = "CSV";
  LoadedRecord loaded = load_record(path);
  identify(path, result);
  if (loaded.run) describe_run(*loaded.run, result);
  take_result(analyse(loaded.record,
                      estimator.empty() ? declared_estimator(loaded.record) : find_estimator(estimator)),
              result);
  result.record = std::move(loaded.record);
  return result;
}

bool ComparedResult::of_common_fit() const {
  return tray && what == "joint estimator" && tray->tray.items[tray_item].in_common_fit;
}

std::vector<ComparedResult> load_all_compared(const std::vector<std::string>& names,
                                              const std::string& estimator) {
  std::map<std::filesystem::path, std::shared_ptr<const TrayRun>> trays;
  std::vector<ComparedResult> results;
  for (const std::string& name : names) {
    const auto [file, item] = named_item(name);
    const auto count = static_cast<int>(items_of_file(file));
    if (count == 1 && item <= 1) {
      results.push_back(load_compared(file, estimator));
      continue;
    }
    if (item > count || (item == 0 && names.size() > 1))
      throw CompareError(
          fmt::format("{}: {} has {} items; required: {}#1 to {}#{}, or this run alone, which "
                      "compares its items with one another",
                      name, file, count, file, file, count));
    std::shared_ptr<const TrayRun>& tray = trays[std::filesystem::canonical(file)];
    if (!tray) tray = std::make_shared<const TrayRun>(analyse_tray_run(file));
    for (int k = item == 0 ? 1 : item; k <= (item == 0 ? count : item); ++k)
      results.push_back(compared_item(file, tray, static_cast<std::size_t>(k - 1), estimator));
  }
  return results;
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
    throw CompareError(
        missing +
        ": local gravity is not known, so that sensitivities per g_loc cannot be compared with "
        "a certificate's per m/s2; required: a run file");
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

std::array<std::string, 9> units_of_properties(const ComparedResult& result) {
  const std::string& unit = result.unit_name;
  const std::string output = unit.find('/') == std::string::npos ? unit : "(" + unit + ")";
  const std::string sensitivity = output + (result.per_g_loc ? "/g_loc" : "/(m/s2)");
  return {sensitivity, sensitivity, sensitivity, "degree", "degree", "degree", unit, unit, unit};
}

}  // namespace abcal
