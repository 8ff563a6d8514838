#include "app/console/run_index.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/stat.h>

#include <algorithm>
#include <set>
#include <sstream>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/not_real.h"
#include "app/document/json_text.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/result_json.h"
#include "app/system/version.h"
#include "drivers/text/text.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_label.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/run_seal.h"

namespace abcal::console {
namespace {

using Json = nlohmann::ordered_json;

/// The format of the tables and of the summaries in them: a database of another one is made again.
constexpr int kFormat = 1;

constexpr const char* kNotReadYet = "not read yet";

/// Columns that pages count and sort are apart from the long texts. A run that is not read yet has no verdict
/// and no beginning; `results` identifies the results file in which the verdict was looked for.
constexpr const char* kTables =
    "create table run (name text primary key, contents text not null, time integer not null,"
    " is_read integer not null, is_closed integer not null default 0, estimator text not null default '',"
    " results text not null default '', state text not null, bench text not null default '',"
    " verdict text not null default '', created_utc text not null default '') without rowid;"
    "create index newest on run (time, name);"
    "create index counted on run (verdict, created_utc, state, bench);"
    "create index unread on run (time, name) where is_read = 0;"
    "create index open on run (name) where is_read = 0 or is_closed = 0 or verdict = '';"
    "create table words (name text primary key, summary text not null) without rowid;"
    "create table chart (name text, item integer, program text not null, charted text not null,"
    " primary key (name, item)) without rowid;";

/// Identifies the contents of a file without reading it: inode, size and the times of the last change of its
/// bytes and of anything about it. Empty: there is no such file.
std::string contents_of(const std::filesystem::path& path, std::int64_t* changed_ns = nullptr) {
  struct stat found {};
  if (::lstat(path.c_str(), &found) != 0) return "";
  const auto ns = [](const timespec& time) {
    return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
  };
  if (changed_ns != nullptr) *changed_ns = ns(found.st_mtim);
  return fmt::format("{} {} {} {}", found.st_ino, found.st_size, ns(found.st_mtim), ns(found.st_ctim));
}

SqliteDatabase made_ready(const std::filesystem::path& path) {
  SqliteDatabase database(path, SqliteDatabase::Mode::kCreate);
  database.use_write_ahead_log();
  if (database.value("pragma user_version") == std::to_string(kFormat)) {
    // A run that could not be read is read again.
    database.execute("update run set is_read = 0 where is_closed = 0");
    return database;
  }
  for (const char* table : {"run", "words", "chart"})
    database.execute(fmt::format("drop table if exists {}", table));
  database.execute(fmt::format("begin; {} pragma user_version = {}; commit", kTables, kFormat));
  return database;
}

SqliteDatabase open_in(const std::filesystem::path& folder) {
  const std::filesystem::path path = folder / RunIndex::kFile;
  try {
    return made_ready(path);
  } catch (const RunFileError&) {
    // Not a database, or not whole; or the folder cannot be written.
  }
  std::error_code ignored;
  for (const char* end : {"", "-wal", "-shm"}) std::filesystem::remove(path.string() + end, ignored);
  try {
    return made_ready(path);
  } catch (const RunFileError&) {
    return made_ready(":memory:");
  }
}

bool has_item(const Json& item, const std::string& serial_number) {
  return item.at("serial_number") == serial_number && item.at("dropped").is_null();
}

/// The serial number of each item as the person stated it, else as the accelerometer reported it.
std::string serial_numbers_of(const RunHeader& header) {
  std::vector<std::string> of_items;
  for (const RunItem& item : header.items) of_items.push_back(item.serial_number);
  return fmt::format("{}", fmt::join(of_items, ", "));
}

/// Which instruments of a run were simulated, by its bench file: "stage, accelerometer"; empty: none.
std::string simulated_of(const RunHeader& header) {
  try {
    return fmt::format("{}", fmt::join(simulated_instruments(parse_bench(header.bench_toml, "run")), ", "));
  } catch (const std::exception&) {
    return "";  // An imported run has no bench file.
  }
}

/// The items of a run, and how far each was measured.
Json items_of(const StoredRun& run) {
  Json items = Json::array();
  for (std::size_t i = 0; i < run.items.size(); ++i) {
    const ItemProgress& item = run.items[i];
    items.push_back({{"k", item.k},
                     {"serial_number", run.header.items[i].serial_number},
                     {"model", run.header.items[i].model},
                     {"measured", item.measured},
                     {"dropped", item.dropped_at ? Json(item.reason) : Json(nullptr)}});
  }
  return items;
}

RunIndex::ReadRun read_run(const std::filesystem::path& path) {
  const std::string name = path.filename().string();
  try {
    const StoredRun run = RunFile::load(path);
    return {run_summary(name, run), run.state == RunState::kComplete || run.state == RunState::kAbandoned,
            declared_estimator(run.record).name};
  } catch (const std::exception& error) {
    return {{{"name", name}, {"state", "unreadable"}, {"why", error.what()}}, false, ""};
  }
}

/// The conditions of a question, and the values of their parameters in their order.
struct Conditions {
  std::string sql = " where true";
  std::vector<std::string> values;
  bool need_words = false;

