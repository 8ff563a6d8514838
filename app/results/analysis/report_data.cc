#include "app/results/analysis/report_data.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <iterator>

#include "app/bench_file/not_real.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/recompute.h"
#include "app/results/analysis/result_text.h"
#include "app/system/version.h"
#include "drivers/instrument/driver_catalogue.h"
#include "protocol/record/run_label.h"
#include "protocol/record/sha256.h"

namespace abcal {

ItemIdentityParts identity_of(const ReportData& data) {
  if (!data.run) return identity_parts(ItemNames{}, ItemNames{});
  // Run files of before version 1.0 name the driver in their bench file only.
  std::string driver = data.run->header.items.front().driver;
  for (const RunItem& item : data.run->header.items)
    if (item.k == data.item) driver = item.driver;
  if (driver.empty() && data.bench) driver = data.bench->item(data.item).accelerometer.driver;
  return identity_parts(data.run->header, driver);
}

bool measured_by_voltmeter(const ReportData& data) {
  if (data.record.response_unit.ends_with("V")) return true;
  if (!data.bench) return false;
  const std::string& driver = data.bench->item(data.item).accelerometer.driver;
  return find_in(driver_catalogue().accelerometers, driver).traits.reads_volts;
}

std::vector<Term> unstated_voltmeter(const ReportData& data) {
  std::vector<Term> words;
  if (!measured_by_voltmeter(data)) return words;
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.key.starts_with("voltmeter_") && !data.record.tolerances.sources.contains(key.key))
      words.emplace_back(key.words);
  }
  return words;
}

std::string ReportData::label(const std::string& key) const {
  return run ? label_of(run->header.labels, key) : std::string();
}

std::string ReportData::started_utc() const {
  return run ? run->header.created_utc : std::string();
}

std::string ReportData::ended_utc() const {
  return run && !run->events.empty() ? run->events.back().utc : std::string();
}

std::pair<double, double> ReportData::settle_times_s() const {
  if (record.dwells.empty()) return {};
  const auto [least, most] = std::ranges::minmax_element(record.dwells, {}, &DwellRecord::settle_time_s);
  return {least->settle_time_s, most->settle_time_s};
}

std::vector<std::string> cautions(const ReportData& data) {
  std::vector<std::string> list;
  if (!data.complete()) {
    // After a kill or on a full disk the state of a run remains "running".
    const std::string state = data.run->state == RunState::kRunning
                                  ? "running, or ended without storing a reason"
                                  : std::string(to_string(data.run->state));
    list.push_back(fmt::format("Not complete: this run is {}, {} of {} angles are measured", state,
                               data.run->measured.size(), data.run->header.plan.size()));
  }
  const CalibrationResult& result = data.result();
  if (result.verdict != Verdict::kUsable) {
    std::string word = verdict_words(result.verdict);
    word.front() = static_cast<char>(word.front() - 'a' + 'A');
    list.push_back(fmt::format("{}: {}", word, result.why));
  }
  if (data.complete()) {
    for (const IntegrityCheck& check : data.integrity) {
      if (!check.good) list.push_back(fmt::format("Integrity not shown: {}: {}", check.what, check.found));
    }
  }
  if (!data.bench_unreadable.empty()) {
    list.push_back(fmt::format(
        "Bench not known: the bench file was written by abcal {} and cannot be read by this version; "
        "whether instruments were simulated is not known",
        data.run->header.program_version));
  }
  if (!data.simulated.empty()) {
    list.push_back(fmt::format("Simulated: the {} {} not real", fmt::join(data.simulated, " and the "),
                               data.simulated.size() == 1 ? "was" : "were"));
  }
  if (!data.label("replay.of").empty()) {
    list.push_back(fmt::format("Replayed: repeated from the recording in {}, not measured again",
                               data.label("replay.of")));
  }
  return list;
}

