#include "app/results/analysis/series_of_runs.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <map>
#include <memory>
#include <set>
#include <stdexcept>
#include <utility>

#include "app/bench_file/item_identity.h"
#include "app/bench_file/stage_record_file.h"
#include "app/results/analysis/agreement.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/stage_record_use.h"
#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/record/run_label.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

/// Facts of an item and its gravity that stay the same in all runs of a measurement, in words.
using Facts = std::map<std::string, std::string>;
Facts constants_of_measurement(const StoredRun& run) {
  const RunItem& item = run.own_item();
  Facts facts{
      {"the unit of the readings", run.record.response_unit},
      {"local gravity", run.record.g_loc_known ? fmt::format("{:.9g} m/s2", run.record.g_loc.value_mps2)
                                               : std::string("not known")},
      {"the driver", item.driver},
      {"the firmware", item.firmware}};
  for (const auto& [name, key] : kItemSettings)
    facts.emplace(std::string(name), label_of(run.header.labels, key));
  for (const auto& [name, value] : item.registers) facts.emplace("the register " + name, value);
  return facts;
}

/// @throws std::invalid_argument all facts of the items in later runs that differ from those in the first
void require_same_items(const RunsOfStage& loaded) {
  const auto value_in = [](const Facts& facts, const std::string& name) {
    const auto found = facts.find(name);
    return found == facts.end() || found->second.empty() ? std::string("not stated") : found->second;
  };
  std::string problems;
  for (std::size_t k = 0; k < loaded.runs.size(); ++k) {
    if (loaded.places[k].run == 0) continue;
    const auto of_first = static_cast<std::size_t>(loaded.places[k].item);
    const Facts first = constants_of_measurement(loaded.runs[of_first]);
    Facts all = constants_of_measurement(loaded.runs[k]);
    const Facts later = all;
    all.insert(first.begin(), first.end());
    for (const auto& [name, ignored] : all)
      if (value_in(later, name) != value_in(first, name))
        problems += fmt::format("\n  {}: {} is {}; in {} it is {}", loaded.files[k], name,
                                value_in(later, name), loaded.files[of_first], value_in(first, name));
  }
  if (!problems.empty())
    throw std::invalid_argument(
        "these runs are not of one item that stayed the same; required: runs that differ in mounting and "
        "time alone:" +
        problems);
}

/// Lets the fit use the record that is given, or else the one that all runs keep.
void use_record(RunsOfStage& loaded, std::shared_ptr<const StageRecord> record) {
  const auto kept = loaded.runs.front().record.stage_record.record;
  const bool is_common = kept && std::ranges::all_of(loaded.runs, [&](const StoredRun& run) {
                           return run.header.stage_record == loaded.runs.front().header.stage_record;
                         });
  if (!record && is_common) record = kept;
  for (std::size_t k = 0; k < loaded.runs.size(); ++k) {
    loaded.runs[k].record.stage_record = {};
    if (record) use_stage_record({&loaded.runs[k], 1}, record, loaded.files[k]);
  }
}

/// Compares the results of one run alone with that of all.
/// @param member  the run in that result
void compare_run(const RunRecord& record, const CalibrationResult& alone, SeriesMember& member,
                 CalibrationResult& result) {
  member.alone.push_back(apart(alone, result));
  for (const Estimator& estimator : estimators()) {
    if (estimator.fit == nullptr) continue;
    try {
      const CalibrationResult of_run = estimator.fit(record);
      if (of_run.verdict == Verdict::kNotUsable) continue;
      member.alone.push_back(apart(of_run, result));
    } catch (const UnusableData&) {
      continue;  // It has no result of such a run.
    }
    if (estimator.certifiable) object_to_disagreement(member.alone.back(), member.source, result);
  }
}

/// A run file with all its items.
struct LoadedRun {
  std::string file, sha256;
  std::vector<StoredRun> items;
  const StoredRun& first() const { return items.front(); }
};

