#include "protocol/record/results_file.h"

#include <fmt/format.h>

#include <algorithm>

#include "protocol/record/sha256.h"

namespace abcal {
namespace {

/// Analyses of parallel programs wait for one another; each holds the file for one commit.
constexpr std::chrono::milliseconds kPatienceForOthers{30'000};

constexpr const char* kResultsSchema = R"(
create table if not exists run(sha256 text primary key, note text, signer text, signature blob, time_stamp blob)
  without rowid;
create table if not exists analysis(id integer primary key, utc text, program_version text, estimator text,
                                    result_json text, chain text);
create table if not exists certificate(id integer primary key, utc text, number text unique, measured_by text,
                                       approved_by text, date text, replaces text, reason text,
                                       program_version text, laboratory_toml text, xml text, chain text,
                                       item integer);
)";

/// Adds columns to results of an earlier abcal: they stay readable, and `verify` reports missing data.
void add_missing_columns(SqliteDatabase& database) {
  if (!database.has_column("analysis", "chain"))
    database.execute("alter table analysis add column chain text");
  if (!database.has_column("certificate", "item"))
    database.execute("alter table certificate add column item integer");
  if (database.has_column("run", "note")) return;
  for (const char* column : {"note text", "signer text", "signature blob", "time_stamp blob"})
    database.execute(std::string("alter table run add column ") + column);
}

std::string last_link(SqliteDatabase& database, const std::string& table) {
  return database.value("select chain from " + table + " order by id desc limit 1").value_or("");
}

}  // namespace

std::filesystem::path ResultsFile::path_beside(const std::filesystem::path& run_path) {
  return run_path.string() + ".results";
}

std::filesystem::path ResultsFile::path_to_write(const std::filesystem::path& run_path) {
  std::filesystem::path results = path_beside(run_path);
  std::error_code ignored;
  if (!std::filesystem::is_symlink(results, ignored)) return results;
  throw RunFileError(results.string() +
                     ": is a link, through which nothing is written; required: the file itself, "
                     "or none. Remove the link");
}

void ResultsFile::require_none(const std::filesystem::path& run_path) {
  const std::filesystem::path results = path_beside(run_path);
  std::error_code ignored;
  if (!std::filesystem::exists(std::filesystem::symlink_status(results, ignored)))
    return;  // Nor is it a link.
  throw RunFileError(results.string() + ": belongs to another run, so the results of " + run_path.string() +
                     " could not be stored; required: no such file before a run is closed. Move it to the "
                     "run to which it belongs, or choose another name with -o");
}

ResultsFile::ResultsFile(const std::filesystem::path& run_path)
    : database_(path_to_write(run_path), SqliteDatabase::Mode::kCreate) {
  database_.wait_at_most(kPatienceForOthers);
  database_.execute("pragma synchronous=full");
}

void ResultsFile::begin(const std::filesystem::path& run_path) {
  ResultsFile results(run_path);
  Transaction transaction(results.database_);
  results.database_.execute(kResultsSchema);
  transaction.commit();
}

ResultsFile::ResultsFile(const std::filesystem::path& run_path, const std::string& run_sha256)
    : ResultsFile(run_path) {
  Transaction transaction(database_);
  const bool is_begun = database_.has_table("run");
  database_.execute(kResultsSchema);
  add_missing_columns(database_);
  if (const auto stored = database_.value("select sha256 from run"); stored && *stored != run_sha256) {
    throw RunFileError(path_beside(run_path).string() + ": belongs to a run with SHA-256 " + *stored +
                       ", but " + run_path.string() + " has " + run_sha256 + ": one of the two was changed");
  } else if (!stored) {
    made_again_ = !is_begun;
    database_.insert("run").set("sha256", run_sha256).set("note", made_again_ ? kMadeAgain : "").run();
  }
  transaction.commit();
}

std::size_t ResultsFile::analyses() {
  return static_cast<std::size_t>(
      std::stoull(database_.value("select count(*) from analysis").value_or("0")));
}

void ResultsFile::add_analysis(const std::string& utc, std::string_view program_version,
                               std::string_view estimator, std::string_view result_json) {
  // No other program can add an analysis between reading the last link and the commit.
  Transaction transaction(database_);
  {
    SqliteStatement same = database_.prepare(
        "select 1 from analysis where program_version=:version and estimator=:estimator and "
        "result_json=:json");
    same.set("version", program_version).set("estimator", estimator).set("json", result_json);
    if (same.step()) return;
  }
  const std::string link =
      next_link(last_link(database_, "analysis"),
                {utc, std::string(program_version), std::string(estimator), std::string(result_json)});
  database_.insert("analysis")
      .set("utc", utc)
      .set("program_version", program_version)
      .set("estimator", estimator)
      .set("result_json", result_json)
      .set("chain", link)
      .run();
  transaction.commit();
}

namespace {

std::vector<IssuedCertificate> read_certificates(SqliteDatabase& database) {
  std::vector<IssuedCertificate> certificates;
  // Results from before the first certificates do not have this table.
  if (!database.has_table("certificate")) return certificates;
  const bool knows_items = database.has_column("certificate", "item");
  SqliteStatement rows = database.prepare("select * from certificate order by id");
  while (rows.step()) {
    certificates.push_back({rows.text("utc"), rows.text("number"), rows.text("measured_by"),
                            rows.text("approved_by"), rows.text("date"), rows.text("replaces"),
                            rows.text("reason"), rows.text("program_version"), rows.text("laboratory_toml"),
                            rows.text("xml"), knows_items ? static_cast<int>(rows.integer("item")) : 0});
  }
  return certificates;
}

/// @throws RunFileError if a certificate cannot be issued in addition to the existing ones
void require_issuable(const IssuedCertificate& certificate, const std::vector<IssuedCertificate>& issued,
                      const std::string& results) {
  const IssuedCertificate* last = nullptr;  // Last certificate of the same item.
  bool replaces_one = false;
  for (const IssuedCertificate& one : issued) {
    if (one.number == certificate.number)
      throw RunFileError(results + ": certificate " + one.number + " was issued on " + one.date +
                         "; each number is used only once");
    if (!certificate.replaces.empty() && one.replaces == certificate.replaces)
      throw RunFileError(results + ": certificate " + certificate.replaces + " is replaced by " + one.number +
                         " already; replace that one");
    if (one.item != certificate.item && one.number == certificate.replaces)
      throw RunFileError(fmt::format("{}: --replaces {}: is of item {}; required: a certificate of item {}",
                                     results, one.number, one.item, certificate.item));
    if (one.item != certificate.item) continue;
    last = &one;
    replaces_one = replaces_one || one.number == certificate.replaces;
  }
  if (last != nullptr && !replaces_one)
    throw RunFileError(
        fmt::format("{}: certificate {} was issued for {} already; amend it with --replaces {} --reason TEXT",
                    results, last->number,
                    certificate.item > 0 ? fmt::format("item {} of this run", certificate.item) : "this run",
                    last->number));
}

}  // namespace

void ResultsFile::add_certificate(const IssuedCertificate& certificate) {
  Transaction transaction(database_);
  const std::string results = database_.value("select file from pragma_database_list").value_or("results");
  require_issuable(certificate, read_certificates(database_), results);
  Insertion row = database_.insert("certificate");
  std::vector<std::string> fields;  // In the order of the link.
  for (const auto& [column, value] : {std::pair{"utc", certificate.utc},
                                      {"number", certificate.number},
                                      {"measured_by", certificate.measured_by},
                                      {"approved_by", certificate.approved_by},
                                      {"date", certificate.date},
                                      {"replaces", certificate.replaces},
                                      {"reason", certificate.reason},
                                      {"program_version", certificate.program_version},
                                      {"laboratory_toml", certificate.laboratory_toml},
                                      {"xml", certificate.xml}}) {
    row.set(column, value);
    fields.push_back(value);
  }
  // A certificate of a run with one item is linked as it always was.
  std::optional<std::int64_t> item;
  if (certificate.item > 0) {
    item = certificate.item;
    fields.push_back(std::to_string(certificate.item));
  }
  row.set("item", item).set("chain", next_link(last_link(database_, "certificate"), fields)).run();
  transaction.commit();
}

std::vector<IssuedCertificate> ResultsFile::certificates(const std::filesystem::path& run_path) {
  std::error_code error;
  if (!std::filesystem::exists(path_beside(run_path), error)) return {};
  SqliteDatabase database(path_beside(run_path), SqliteDatabase::Mode::kReadOnly);
  return read_certificates(database);
}

std::vector<IssuedCertificate> ResultsFile::certificates(const std::filesystem::path& run_path, int item) {
  std::vector<IssuedCertificate> all = certificates(run_path);
  std::erase_if(all,
                [&](const IssuedCertificate& one) { return std::max(one.item, 1) != std::max(item, 1); });
  return all;
}

}  // namespace abcal
