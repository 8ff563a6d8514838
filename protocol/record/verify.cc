#include "protocol/record/verify.h"

#include <fmt/format.h>

#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"

namespace abcal {
namespace {

/// Follows the chain of a table whose last column is the link.
IntegrityCheck check_chain(SqliteDatabase& database, const std::string& what, const std::string& table,
                           const std::vector<std::string>& columns) {
  std::string sql = "select ";
  for (const std::string& column : columns) sql += column + ", ";
  if (database.value("select count(*) from pragma_table_info('" + table + "') where name = 'chain'") == "0")
    return {what, false, "written by an abcal that did not chain it yet"};
  SqliteStatement rows = database.prepare(sql + "chain from " + table + " order by id");
  std::string link;
  std::size_t count = 0;
  while (rows.step()) {
    ++count;
    std::vector<std::string> fields;
    for (std::size_t k = 0; k < columns.size(); ++k) fields.push_back(rows.text(static_cast<int>(k)));
    link = next_link(link, fields);
    if (link != rows.text(static_cast<int>(columns.size())))
      return {what, false,
              fmt::format("entry {} of the {} table, or one before it, was changed", count, table)};
  }
  return {what, true, fmt::format("{} entries, each linked to the one before", count)};
}

}  // namespace

std::vector<IntegrityCheck> verify_run(const std::filesystem::path& run) {
  std::vector<IntegrityCheck> checks;
  // Opens, has the right schema and passes SQLite's own check, or throws.
  const StoredRun stored = RunFile::load(run);
  const bool complete = stored.state == RunState::kComplete;
  checks.push_back({"state", complete,
                    complete ? "complete and closed"
                             : fmt::format("{}: only a closed run has a hash", to_string(stored.state))});
  {
    SqliteDatabase database(run, SqliteDatabase::Mode::kReadOnly);
    checks.push_back(check_chain(database, "event log", "event", {"utc", "who", "kind", "text"}));
  }
  if (!complete) return checks;

  const std::filesystem::path results = ResultsFile::path_beside(run);
  std::error_code error;
  if (!std::filesystem::exists(results, error)) {
    checks.push_back({"SHA-256", false, results.string() + ", which names the hash of the run, is missing"});
    return checks;
  }
  SqliteDatabase database(results, SqliteDatabase::Mode::kReadOnly);
  const std::string named = database.value("select sha256 from run").value_or("none");
  const std::string actual = sha256_of_file(run);
  checks.push_back(
      {"SHA-256", named == actual,
       named == actual ? actual : fmt::format("the run has {}, its results name {}", actual, named)});
  const std::string sound = database.value("pragma integrity_check(1)").value_or("no answer");
  checks.push_back({"results file", sound == "ok", sound});
  checks.push_back(
      check_chain(database, "analyses", "analysis", {"utc", "program_version", "estimator", "result_json"}));
  // Results of before certificates were issued have no such table.
  if (database.value("select 1 from sqlite_master where type='table' and name='certificate'")) {
    checks.push_back(check_chain(database, "certificates", "certificate",
                                 {"utc", "number", "measured_by", "approved_by", "date", "replaces", "reason",
                                  "program_version", "laboratory_toml", "xml"}));
  }
  return checks;
}

}  // namespace abcal