/// Loads the runs of one stage in the order of their beginning.
std::vector<LoadedRun> load_runs(const std::vector<std::string>& given) {
  std::vector<LoadedRun> runs;
  std::set<std::string> seen;
  std::vector<std::string> files;
  for (const std::string& file : given) std::ranges::move(runs_of_file(file), std::back_inserter(files));
  for (const std::string& file : files) {
    LoadedRun& run = runs.emplace_back(LoadedRun{file, sha256_of_file(file), load_items(file)});
    if (run.first().header.bench_toml.empty())
      throw std::invalid_argument(fmt::format(
          "{}: is not a run file, so that neither its stage nor its item is known; required: run files",
          file));
    if (!seen.insert(run.sha256).second)
      throw std::invalid_argument(fmt::format("{}: is given twice; required: each run once", file));
  }
  // Simulated runs may begin at one time; the order in which they are given must not matter.
  std::ranges::stable_sort(runs, {}, [](const LoadedRun& run) {
    return std::pair(run.first().header.created_utc, std::filesystem::path(run.file).filename());
  });
  for (const LoadedRun& run : runs)
    if (const auto differ = differences(stage_identity(runs.front().first()), stage_identity(run.first()));
        !differ.empty())
      throw std::invalid_argument(fmt::format("{}: was measured on another stage than {}: {}", run.file,
                                              runs.front().file, fmt::join(differ, "; ")));
  return runs;
}

/// @throws std::invalid_argument several items of a run have the same words
void require_told_apart(const LoadedRun& run, const std::string& item) {
  const auto count = std::ranges::count(run.items, item, item_of);
  if (count > 1)
    throw std::invalid_argument(
        fmt::format("{}: {} of its items are {}, and cannot be told apart; required: their serial numbers",
                    run.file, count, item));
}

/// Item k (from 0) of the first run, in another run.
/// @throws std::invalid_argument that run does not have it, or cannot tell it from another
const StoredRun& same_item(const LoadedRun& first, std::size_t k, const LoadedRun& run) {
  const std::string wanted = item_of(first.items[k]);
  const auto is_it = [&](const StoredRun& item) { return item_of(item) == wanted; };
  const auto found = std::ranges::find_if(run.items, is_it);
  require_told_apart(first, wanted);
  if (found == run.items.end() || run.items.size() != first.items.size()) {
    std::vector<std::string> items;
    for (const StoredRun& item : run.items) items.push_back(item_of(item));
    throw std::invalid_argument(fmt::format(
        "{}: its item is {}, that of {} is {}; required: runs of one item, or of the same several", run.file,
        fmt::join(items, " and "), first.file, wanted));
  }
  return *found;
}

void add(const LoadedRun& loaded, const StoredRun& item, ItemInRun place, RunsOfStage& out) {
  out.files.push_back(loaded.file);
  out.sha256.push_back(loaded.sha256);
  out.runs.push_back(item);
  out.places.push_back(place);
}

/// The items of a measurement, evaluated together as far as they agree.
class ItemsTogether {
 public:
  ItemsTogether(const RunsOfStage& loaded, std::size_t count)
      : loaded_(loaded), records_(loaded.records()), each_(fit_each_run(records_, loaded.places, {})) {
    for (std::size_t k = 0; k < records_.size(); ++k) checks_.push_back(check_record(records_[k]));
    out_.items.resize(count);
    std::vector<int> sound, all;
    for (int i = 0; i < static_cast<int>(count); ++i) {
      all.push_back(i);
      if (is_sound(i)) sound.push_back(i);
    }
    if (count == 1) sound = all;
    if (const auto why = why_each_by_itself(records_); why && count > 1) {
      sound.clear();
      for (TrayItemResult& item : out_.items) item.why_not = *why;
    }
    if (sound.size() > 1 || count == 1) fit(sound, count > 1);
    for (const int i : all) {
      TrayItemResult& item = out_.items[static_cast<std::size_t>(i)];
      if (item.in_common_fit) continue;
      if (item.why_not.empty()) item.why_not = doubtful_on_its_own();
      item.result = std::move(analyse_series(records_, each_, std::array{i}).items.front());
    }
    for (const int i : all) compare(i);
    judge_tray(out_);
  }
  TrayResult result() && { return std::move(out_); }