namespace {

/// Data common to all items of a run.
struct GatheredRun {
  std::filesystem::path path;
  std::string created_utc;
  bool is_run_file = false;
  std::vector<IntegrityCheck> integrity;  ///< As verify_run() finds it.
  std::vector<ParsedAnalysis> analyses;   ///< Those stored with a run file.
  std::optional<std::string> sha256;      ///< As in ReportData.
  std::shared_ptr<const AnalysedRun> all;
};

void describe_bench(ReportData& data) {
  try {
    data.bench = parse_bench(data.run->header.bench_toml, "its bench file");
  } catch (const BenchError& error) {
    // Written by another abcal: the header of the run holds the most important values as well.
    data.bench_unreadable = error.what();
  }
  if (data.bench) data.simulated = instruments_not_real(data.run->header, *data.bench);
  for (const RunOfMeasurement& run : data.all->runs)
    for (std::string& name : instruments_not_real(
             run.stored().header, parse_bench(run.stored().header.bench_toml, "its bench file")))
      if (std::ranges::find(data.simulated, name) == data.simulated.end())
        data.simulated.push_back(std::move(name));
}

std::optional<HeldOutNorm> held_out(const RunRecord& record, const CalibrationResult& result) {
  // Where the stage turns, more than gravity is in the norm.
  if (!result.joint || is_at_constant_rate(record)) return std::nullopt;
  JointOptions options;
  options.measured_alignment = record.measured_alignment;
  const HeldOutNorm norm = held_out_norm(record, options);
  if (norm.folds == 0) return std::nullopt;
  return norm;
}

ReportData gather(const GatheredRun& gathered, const AnalysedItem& item) {
  ReportData data;
  data.item = item.stored.item;
  data.path = gathered.path;
  data.record = item.stored.record;
  if (gathered.is_run_file || !gathered.all->runs.empty()) data.run = item.stored;
  data.program_version = program_version();
  data.created_utc = gathered.created_utc;
  // A report goes to the owner of its item, and says nothing about the certificates of other items.
  std::copy_if(gathered.integrity.begin(), gathered.integrity.end(), std::back_inserter(data.integrity),
               [&](const IntegrityCheck& check) { return check.item == 0 || check.item == data.item; });
  data.all = gathered.all;
  data.sha256 = gathered.sha256;
  if (data.run) describe_bench(data);
  data.results = item.results;
  data.estimator = item.result().estimator;
  if (gathered.is_run_file) {
    for (IntegrityCheck& check : recompute(data.path, *data.run, data.bench ? &*data.bench : nullptr,
                                           data.results, gathered.analyses))
      data.integrity.push_back(std::move(check));
  }
  if (const CalibrationResult& result = data.result(); result.verdict != Verdict::kNotUsable &&
                                                       result.covariance_intrinsic &&
                                                       result.covariance_intrinsic->allFinite()) {
    data.budget = make_budget(data.record, result);
    if (!data.is_of_several_runs()) data.held_out_norm = held_out(data.record, result);
    for (const Term& words : unstated_voltmeter(data)) data.budget->not_covered.push_back(words);
  }
  return data;
}

}  // namespace

ReportData gather_report(const std::filesystem::path& path, Clock::UtcTime now, int item) {
  NamedItem named = named_item(path.string());
  if (item != 0) named.item = item;
  return std::move(gather_items(named.file, now, chosen_item(named.file, named.item)).front());
}

std::vector<ReportData> gather_items(const std::filesystem::path& path, Clock::UtcTime now, int item,
                                     const TableOptions& options) {
  if (item != 0) (void)chosen_item(path, item);
  GatheredRun gathered;
  gathered.path = path;
  gathered.created_utc = format_utc(now);
  gathered.is_run_file = RunFile::looks_like_run_file(path);
  if (gathered.is_run_file) {
    CheckedRun run = load_run(path, options).value();
    gathered.integrity = verify_run(run);
    gathered.sha256 = run.sha256;
    if (run.complete()) gathered.analyses = parsed_analyses(path);
    gathered.all = std::make_shared<const AnalysedRun>(analyse_run(std::move(run.items)));
  } else {
    gathered.all = std::make_shared<const AnalysedRun>(analyse_file(path, {}, options));
  }
  if (!gathered.all->runs.empty()) gathered.integrity = verify_measurement(path, *gathered.all);
  if (!gathered.sha256 &&
      (!gathered.is_run_file || gathered.all->items.front().stored.state == RunState::kComplete))
    gathered.sha256 = sha256_of_file(path);
  std::vector<ReportData> items;
  for (const AnalysedItem& each : gathered.all->items)
    if (item == 0 || item == each.stored.item) items.push_back(gather(gathered, each));
  return items;
}

}  // namespace abcal
