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
#include "app/results/analysis/stored_result.h"
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

/// All that tells one measurement from another before it is analysed.
ComparedResult identified(const std::string& name, const std::filesystem::path& file) {
  ComparedResult result;
  std::error_code ignored;
  result.file = name;
  result.path = std::filesystem::weakly_canonical(file, ignored);
  if (!std::filesystem::is_regular_file(file, ignored)) return result;  // load_items() refuses it.
  result.sha256 = sha256_of_file(file);
  if (RunFile::looks_like_run_file(file)) result.chains = {last_dwell_link(file)};
  return result;
}

void take_result(const CalibrationResult& calibration, ComparedResult& result) {
  if (calibration.verdict == Verdict::kNotUsable)
    throw std::runtime_error(fmt::format("{}: no usable result: {}", result.file, calibration.why));
  set_values(calibration, result);
}

/// A named file, before it is analysed.
struct NamedResult {
  NamedItem named;       ///< Item 0: all items.
  bool has_runs = true;  ///< A run, a measurement or a table of readings.
  ComparedResult identity;
};

NamedResult look_at(const std::string& name, int item, bool alone) {
  NamedResult out{named_item(name), true, {}};
  NamedItem& named = out.named;
  const std::string file = named.file.string();
  out.has_runs = !looks_like_xml(file) && !looks_like_covariance_table(file);
  if (out.has_runs) {
    if (named.item == 0) named.item = item;
    const auto count = static_cast<int>(items_of_file(file));
    const bool all = named.item == 0 && (count == 1 || alone);
    if (!all && (named.item < 1 || named.item > count))
      throw CompareError(
          fmt::format("{}: {} has {} items; required: {}#1 to {}#{}, or this run alone, which compares its "
                      "items with one another",
                      name, file, count, file, file, count));
  }
  out.identity = identified(name, named.file);
  out.identity.item_of_run = std::max(1, named.item);
  return out;
}

/// A certificate, or a table of quantities with their covariance.
ComparedResult certificate_or_table(const NamedResult& of) {
  ComparedResult stated =
      looks_like_xml(of.named.file) ? read_certificate(of.named.file) : read_covariance_table(of.named.file);
  stated.path = of.identity.path;
  stated.sha256 = of.identity.sha256;
  return stated;
}

/// A file and its results.
struct LoadedFile {
  std::shared_ptr<const AnalysedRun> run;
  bool is_stored = false;
};

/// The run as its stored result describes it; without a run if a fit is required.
LoadedFile stored_run(CheckedRun& run, const std::string& estimator) {
  std::optional<CalibrationResult> result = stored_result(run, estimator);
  if (!result) return {};
  AnalysedRun analysed;
  TrayItemResult& joint = analysed.joint.items.emplace_back();
  joint.result = *result;
  joint.in_common_fit = true;  // The fit of one item.
  analysed.items.push_back({std::move(run.items.front()), {*std::move(result)}});
  return {std::make_shared<const AnalysedRun>(std::move(analysed)), true};
}

LoadedFile load_file(const std::string& file, const std::string& asked, ResultSource source,
                     const TableOptions& options) {
  if (!RunFile::looks_like_run_file(file))
    return {std::make_shared<const AnalysedRun>(analyse_file_by(file, asked, options)), false};
  const auto estimator_of = [&](const CheckedRun& run) {
    return asked.empty() ? declared_estimator(run.items.front().record).name : asked;
  };
  if (source == ResultSource::kStored)
    if (std::optional<CheckedRun> run = read_if_as_closed(file))
      if (LoadedFile stored = stored_run(*run, estimator_of(*run)); stored.run) return stored;
  CheckedRun run = load_run(file).value();
  const std::string estimator = estimator_of(run);
  return {std::make_shared<const AnalysedRun>(analyse_run(std::move(run.items), estimator)), false};
}

