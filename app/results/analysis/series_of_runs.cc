#include "app/results/analysis/series_of_runs.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <memory>
#include <numeric>
#include <set>
#include <stdexcept>
#include <utility>

#include "app/bench_file/stage_record_file.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/stage_record_use.h"
#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/series/series_result.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

StoredRun load_one(const std::string& file) {
  std::vector<StoredRun> items = load_items(file);
  if (items.size() > 1)
    throw std::invalid_argument(fmt::format(
        "{}: has {} items; required: runs of one item, as the items of a tray stand still against each other",
        file, items.size()));
  StoredRun run = std::move(items.front());
  if (run.header.bench_toml.empty())
    throw std::invalid_argument(fmt::format(
        "{}: is not a run file, so that neither its stage nor its item is known; required: run files", file));
  return run;
}

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

RunsOfStage load_runs_of_stage(const std::vector<std::string>& files, bool one_item) {
  std::vector<StoredRun> runs;
  std::vector<std::string> sha256;
  for (const std::string& file : files) {
    runs.push_back(load_one(file));
    sha256.push_back(sha256_of_file(file));
  }
  std::vector<std::size_t> order(files.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {}, [&](std::size_t k) { return runs[k].header.created_utc; });
  RunsOfStage out;
  std::set<std::string> seen;
  std::vector<std::string> items;
  for (const std::size_t k : order) {
    StoredRun& run = runs[k];
    if (!seen.insert(sha256[k]).second)
      throw std::invalid_argument(fmt::format("{}: is given twice; required: each run once", files[k]));
    if (!out.runs.empty())
      if (const auto differ = differences(stage_identity(out.runs.front()), stage_identity(run));
          !differ.empty())
        throw std::invalid_argument(fmt::format("{}: was measured on another stage than {}: {}", files[k],
                                                out.files.front(), fmt::join(differ, "; ")));
    const std::string item = item_of(run);
    auto found = std::ranges::find(items, item);
    if (found == items.end()) {
      if (one_item && !items.empty())
        throw std::invalid_argument(
            fmt::format("{}: its item is {}, that of {} is {}; required: runs of one item", files[k], item,
                        out.files.front(), items.front()));
      items.push_back(item);
      found = std::prev(items.end());
    }
    out.items.push_back(static_cast<int>(found - items.begin()));
    out.files.push_back(files[k]);
    out.sha256.push_back(sha256[k]);
    out.runs.push_back(std::move(run));
  }
  return out;
}

AnalysedItem analyse_series_of_runs(const std::vector<std::string>& files,
                                    const std::optional<StageRecord>& record) {
  RunsOfStage loaded = load_runs_of_stage(files, true);
  const auto shared = record ? std::make_shared<const StageRecord>(*record) : nullptr;
  for (std::size_t k = 0; k < loaded.runs.size() && shared; ++k)
    use_stage_record({&loaded.runs[k], 1}, shared, loaded.files[k]);
  const std::vector<RunRecord> records = loaded.records();
  CalibrationResult result = analyse_series(records, {});
  for (std::size_t k = 0; k < records.size(); ++k)
    for (const Check& check : check_record(records[k]))
      if (!check.passed) object_to(result, Message("{run}: {why}", loaded.files[k], check.words));
  return {std::move(loaded.runs.front()), {std::move(result)}};
}

}  // namespace abcal
