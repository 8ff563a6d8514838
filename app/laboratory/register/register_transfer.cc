#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>

#include "app/laboratory/register/register.h"
#include "app/laboratory/register/register_schema.h"
#include "app/system/output.h"
#include "drivers/text/number.h"
#include "protocol/record/run_file.h"

namespace abcal::lab {
namespace {

constexpr const char* kBackupSchema = "abcal.register/1";

/// False for secrets, and for tables that only the program uses.
bool is_exported(std::string_view table) {
  return table != "login" && table != "audit_head" && table != "counter" && table != "schema_step";
}

bool is_secret(std::string_view column) {
  return column == "password";
}

/// Whether a spreadsheet would carry a cell out as a formula. A number begins with a sign as well.
bool begins_as_formula(const std::string& text) {
  if (text.empty() || std::string_view("=+-@\t").find(text.front()) == std::string_view::npos) return false;
  return !pieces::number<double>(std::string_view(text).substr(text.front() == '+' ? 1 : 0));
}

/// A cell of CSV that a terminal, an editor and a spreadsheet show as it is: a formula becomes text by an
/// apostrophe in front, as spreadsheets do it themselves.
std::string csv_field(const std::string& value) {
  std::string text = printable_text(value);
  if (begins_as_formula(text)) text.insert(0, "'");
  if (text.find_first_of("\",\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) {
    quoted += c;
    if (c == '"') quoted += c;
  }
  return quoted + '"';
}

nlohmann::ordered_json rows_of(Database& database, const TableDescription& table, bool with_secrets) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const Database::Row& row : database.query(table.columns.size(), select_all(table))) {
    nlohmann::ordered_json object = nlohmann::ordered_json::object();
    for (std::size_t k = 0; k < table.columns.size(); ++k)
      if (with_secrets || !is_secret(table.columns[k])) object[std::string(table.columns[k])] = row[k];
    rows.push_back(std::move(object));
  }
  return rows;
}

/// Parses a backup. @throws RegisterError for any other text
nlohmann::json parse_backup(const std::string& text) {
  nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  if (json.is_discarded() || !json.is_object() || json.value("schema", "") != kBackupSchema ||
      !json.contains("tables"))
    throw RegisterError(
        fmt::format("the backup is none; required: a file of `abcal lab backup` ({})", kBackupSchema));
  return json;
}

/// The text of a column of a row of a backup. @throws RegisterError if it has none
std::string text_of(const nlohmann::json& row, std::string_view table, const std::string& column) {
  if (!row.is_object() || !row.contains(column) || !row[column].is_string())
    throw RegisterError(fmt::format("the backup has a row of {} without {}; it is damaged", table, column));
  return row[column].get<std::string>();
}

std::int64_t number_of_entry(const std::string& text) {
  if (const auto number = pieces::number<std::int64_t>(text); number && *number >= 1) return *number;
  throw RegisterError(fmt::format("the backup has \"{}\" as the number of an entry; it is damaged", text));
}

void insert_rows(Database& database, const TableDescription& table, const nlohmann::json& rows) {
  for (const auto& row : rows) {
    std::vector<Parameter> values;
    for (const std::string_view column : table.columns) {
      const std::string name(column);
      values.push_back({name, text_of(row, table.name, name)});
    }
    database.insert(table.name, values);
  }
}

}  // namespace