ComparedResult compared_item(const NamedResult& of, const LoadedFile& loaded, int k) {
  const std::string file = of.named.file.string();
  const AnalysedRun& run = *loaded.run;
  const AnalysedItem& item = run.item(k);
  ComparedResult result = of.identity;
  result.file = name_of_item(file, item.stored);
  result.kind = "CSV";
  if (RunFile::looks_like_run_file(file) || !run.runs.empty()) describe_run(item.stored, result);
  if (!run.runs.empty()) result.kind = "measurement";
  for (const RunOfMeasurement& part : run.runs) result.chains.push_back(last_dwell_link(part.file));
  take_result(item.results.front(), result);
  result.run = loaded.run;
  result.item_of_run = k;
  result.is_stored = loaded.is_stored;
  if (result.estimator == "joint" && !result.of_common_fit())
    result.notes.push_back("not in the common fit of its run: " + result.joint().why_not);
  result.record = item.stored.record;
  return result;
}

/// Whether all dwells of two records have the same means: a record and its copy in another form.
bool same_readings(const RunRecord& first, const RunRecord& second) {
  return !first.dwells.empty() &&
         std::ranges::equal(first.dwells, second.dwells, [](const DwellRecord& a, const DwellRecord& b) {
           return a.experiment == b.experiment && a.n == b.n && a.closing == b.closing && a.mean == b.mean &&
                  a.u_mean == b.u_mean;
         });
}

/// Whether two results are of one measurement. Different items of one file are not.
bool of_one_measurement(const ComparedResult& first, const ComparedResult& second) {
  if (!first.path.empty() && first.path == second.path) return first.item_of_run == second.item_of_run;
  if (first.sha256 == second.sha256 && !first.sha256.empty()) return true;
  const auto is_of_both = [&](const std::string& chain) {
    return !chain.empty() && std::ranges::count(second.chains, chain) > 0;
  };
  if (std::ranges::any_of(first.chains, is_of_both)) return true;
  if (!first.chains.empty() && !second.chains.empty()) return false;
  return first.record && second.record && first.record->response_unit == second.record->response_unit &&
         same_readings(*first.record, *second.record);
}

}  // namespace

void require_different_measurements(const std::vector<ComparedResult>& results) {
  std::vector<std::string> problems;
  for (std::size_t i = 1; i < results.size(); ++i) {
    const auto copied =
        std::find_if(results.begin(), results.begin() + static_cast<std::ptrdiff_t>(i),
                     [&](const ComparedResult& r) { return of_one_measurement(r, results[i]); });
    if (copied == results.begin() + static_cast<std::ptrdiff_t>(i)) continue;
    const bool items = copied->item_of_run != results[i].item_of_run;
    problems.push_back(copied->file == results[i].file
                           ? fmt::format("{} is named twice", results[i].file)
                           : fmt::format("{} and {} hold the same {}", copied->file, results[i].file,
                                         items ? "run, in two files" : "measurement"));
  }
  if (problems.empty()) return;
  throw CompareError(fmt::format("{}; required: each measurement once", fmt::join(problems, "; ")));
}

const TrayItemResult& ComparedResult::joint() const {
  return run->joint.items.at(static_cast<std::size_t>(item_of_run) - 1);
}

bool ComparedResult::of_common_fit() const {
  return run && estimator == "joint" && joint().in_common_fit;
}

std::vector<ComparedResult> load_compared(const std::vector<std::string>& names, const std::string& estimator,
                                          ResultSource source, int item, const TableOptions& options) {
  std::vector<NamedResult> files;
  std::vector<ComparedResult> identities;
  for (const std::string& name : names) {
    files.push_back(look_at(name, item, names.size() == 1));
    identities.push_back(files.back().identity);
  }
  require_different_measurements(identities);
  std::map<std::filesystem::path, LoadedFile> loaded;
  std::vector<ComparedResult> results;
  for (const NamedResult& file : files) {
    if (!file.has_runs) {
      results.push_back(certificate_or_table(file));
      continue;
    }
    LoadedFile& of = loaded[file.identity.path];
    if (!of.run) of = load_file(file.named.file.string(), estimator, source, options);
    for (const AnalysedItem& each : of.run->items)
      if (file.named.item == 0 || each.stored.item == file.named.item)
        results.push_back(compared_item(file, of, each.stored.item));
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
