#include "protocol/record/run_seal.h"

#include <utility>

#include "protocol/record/results_file.h"
#include "protocol/record/sqlite.h"

namespace abcal {
namespace {

bool has_results(const std::filesystem::path& run_path) {
  std::error_code error;
  return std::filesystem::exists(ResultsFile::path_beside(run_path), error);
}

SqliteDatabase open_results(const std::filesystem::path& run_path, SqliteDatabase::Mode mode) {
  const bool writes = mode != SqliteDatabase::Mode::kReadOnly;
  SqliteDatabase database(writes ? ResultsFile::path_to_write(run_path) : ResultsFile::path_beside(run_path),
                          mode);
  database.wait_at_most(std::chrono::seconds(30));  // Parallel programs add analyses.
  return database;
}

}  // namespace

RunSeal read_seal(const std::filesystem::path& run_path) {
  if (!has_results(run_path)) return {};
  SqliteDatabase database = open_results(run_path, SqliteDatabase::Mode::kReadOnly);
  // Results that abcal 0.1 began do not have these columns.
  if (database.value("select count(*) from pragma_table_info('run') where name = 'signer'") == "0") return {};
  SqliteStatement row = database.prepare("select signer, signature, time_stamp from run");
  if (!row.step()) return {};
  return {row.text(0), row.blob(1), row.blob(2)};
}

bool keep_time_stamp(const std::filesystem::path& run_path, const std::string& token) {
  SqliteDatabase database = open_results(run_path, SqliteDatabase::Mode::kReadWrite);
  Transaction transaction(database);
  if (!database.value("select time_stamp from run").value_or("").empty()) return false;
  SqliteStatement row = database.prepare("update run set time_stamp = :token");
  row.bind_blob(1, token);
  row.run();
  transaction.commit();
  return true;
}

std::vector<StoredAnalysis> stored_analyses(const std::filesystem::path& run_path) {
  if (!has_results(run_path)) return {};
  SqliteDatabase database = open_results(run_path, SqliteDatabase::Mode::kReadOnly);
  std::vector<StoredAnalysis> analyses;
  SqliteStatement rows =
      database.prepare("select utc, program_version, estimator, result_json from analysis order by id");
  while (rows.step()) analyses.push_back({rows.text(0), rows.text(1), rows.text(2), rows.text(3)});
  return analyses;
}

std::optional<StoredAnalysis> last_analysis(const std::filesystem::path& run_path,
                                            const std::string& estimator) {
  std::optional<StoredAnalysis> last;
  for (StoredAnalysis& each : stored_analyses(run_path))
    if (each.estimator == estimator) last = std::move(each);
  return last;
}

}  // namespace abcal
