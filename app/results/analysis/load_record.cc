#include "app/results/analysis/load_record.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/other_file.h"
#include "app/results/analysis/stage_record_use.h"
#include "app/results/logs/log_table.h"

namespace abcal {
namespace {

/// @return whether it is a run file; else it is read as a table
bool is_run_file(const std::filesystem::path& path, const TableOptions& options) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) throw std::runtime_error(path.string() + ": no such file");
  if (std::filesystem::is_directory(path, error)) {
    throw std::runtime_error(path.string() + ": is a folder; required: a run file or a table of readings");
  }
  if (!std::filesystem::is_regular_file(path, error))
    throw std::runtime_error(path.string() + ": not a file; required: a run file or a table of readings");
  if (RunFile::looks_like_run_file(path)) {
    if (!options.is_empty())
      throw std::invalid_argument(
          fmt::format("--columns, --unit, --time-unit, --topic, --keep-mapping: {} is a run file, which "
                      "states all of it; "
                      "required: a table",
                      path.string()));
    return true;
  }
  if (log_format(path) == LogFormat::kNone) refuse_other_file(path, kRunOrCsv);
  return false;
}

}  // namespace

NamedItem named_item(const std::string& name) {
  std::error_code ignored;
  const std::size_t mark = name.rfind('#');
  if (mark == std::string::npos || std::filesystem::exists(name, ignored)) return {name, 0};
  int item = 0;
  const char* end = name.data() + name.size();
  const auto [rest, error] = std::from_chars(name.data() + mark + 1, end, item);
  if (error != std::errc() || rest != end || item < 1)
    throw std::invalid_argument(fmt::format(
        "{}: no such file; required: a file, or FILE#K for item K (from 1) of a run with several", name));
  return {name.substr(0, mark), item};
}

std::size_t items_of_file(const std::filesystem::path& path) {
  std::error_code error;
  if (looks_like_measurement(path)) return static_cast<std::size_t>(listed_measurement(path).items);
  const bool is_run = std::filesystem::is_regular_file(path, error) && RunFile::looks_like_run_file(path);
  return is_run ? std::max<std::size_t>(1, RunFile::count_items(path)) : 1;
}

int chosen_item(const std::filesystem::path& path, int asked) {
  const auto count = static_cast<int>(items_of_file(path));
  const std::string has = count == 1 ? "one item" : fmt::format("{} items", count);
  if (asked < 0 || asked > count)
    throw std::invalid_argument(
        fmt::format("--item {}: {} has {}; required: 1 to {}", asked, path.string(), has, count));
  if (asked == 0 && count > 1)
    throw std::invalid_argument(
        fmt::format("{} has {}; required: --item 1 to {}, or {}#K for item K in place of the file where "
                    "there is no --item (`abcal analyse` shows all of them)",
                    path.string(), has, count, path.string()));
  return std::max(1, asked);
}

int shown_item(const StoredRun& run, int asked) {
  if (asked != 0) return asked;
  const auto whole =
      std::ranges::find_if(run.items, [](const ItemProgress& item) { return !item.dropped_at; });
  return whole == run.items.end() ? 1 : whole->k;
}

LoadedRecord load_record(const std::filesystem::path& path, int item, const TableOptions& options) {
  NamedItem named = named_item(path.string());
  if (item != 0) named.item = item;
  const bool is_run = is_run_file(named.file, options);
  named.item = chosen_item(named.file, named.item);
  if (!is_run) return {import_readings(named.file, options).record, std::nullopt};
  StoredRun run = std::move(read_as_stored(named.file, named.item).items.front());
  use_stored_stage_record(run);
  RunRecord record = run.record;
  return {std::move(record), std::move(run)};
}

std::optional<CheckedRun> load_run(const std::filesystem::path& path, const TableOptions& options) {
  if (!is_run_file(path, options)) return std::nullopt;
  CheckedRun run = read_as_stored(path);
  for (StoredRun& item : run.items) use_stored_stage_record(item);
  return run;
}

std::vector<StoredRun> load_items(const std::filesystem::path& path, const TableOptions& options) {
  if (std::optional<CheckedRun> run = load_run(path, options)) return std::move(run->items);
  std::vector<StoredRun> items(1);
  items.front().record = import_readings(path, options).record;
  items.front().header.items.resize(1);
  items.front().items.resize(1);
  return items;
}

std::string name_of_item(const std::string& file, const StoredRun& run) {
  const int item = run.named_item();
  return item > 0 ? fmt::format("{}#{}", file, item) : file;
}

std::string about_item(const StoredRun& run, const std::string& words, const char* separator) {
  const int item = run.named_item();
  return item > 0 ? fmt::format("item {}{}{}", item, separator, words) : words;
}

}  // namespace abcal