 private:
  bool is_sound(int item) const {
    for (std::size_t k = 0; k < records_.size(); ++k)
      if (loaded_.places[k].item == item &&
          (each_.alone[k].verdict != Verdict::kUsable || !std::ranges::all_of(checks_[k], &Check::passed)))
        return false;
    return true;
  }

  void fit(const std::vector<int>& items, bool may_disagree) {
    SeriesResult found = analyse_series(records_, each_, items);
    for (std::size_t n = 0; n < items.size(); ++n) {
      TrayItemResult& item = out_.items[static_cast<std::size_t>(items[n])];
      if (may_disagree && !found.runs_agree) {
        item.why_not =
            Message("the items contradict each other about the stage, and are evaluated each by itself");
        continue;
      }
      item.in_common_fit = true;
      item.result = std::move(found.items[n]);
    }
    if (found.runs_agree || !may_disagree) out_.common_covariance = std::move(found.covariance);
  }

  /// Objects to the result of an item where a run of it alone is not in order, or contradicts it.
  void compare(int i) {
    CalibrationResult& result = out_.items[static_cast<std::size_t>(i)].result;
    std::vector<std::size_t> runs;
    for (std::size_t k = 0; k < records_.size(); ++k)
      if (loaded_.places[k].item == i) runs.push_back(k);
    for (const std::size_t k : runs)
      for (const Check& check : checks_[k])
        if (!check.passed) object_to(result, Message("{run}: {why}", loaded_.files[k], check.words));
    for (std::size_t n = 0; n < runs.size(); ++n)
      compare_run(records_[runs[n]], each_.alone[runs[n]], result.series[n], result);
  }

  const RunsOfStage& loaded_;
  std::vector<RunRecord> records_;
  SeriesRuns each_;
  std::vector<std::vector<Check>> checks_;
  TrayResult out_;
};

}  // namespace

std::vector<RunRecord> RunsOfStage::records() const {
  std::vector<RunRecord> out;
  for (const StoredRun& run : runs) out.push_back(run.record);
  return out;
}

std::string item_of(const StoredRun& run) {
  const RunItem& item = run.own_item();
  return fmt::format("{} {}, serial number {}", item.maker, item.model, item.serial_number);
}

RunsOfStage load_runs_of_stage(const std::vector<std::string>& files) {
  RunsOfStage out;
  std::vector<std::string> items;
  int run = 0;
  for (const LoadedRun& loaded : load_runs(files)) {
    for (const StoredRun& stored : loaded.items) {
      const std::string item = item_of(stored);
      require_told_apart(loaded, item);
      auto found = std::ranges::find(items, item);
      if (found == items.end()) found = items.insert(items.end(), item);
      add(loaded, stored, {static_cast<int>(found - items.begin()), run}, out);
    }
    ++run;
  }
  return out;
}

AnalysedRun analyse_series_of_runs(const std::vector<std::string>& files,
                                   const std::optional<StageRecord>& record) {
  const std::vector<LoadedRun> loaded = load_runs(files);
  const std::size_t count = loaded.front().items.size();
  AnalysedRun run;
  RunsOfStage all;
  for (const LoadedRun& one : loaded) {
    RunOfMeasurement& part = run.runs.emplace_back(RunOfMeasurement{one.file, one.sha256, {}});
    for (std::size_t k = 0; k < count; ++k) {
      part.items.push_back(same_item(loaded.front(), k, one));
      add(one, part.items.back(), {static_cast<int>(k), static_cast<int>(run.runs.size()) - 1}, all);
    }
  }
  require_same_items(all);
  use_record(all, record ? std::make_shared<const StageRecord>(*record) : nullptr);
  run.joint = ItemsTogether(all, count).result();
  for (std::size_t k = 0; k < count; ++k) run.items.push_back({all.runs[k], {run.joint.items[k].result}});
  return run;
}

}  // namespace abcal