RegisterEvidence evidence_of_backup(const std::string& name, const std::string& text) {
  const nlohmann::json json = parse_backup(text);
  const nlohmann::json& tables = json["tables"];
  const auto rows_of_table = [&](const char* table) -> const nlohmann::json& {
    if (!tables.contains(table) || !tables[table].is_array() || tables[table].empty())
      throw RegisterError(fmt::format("the backup lacks the table {}; it is damaged", table));
    return tables[table];
  };
  RegisterEvidence evidence;
  evidence.name = name;
  evidence.register_identity = text_of(rows_of_table("laboratory")[0], "laboratory", "identity");
  for (const nlohmann::json& row : rows_of_table("audit")) {
    const auto column = [&](const char* of) { return text_of(row, "audit", of); };
    evidence.audit.push_back({static_cast<std::size_t>(number_of_entry(column("entry"))), column("utc"),
                              column("who"), column("what"), column("subject"), column("before_json"),
                              column("after_json"), column("chain")});
  }
  const nlohmann::json& head = rows_of_table("audit_head")[0];
  evidence.head = AuditHead{number_of_entry(text_of(head, "audit_head", "entries")),
                            text_of(head, "audit_head", "chain")};
  std::map<std::string, std::string> ignored;
  const RegisterFinding own = check_audit_chain(evidence.audit, *evidence.head, ignored);
  if (!own.good)
    throw RegisterError(fmt::format("{}: the backup is not whole: {}: {}", name, own.what, own.found));
  return evidence;
}

std::string Register::backup() {
  DatabaseTransaction reading(database_, DatabaseTransaction::Purpose::kRead);
  nlohmann::ordered_json json{{"schema", kBackupSchema}, {"step", schema_step(database_)}};
  for (const TableDescription& table : register_tables())
    json["tables"][std::string(table.name)] = rows_of(database_, table, true);
  reading.commit();
  return json.dump(1) + "\n";
}

Register Register::restore(const std::string& location, const std::string& backup, Clock::UtcTime now) {
  const nlohmann::json json = parse_backup(backup);
  const int step = json.value("step", 0);
  if (step < 1 || step > kNewestSchemaStep)
    throw RegisterError(
        fmt::format("the backup has schema step {}; this program restores 1 to {}", step, kNewestSchemaStep));
  Register restored{make_empty(location)};
  Database& database = restored.database_;
  DatabaseTransaction transaction(database);
  apply_schema_steps(database, 0, format_utc(now), step);
  database.execute("delete from schema_step");
  for (const TableDescription& table : register_tables()) {
    if (table.since_step > step) continue;
    const std::string name(table.name);
    if (!json["tables"].contains(name))
      throw RegisterError(fmt::format("the backup lacks the table {}", name));
    insert_rows(database, table, json["tables"][name]);
  }
  restored.bring_to_newest_step(step, now);
  transaction.commit();
  restored.read_facts();
  for (const RegisterFinding& finding : restored.verify())
    // The order of the times is not a matter of wholeness; `abcal lab verify` judges it.
    if (!finding.good && finding.what != kTimesOfAudit)
      throw RegisterError(
          fmt::format("the backup is not whole: {}: {}; what was restored to {} must not be used",
                      finding.what, finding.found, without_password(location)));
  return restored;
}

std::vector<std::string> Register::exported_tables() {
  std::vector<std::string> names;
  for (const TableDescription& table : register_tables())
    if (is_exported(table.name)) names.emplace_back(table.name);
  return names;
}

std::string Register::export_csv(const std::string& name) {
  for (const TableDescription& table : register_tables()) {
    if (table.name != name || !is_exported(table.name)) continue;
    std::string text;
    const auto add_line = [&](const auto& value_of) {
      bool first = true;
      for (std::size_t k = 0; k < table.columns.size(); ++k) {
        if (is_secret(table.columns[k])) continue;
        text += (first ? "" : ",") + csv_field(value_of(k));
        first = false;
      }
      text += "\r\n";
    };
    add_line([&](std::size_t k) { return std::string(table.columns[k]); });
    for (const Database::Row& row : database_.query(table.columns.size(), select_all(table)))
      add_line([&](std::size_t k) { return row[k]; });
    return text;
  }
  throw RegisterError(fmt::format("table {}: is not exported", name));
}

std::string Register::export_json() {
  DatabaseTransaction reading(database_, DatabaseTransaction::Purpose::kRead);
  nlohmann::ordered_json json{{"schema", "abcal.register_export/1"}, {"laboratory", facts_.name}};
  for (const TableDescription& table : register_tables())
    if (is_exported(table.name)) json["tables"][std::string(table.name)] = rows_of(database_, table, false);
  reading.commit();
  return printable_text(json.dump(2)) + "\n";
}

}  // namespace abcal::lab