  void add(const std::string& condition, const std::string& value) {
    sql += " and " + condition;
    values.push_back(value);
  }
  std::string tables() const { return need_words ? " from run join words using (name)" : " from run"; }
  int bind(SqliteStatement& statement) const {
    int position = 0;
    for (const std::string& value : values) statement.bind(++position, std::string_view(value));
    return position;
  }
};

Conditions conditions_of(const RunIndex::Asked& asked) {
  Conditions all;
  if (!asked.state.empty()) all.add("state = ?", asked.state);
  if (!asked.bench.empty()) all.add("bench = ?", asked.bench);
  std::istringstream words(pieces::lower(asked.search));
  for (std::string word; words >> word; all.need_words = true) all.add("instr(lower(summary), ?) > 0", word);
  if (!asked.item.empty()) {
    all.add(
        "exists (select 1 from json_each(summary, '$.items') where json_extract(value, '$.serial_number') = "
        "?)",
        asked.item);
    all.need_words = true;
  }
  return all;
}

}  // namespace

std::string kept_verdict(const std::filesystem::path& path, const std::string& estimator) {
  try {
    const std::optional<StoredAnalysis> last = last_analysis(path, estimator);
    return last ? Json::parse(last->result_json).at("verdict").get<std::string>() : "";
  } catch (const std::exception&) {
    return "";  // The run's own page shows the reason.
  }
}

bool is_own_file(const std::filesystem::path& path, std::string_view extension) {
  std::error_code ignored;
  return path.extension() == extension &&
         std::filesystem::is_regular_file(std::filesystem::symlink_status(path, ignored));
}

Json run_summary(const std::string& name, const StoredRun& run) {
  const RunHeader& header = run.header;
  return {{"name", name},
          {"state", to_string(run.state)},
          {"created_utc", header.created_utc},
          {"item", serial_numbers_of(header)},
          {"items", items_of(run)},
          {"maker", label_of(header.labels, "item.maker")},
          {"model", label_of(header.labels, "item.model")},
          {"bench", label_of(header.labels, "bench.name")},
          {"operator", describe(operators_of(run))},
          {"unit", header.response_unit},
          {"measured", run.measured.size()},
          {"planned", header.plan.size()},
          {"duration_s", json_number(run.timing.total_s())},
          {"simulated", simulated_of(header)},
          {"verdict", ""}};
}

RunIndex::RunIndex(std::filesystem::path folder) : folder_(std::move(folder)), database_(open_in(folder_)) {}

template <class Ask>
auto RunIndex::on_disk_or_in_memory(const Ask& ask) {
  try {
    return ask();
  } catch (const RunFileError&) {
    database_ = made_ready(":memory:");
    folder_has_changed_ = true;
  }
  find_runs();
  return ask();
}

std::vector<std::string> RunIndex::names(std::string_view query) {
  std::vector<std::string> found;
  for (SqliteStatement row = database_.prepare(query); row.step();) found.push_back(row.text(0));
  return found;
}

bool RunIndex::has_contents(const std::string& name, const std::string& contents) {
  SqliteStatement row = database_.prepare("select 1 from run where name = ?1 and contents = ?2");
  return row.bind(1, std::string_view(name)).bind(2, std::string_view(contents)).step();
}

bool RunIndex::find_run(const std::string& name) {
  std::int64_t time = 0;
  // A run in progress stores its angles in its log at first.
  const std::string contents = contents_of(folder_ / name, &time) + contents_of(folder_ / (name + "-wal"));
  if (has_contents(name, contents)) return false;
  database_
      .prepare(
          "insert into run (name, contents, time, is_read, state) values (?1, ?2, ?3, 0, ?4) on conflict "
          "(name) do update set contents = ?2, time = ?3, is_read = 0, is_closed = 0, verdict = '', "
          "results = '', created_utc = '', state = ?4")
      .bind(1, std::string_view(name))
      .bind(2, std::string_view(contents))
      .bind(3, time)
      .bind(4, std::string_view(kNotReadYet))
      .run();
  const std::string summary = json_text(Json{{"name", name}, {"state", kNotReadYet}});
  database_.prepare("insert or replace into words values (?1, ?2)")
      .bind(1, std::string_view(name))
      .bind(2, std::string_view(summary))
      .run();
  database_.prepare("delete from chart where name = ?").bind(1, std::string_view(name)).run();
  return true;
}

/// Finds the verdict of a closed run, unless its results have not changed since.
void RunIndex::find_results(const std::string& name) {
  SqliteStatement row =
      database_.prepare("select estimator, results from run where name = ? and is_closed = 1");
  if (!row.bind(1, std::string_view(name)).step()) return;
  const std::string results = contents_of(ResultsFile::path_beside(folder_ / name));
  if (results == row.text(1)) return;
  const std::string verdict = results.empty() ? "" : kept_verdict(folder_ / name, row.text(0));
  row.reset();
  database_.prepare("update run set results = ?2, verdict = ?3 where name = ?1")
      .bind(1, std::string_view(name))
      .bind(2, std::string_view(results))
      .bind(3, std::string_view(verdict))
      .run();
  database_.prepare("update words set summary = json_set(summary, '$.verdict', ?2) where name = ?1")
      .bind(1, std::string_view(name))
      .bind(2, std::string_view(verdict))
      .run();
}

void RunIndex::store(const std::string& name, const std::string& contents, const ReadRun& read) {
  if (!has_contents(name, contents)) return;  // It has changed or was removed meanwhile.
  const std::string text = json_text(read.summary);
  database_
      .prepare(
          "update run set is_read = 1, is_closed = ?2, estimator = ?3, state = ?4, bench = ?5,"
          " created_utc = ?6 where name = ?1")
      .bind(1, std::string_view(name))
      .bind(2, std::int64_t{read.is_closed})
      .bind(3, std::string_view(read.estimator))
      .bind(4, std::string_view(read.summary.at("state").get_ref<const std::string&>()))
      .bind(5, std::string_view(read.summary.value("bench", "")))
      .bind(6, std::string_view(read.summary.value("created_utc", "")))
      .run();
  database_.prepare("insert or replace into words values (?1, ?2)")
      .bind(1, std::string_view(name))
      .bind(2, std::string_view(text))
      .run();
  find_results(name);
}

void RunIndex::find_runs() {
  // A folder changes with the names in it; its time is exact to some milliseconds, so that names that follow
  // a look at once are found by the next one.
  const std::string folder = contents_of(folder_);
  const bool has_changed = std::exchange(folder_contents_, folder) != folder;
  Transaction changes(database_);
  if (std::exchange(folder_has_changed_, has_changed) || has_changed) {
    const std::vector<std::string> known = names("select name from run");
    std::set<std::string> gone(known.begin(), known.end());
    std::error_code error;
    for (std::filesystem::directory_iterator at(folder_, error), end; !error && at != end;
         at.increment(error)) {
      if (!is_own_file(at->path(), ".run")) continue;
      const std::string name = at->path().filename().string();
      find_run(name);
      gone.erase(name);
    }
    for (const std::string& name : gone) {
      for (const char* table : {"run", "words", "chart"})
        database_.prepare(fmt::format("delete from {} where name = ?", table))
            .bind(1, std::string_view(name))
            .run();
    }
  }
  for (const std::string& name :
       names("select name from run where is_read = 0 or is_closed = 0 or verdict = ''")) {
    find_run(name);
    find_results(name);
  }
  changes.commit();
}

void RunIndex::read_new(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  const auto next = [this] {
    SqliteStatement row = database_.prepare(
        "select name, contents from run where is_read = 0 order by time desc, name desc limit 1");
    return row.step() ? std::optional(std::pair(row.text(0), row.text(1))) : std::nullopt;
  };
  while (const auto found = stop.stop_requested() ? std::nullopt : on_disk_or_in_memory(next)) {
    const auto& [name, contents] = *found;
    lock.unlock();
    const ReadRun read = read_run(folder_ / name);
    lock.lock();
    on_disk_or_in_memory([&] {
      Transaction changes(database_);
      store(name, contents, read);
      changes.commit();
    });
    was_read_.notify_all();
  }
  is_reading_ = false;
  was_read_.notify_all();
}

void RunIndex::look(std::unique_lock<std::mutex>& lock, std::chrono::milliseconds patience,
                    const std::stop_token& stop) {
  find_runs();
  if (!is_reading_ && !names("select name from run where is_read = 0 limit 1").empty()) {
    is_reading_ = true;
    reader_ = std::jthread([this](const std::stop_token& ending) { read_new(ending); });
  }
  was_read_.wait_for(lock, stop, patience, [this] { return !is_reading_; });
}

std::vector<std::string> RunIndex::names_shown(const Asked& asked) {
  Conditions shown = conditions_of(asked);
  std::string order = " order by time desc, name desc";
  const bool is_key =
      std::ranges::all_of(asked.sort, [](char c) { return c == '_' || (c >= 'a' && c <= 'z'); });
  if (!asked.sort.empty() && is_key) {
    shown.need_words = true;
    order = fmt::format(" order by json_extract(summary, '$.{}'){}, time desc, name desc", asked.sort,
                        asked.descending ? " desc" : "");
  }
  SqliteStatement rows =
      database_.prepare("select name" + shown.tables() + shown.sql + order + " limit ? offset ?");
  const int last = shown.bind(rows);
  rows.bind(last + 1, static_cast<std::int64_t>(asked.count))
      .bind(last + 2, static_cast<std::int64_t>(asked.from));
  std::vector<std::string> names;
  while (rows.step()) names.push_back(rows.text(0));
  return names;
}

RunIndex::Page RunIndex::page(const Asked& asked, std::chrono::milliseconds patience) {
  std::unique_lock lock(mutex_);
  return on_disk_or_in_memory([&] { return page_of(asked, lock, patience); });
}

RunIndex::Page RunIndex::page_of(const Asked& asked, std::unique_lock<std::mutex>& lock,
                                 std::chrono::milliseconds patience) {
  look(lock, patience);
  bool has_changed = false;
  for (const std::string& name : names_shown(asked)) {
    has_changed = find_run(name) || has_changed;
    find_results(name);
  }
  if (has_changed) look(lock, patience);
  Page page;
  SqliteStatement counts =
      database_.prepare("select (select count(*) from run), (select count(*) from run where is_read = 0)");
  counts.step();
  page.all = counts.integer(0);
  page.unread = counts.integer(1);
  const Conditions conditions = conditions_of(asked);
  SqliteStatement found =
      database_.prepare("select verdict, count(*), min(nullif(created_utc, '')), max(created_utc)" +
                        conditions.tables() + conditions.sql + " group by verdict");
  conditions.bind(found);
  while (found.step()) {
    page.found += found.integer(1);
    if (!found.text(0).empty()) page.verdicts[found.text(0)] = static_cast<int>(found.integer(1));
    const std::string first = found.text(2);
    if (!first.empty() && (page.first_utc.empty() || first < page.first_utc)) page.first_utc = first;
    page.last_utc = std::max(page.last_utc, found.text(3));
  }
  for (const std::string& name : names_shown(asked)) {
    Json run = known_summary(name);
    if (!run.is_null()) page.runs.push_back(std::move(run));
  }
  return page;
}

Json RunIndex::known_summary(const std::string& name) {
  SqliteStatement row = database_.prepare("select summary from words where name = ?");
  if (!row.bind(1, std::string_view(name)).step()) return nullptr;
  Json run = Json::parse(row.text(0));
  // Not if the program ended before the analysis; resuming the run analyses it.
  if (run.contains("verdict"))
    run["analysed"] = !contents_of(ResultsFile::path_beside(folder_ / name)).empty();
  return run;
}

Json RunIndex::summary(const std::string& name) {
  const std::filesystem::path path = folder_ / name;
  if (!is_own_file(path, ".run")) return nullptr;
  const std::lock_guard lock(mutex_);
  return on_disk_or_in_memory([&] {
    find_run(name);
    SqliteStatement unread = database_.prepare("select contents from run where name = ? and is_read = 0");
    if (unread.bind(1, std::string_view(name)).step()) {
      const std::string contents = unread.text(0);
      unread.reset();
      store(name, contents, read_run(path));
    }
    return known_summary(name);
  });
}

std::vector<RunIndex::RunOfItem> RunIndex::runs_of_item(const std::string& serial_number,
                                                        const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  return on_disk_or_in_memory([&] {
    look(lock, std::chrono::hours(1), stop);
    return complete_runs_of_item(serial_number);
  });
}

std::vector<RunIndex::RunOfItem> RunIndex::complete_runs_of_item(const std::string& serial_number) {
  Asked asked;
  asked.item = serial_number;
  asked.state = to_string(RunState::kComplete);
  const Conditions conditions = conditions_of(asked);
  SqliteStatement rows = database_.prepare("select name, contents, estimator, summary" + conditions.tables() +
                                           conditions.sql + " order by time, name");
  conditions.bind(rows);
  std::vector<RunOfItem> runs;
  while (rows.step()) {
    const Json summary = Json::parse(rows.text(3));
    RunOfItem run{
        rows.text(0), rows.text(1), rows.text(2), summary.at("created_utc"), summary.at("simulated"), {}, {}};
    for (const Json& item : summary.at("items"))
      if (has_item(item, serial_number)) run.items.push_back(item.at("k").get<int>());
    SqliteStatement chart =
        database_.prepare("select item, charted from chart where name = ? and program = ?");
    for (chart.bind(1, std::string_view(run.name)).bind(2, std::string_view(program_version()));
         chart.step();)
      run.charted[static_cast<int>(chart.integer(0))] = Json::parse(chart.text(1));
    if (!run.items.empty()) runs.push_back(std::move(run));
  }
  return runs;
}

void RunIndex::keep_charted(const RunOfItem& run, int item, const Json& charted) {
  const std::lock_guard lock(mutex_);
  on_disk_or_in_memory([&] {
    if (!has_contents(run.name, run.contents)) return;
    database_.prepare("insert or replace into chart values (?1, ?2, ?3, ?4)")
        .bind(1, std::string_view(run.name))
        .bind(2, std::int64_t{item})
        .bind(3, std::string_view(program_version()))
        .bind(4, std::string_view(json_text(charted)))
        .run();
  });
}

}  // namespace abcal::console
