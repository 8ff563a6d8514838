#include "protocol/record/verify_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <future>
#include <limits>
#include <map>
#include <utility>

#include "drivers/text/letters.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/dwell_rows.h"
#include "protocol/record/reading_statistics.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_schema.h"
#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"

namespace abcal {
namespace {

/// Follows the chain of a table whose last column is the link.
/// @param later  a column that entries of earlier versions do not have: linked where it is not null
IntegrityCheck check_chain(SqliteDatabase& database, const std::string& what, const std::string& table,
                           const std::vector<std::string>& columns, const std::string& later = "") {
  std::string sql = "select ";
  for (const std::string& column : columns) sql += column + ", ";
  if (!database.has_column(table, "chain"))
    return {what, false, "written by a version of abcal that did not link its entries"};
  const bool has_later = !later.empty() && database.has_column(table, later);
  if (has_later) sql += later + ", ";
  SqliteStatement rows = database.prepare(sql + "chain from " + table + " order by id");
  std::string link;
  std::size_t count = 0;
  while (rows.step()) {
    ++count;
    std::vector<std::string> fields;
    for (std::size_t k = 0; k < columns.size(); ++k) fields.push_back(rows.text(static_cast<int>(k)));
    if (has_later && !rows.is_null(static_cast<int>(columns.size()))) fields.push_back(rows.text(later));
    link = next_link(link, fields);
    if (link != rows.text("chain"))
      return {what, false,
              fmt::format("entry {} of the {} table, or an earlier one, was changed", count, table)};
  }
  return {what, true, fmt::format("{} entries, each linked to the previous one", count)};
}

/// Follows the chain of the dwells and compares its end, and that of the event log, with the sealed values.
IntegrityCheck check_dwell_chain(SqliteDatabase& database, bool complete) {
  const std::string what = "dwells";
  SqliteStatement rows = database.prepare("select id, chain, experiment, n from dwell order by id");
  std::string link = head_link(database);
  std::int64_t count = 0;
  while (rows.step()) {
    ++count;
    link = dwell_link(database, rows.integer("id"), link);
    if (link != rows.text("chain"))
      return {what, false,
              fmt::format("dwell {} (experiment {}, n = {}) or its readings, an earlier dwell, or the data "
                          "before the first angle were changed",
                          count, rows.integer("experiment"), rows.integer("n"))};
  }
  if (!complete) return {what, true, fmt::format("{}, each linked to the previous one", count)};
  SqliteStatement seal = database.prepare("select * from seal order by id desc limit 1");
  if (!seal.step()) return {what, false, "the seal of the complete run is missing"};
  const std::string last_event =
      database.value("select chain from event order by id desc limit 1").value_or("");
  if (seal.integer("dwells") != count || (count > 0 && seal.text("dwell_chain") != link) ||
      seal.text("event_chain") != last_event)
    return {what, false, "the chains do not end as the seal of the complete run states"};
  return {what, true, fmt::format("{}, each with its readings linked to the previous one, sealed", count)};
}

/// Readings of a dwell that does not exist would be in no link.
IntegrityCheck check_references(SqliteDatabase& database) {
  const std::string what = "references";
  const auto lost =
      database.value("select \"table\" || ' of no ' || parent from pragma_foreign_key_check limit 1");
  if (lost) return {what, false, "there is a " + *lost};
  return {what, true, "each row belongs to one that exists"};
}

/// A sweep is stored as a whole: a run that is continued begins with the next one.
IntegrityCheck check_sweeps(SqliteDatabase& database, const std::vector<PlannedAngle>& plan) {
  const std::string what = "sweeps";
  std::size_t sweeps = 0;
  for (const StoredTogether& stored : stored_together(database)) {
    if (!stored.is_swept || stored.is_check) continue;
    ++sweeps;
    const auto first = static_cast<std::size_t>(stored.position);
    const std::size_t planned = first < plan.size() ? end_of_sweep(plan, first) - first : 0;
    if (stored.angles != planned)
      return {what, false,
              fmt::format("the sweep from experiment {}, n = {} has {} angles; required: all {}",
                          stored.experiment, stored.n, stored.angles, planned)};
  }
  return {what, true, fmt::format("{}, each with all of its angles", sweeps)};
}

/// Every item has every angle that was measured, but those after it was dropped, which an event states.
IntegrityCheck check_items(SqliteDatabase& database, const StoredRun& stored) {
  const std::string what = "items";
  const auto events =
      static_cast<std::size_t>(std::ranges::count(stored.events, kItemDroppedEvent, &RunEvent::kind));
  std::size_t dropped = 0;
  SqliteStatement missing = database.prepare(
      "select count(distinct position) as n from dwell where position < :before and position not in (select "
      "position from dwell where item = :item)");
  SqliteStatement beyond =
      database.prepare("select count(*) as n from dwell where item = :item and position >= :before");
  for (const ItemProgress& item : stored.items) {
    const auto before = static_cast<std::int64_t>(item.dropped_at.value_or(stored.header.plan.size()));
    dropped += item.dropped_at ? 1 : 0;
    for (SqliteStatement* statement : {&missing, &beyond}) {
      statement->reset();
      statement->set("item", std::int64_t{item.k}).set("before", before);
      statement->step();
    }
    if (missing.integer("n") > 0)
      return {
          what, false,
          fmt::format("item {} has no readings at {} of the angles that were measured before it was dropped",
                      item.k, missing.integer("n"))};
    if (beyond.integer("n") > 0)
      return {what, false, fmt::format("item {} has readings after it was dropped", item.k)};
  }
  if (events != dropped)
    return {what, false,
            fmt::format("{} items are stated to be dropped, the events state {}", dropped, events)};
  return {what, true,
          fmt::format("{}, of which {} dropped; each has every angle up to its end", stored.items.size(),
                      dropped)};
}

/// The stored values of a dwell, to be compared with its readings.
struct StatedDwell {
  Eigen::Vector3d mean, spread, u_mean;
  bool has_u = false;
  std::int64_t count = 0;
  std::int64_t lost = 0;
  std::uint32_t flags = 0;
};

StatedDwell stated_dwell(const SqliteStatement& row) {
  const auto vector = [&](const std::string& prefix) {
    Eigen::Vector3d value;
    for (int j = 0; j < 3; ++j)
      value[j] =
          row.optional_real(prefix + kOutputNames[j]).value_or(std::numeric_limits<double>::quiet_NaN());
    return value;
  };
  return {vector("r_"),
          vector("spread_"),
          vector("u_"),
          row.optional_real("u_u").has_value(),
          row.integer("count"),
          row.integer("lost"),
          static_cast<std::uint32_t>(row.integer("flags"))};
}

bool agrees(double stated, double computed, double tolerance) {
  return std::abs(stated - computed) <= tolerance;
}

/// Values of a dwell that contradict its readings; empty: none.
std::string contradiction(const StatedDwell& stated, const std::vector<StoredReading>& readings,
                          const std::optional<RunItem>& item) {
  // Differences of rounding only: the same sums may be taken in another order by another compiler.
  constexpr double kRounding = 1e-12, kSpreadRounding = 1e-9, kUncertaintyRounding = 1e-6;
  std::vector<Eigen::Vector3d> outputs;
  std::int64_t gaps = 0;
  bool beyond_full_scale = false;
  for (std::size_t k = 0; k < readings.size(); ++k) {
    const Eigen::Vector3d& output = readings[k].output;
    if (output.allFinite()) outputs.push_back(output);
    if (item && item->full_scale) beyond_full_scale |= output.cwiseAbs().maxCoeff() >= *item->full_scale;
    if (k > 0 && readings[k].sequence > readings[k - 1].sequence)
      gaps += static_cast<std::int64_t>(readings[k].sequence - readings[k - 1].sequence - 1);
  }
  if (stated.count != static_cast<std::int64_t>(outputs.size())) return "number of readings";
  if (stated.lost < gaps) return "number of lost readings";
  const bool not_finite = outputs.size() < readings.size();
  if (not_finite != ((stated.flags & kFlagNotFinite) != 0U)) return "flag \"not finite\"";
  if (gaps > 0 && (stated.flags & kFlagLostReadings) == 0U) return "flag \"lost readings\"";
  if (beyond_full_scale && (stated.flags & kFlagClipped) == 0U) return "flag \"clipped\"";
  if (outputs.empty()) return "";
  const std::optional<double> resolution = item ? item->resolution : std::nullopt;
  const ReadingStatistics computed = reading_statistics(outputs, resolution.value_or(0.0));
  for (int j = 0; j < 3; ++j) {
    const double scale = std::max(std::abs(computed.mean[j]), computed.spread[j]);
    if (!agrees(stated.mean[j], computed.mean[j], kRounding * scale)) return "mean";
    if (!agrees(stated.spread[j], computed.spread[j], kSpreadRounding * scale)) return "spread";
    if (!stated.has_u) continue;
    const double tolerance = kUncertaintyRounding * computed.u_mean[j];
    // If the resolution is not stored, it may have raised the uncertainty above that of the readings.
    const bool raised = !resolution && stated.u_mean[j] > computed.u_mean[j];
    if (!raised && !agrees(stated.u_mean[j], computed.u_mean[j], tolerance)) return "standard uncertainty";
  }
  return "";
}

std::int64_t finite_readings(const StoredDwell& dwell) {
  return std::ranges::count_if(dwell.readings,
                               [](const StoredReading& reading) { return reading.output.allFinite(); });
}

/// Computes the statistics stated by dwells again. Dwells without any reading, as tests write them, state
/// nothing.
IntegrityCheck check_statements(const std::filesystem::path& run, const StoredRun& stored) {
  const std::string what = "readings";
  SqliteDatabase database = open_run_file_unchecked(run, SqliteDatabase::Mode::kReadOnly);
  SqliteStatement rows = database.prepare("select * from dwell order by id");
  const bool of_version_5 = has_faces(database);
  std::size_t dwells = 0, readings = 0, passed = 0;
  std::string wrong;
  const auto check = [&](const StoredDwell& dwell) {
    if (!rows.step() || !wrong.empty()) return;
    ++dwells;
    readings += dwell.readings.size();
    if (dwell.readings.empty()) return;
    if (of_version_5 && rows.optional_integer("sweep")) {
      ++passed;
      if (rows.integer("count") != finite_readings(dwell))
        wrong = fmt::format("dwell {} (experiment {}, n = {}): it does not have as many readings as it says",
                            dwells, dwell.experiment, dwell.n);
      return;
    }
    std::optional<RunItem> item;
    for (const RunItem& one : stored.header.items) {
      if (one.k == dwell.item) item = one;
    }
    const std::string differs = contradiction(stated_dwell(rows), dwell.readings, item);
    if (!differs.empty())
      wrong = fmt::format("dwell {} (experiment {}, n = {}): its {} does not follow from its readings",
                          dwells, dwell.experiment, dwell.n, differs);
  };
  read_all_dwells(database, check, 0);
  if (!wrong.empty()) return {what, false, wrong};
  if (passed > 0)
    return {what, true,
            fmt::format("{} angles were passed at a constant rate: their readings, {} with those of the "
                        "other angles, are counted, and their values linked, but not computed again",
                        passed, readings)};
  return {what, true,
          fmt::format("means, spreads, standard uncertainties and flags of {} dwells follow from {} readings",
                      dwells, readings)};
}

/// Checks the certificates of a run with several items: each item has its own, and each certificate replaces
/// the one before.
void check_certificates_of_items(const std::filesystem::path& run, std::size_t items,
                                 std::vector<IntegrityCheck>& checks) {
  std::map<int, std::vector<IssuedCertificate>> by_item;
  for (IssuedCertificate& one : ResultsFile::certificates(run)) {
    if (one.item >= 1 && static_cast<std::size_t>(one.item) <= items) {
      by_item[one.item].push_back(std::move(one));
      continue;
    }
    checks.push_back({"certificate " + one.number, false,
                      fmt::format("is stated to be of item {}; the run has items 1 to {}", one.item, items)});
  }
  for (const auto& [k, of_item] : by_item) {
    IntegrityCheck check{fmt::format("item {}, certificates", k), true, of_item.front().number, k};
    for (std::size_t i = 1; i < of_item.size(); ++i) {
      check.found += fmt::format(", replaced by {}", of_item[i].number);
      if (of_item[i].replaces == of_item[i - 1].number) continue;
      check.good = false;
      check.found += fmt::format(" (which states that it replaces {})",
                                 of_item[i].replaces.empty() ? "none" : of_item[i].replaces);
    }
    checks.push_back(std::move(check));
  }
}

/// Compares the bytes of a complete run with its results, if they state a hash.
void check_hash(CheckedRun& run) {
  const std::filesystem::path results = ResultsFile::path_beside(run.path);
  std::error_code error;
  if (!std::filesystem::exists(results, error)) return;
  SqliteDatabase database(results, SqliteDatabase::Mode::kReadOnly);
  // A disk that failed may have left an empty file.
  const auto named = database.has_table("run") ? database.value("select sha256 from run") : std::nullopt;
  if (!named) return;
  const std::string actual = sha256_of_file(run.path);
  run.sha256 = actual;
  run.hash = IntegrityCheck{
      "SHA-256", *named == actual,
      *named == actual ? actual : fmt::format("the run has {}, but its results state {}", actual, *named)};
}

IntegrityCheck check_analyses(SqliteDatabase& results) {
  return check_chain(results, "analyses", "analysis", {"utc", "program_version", "estimator", "result_json"});
}

void check_results(const CheckedRun& run, std::size_t items, std::vector<IntegrityCheck>& checks) {
  const std::filesystem::path results = ResultsFile::path_beside(run.path);
  std::error_code error;
  if (!std::filesystem::exists(results, error)) {
    checks.push_back({"SHA-256", false,
                      results.string() + ", which contains the hash of the run, is missing; `abcal analyse` "
                                         "creates it again, with a note that earlier analyses are unknown"});
    return;
  }
  checks.push_back(run.hash.value_or(IntegrityCheck{"SHA-256", false, "the results state none"}));
  SqliteDatabase database(results, SqliteDatabase::Mode::kReadOnly);
  std::string sound = database.value("pragma integrity_check(1)").value_or("no answer");
  const bool is_sound = sound == "ok";
  if (database.has_column("run", "note")) {
    const std::string note = database.value("select note from run").value_or("");
    if (!note.empty()) sound += "; " + note;
  }
  checks.push_back({"results file", is_sound, sound});
  checks.push_back(check_analyses(database));
  // Results from before the first certificates do not have this table.
  if (database.has_table("certificate")) {
    checks.push_back(check_chain(database, "certificates", "certificate",
                                 {"utc", "number", "measured_by", "approved_by", "date", "replaces", "reason",
                                  "program_version", "laboratory_toml", "xml"},
                                 "item"));
    if (items > 1) check_certificates_of_items(run.path, items, checks);
  }
}

}  // namespace

namespace {

/// The checks of the measurements themselves, which a run that is not closed passes as well.
void check_measurements(SqliteDatabase& database, CheckedRun& run) {
  const StoredRun& stored = run.items.front();
  std::vector<IntegrityCheck>& checks = run.measurements;
  // The two checks that read every reading of the run work in parallel.
  std::future<IntegrityCheck> statements =
      std::async(std::launch::async, [&] { return check_statements(run.path, stored); });
  checks.push_back(check_chain(database, "event log", "event", {"utc", "who", "kind", "text"}));
  checks.push_back(check_references(database));
  if (run_file_version(database) >= 3) checks.push_back(check_dwell_chain(database, run.complete()));
  if (std::ranges::any_of(stored.header.plan, [](const PlannedAngle& angle) { return angle.sweep > 0; }))
    checks.push_back(check_sweeps(database, stored.header.plan));
  if (stored.items.size() > 1) checks.push_back(check_items(database, stored));
  checks.push_back(statements.get());
}

}  // namespace

namespace {

/// Refuses a run that contradicts itself, or of which the results name another hash.
/// @param so  what is not done with it
void require_sound(const CheckedRun& run, const char* so) {
  std::string found;
  const auto look_at = [&found](const IntegrityCheck& check) {
    if (!check.good) found += fmt::format("{}{}: {}", found.empty() ? "" : "; ", check.what, check.found);
  };
  std::ranges::for_each(run.measurements, look_at);
  if (run.hash) look_at(*run.hash);
  if (found.empty()) return;
  throw RunFileError(fmt::format(
      "{}: the file was changed or is damaged: {}. It {}; restore it from a copy, or measure again",
      run.path.string(), found, so));
}

}  // namespace

CheckedRun read_and_check(const std::filesystem::path& run, int item) {
  // Opens, has the right schema and passes SQLite's own check, or throws. Every other reader of this run here
  // needs no second one.
  SqliteDatabase database = open_run_file(run, SqliteDatabase::Mode::kReadOnly);
  CheckedRun checked;
  checked.path = run;
  checked.items = RunFile::load_items(database, run, item);
  check_measurements(database, checked);
  if (checked.complete()) check_hash(checked);
  return checked;
}

void require_unchanged(const std::filesystem::path& run) {
  require_sound(read_and_check(run, 1), "is not continued");
}

std::optional<CheckedRun> read_if_as_closed(const std::filesystem::path& run) {
  SqliteDatabase database = open_run_file(run, SqliteDatabase::Mode::kReadOnly);
  CheckedRun checked;
  checked.path = run;
  checked.items = RunFile::load_items(database, run, 0);
  if (!checked.complete()) return std::nullopt;
  check_hash(checked);
  return checked.hash && checked.hash->good ? std::optional(std::move(checked)) : std::nullopt;
}

CheckedRun read_as_stored(const std::filesystem::path& run, int item) {
  CheckedRun checked = read_and_check(run, item);
  require_sound(checked, "gives no result");
  return checked;
}

std::vector<IntegrityCheck> verify_run(const std::filesystem::path& run) {
  return verify_run(read_and_check(run, 1));
}

std::vector<IntegrityCheck> verify_run(const CheckedRun& run) {
  std::vector<IntegrityCheck> checks;
  const StoredRun& stored = run.items.front();
  checks.push_back({"state", run.complete(),
                    run.complete()
                        ? "complete and closed"
                        : fmt::format("{}: only a closed run has a hash", to_string(stored.state))});
  checks.insert(checks.end(), run.measurements.begin(), run.measurements.end());
  if (run.complete()) check_results(run, stored.items.size(), checks);
  return checks;
}

bool analyses_are_linked(const std::filesystem::path& run) {
  SqliteDatabase results(ResultsFile::path_beside(run), SqliteDatabase::Mode::kReadOnly);
  return check_analyses(results).good;
}

std::string attested_by(const std::filesystem::path& run) {
  SqliteDatabase database = open_run_file(run, SqliteDatabase::Mode::kReadOnly);
  const bool chains_dwells = run_file_version(database) >= 3;
  return fmt::format(
      "The run and its results are consistent: the results name the SHA-256 of the run, and each entry of {} "
      "is linked to the previous one{}. There is neither a signature nor a time stamp: anyone with write "
      "access to both files can rebuild them consistently. Keep the SHA-256 elsewhere to detect this.",
      chains_dwells ? "dwells with their readings, events, analyses and certificates"
                    : "events, analyses and certificates",
      chains_dwells ? "" : " (run file version 2 does not link dwells)");
}

}  // namespace abcal
