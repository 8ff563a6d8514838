#include "app/laboratory/register/register_schema.h"

#include <fmt/format.h>

#include <array>

#include "app/system/version.h"

namespace abcal::lab {
namespace {

// All columns are text, except counts: dates and times are ISO 8601, values are JSON. Statements of one step,
// the same for both databases.
constexpr std::array kStep1{
    "create table schema_step(step integer primary key, utc text not null, program_version text not null)",
    "create table laboratory(id integer primary key, identity text not null, name text not null, kind text "
    "not null, number_prefix text not null, created_utc text not null)",
    "create table counter(name text primary key, last integer not null)",
    "create table audit_head(id integer primary key, entries integer not null, chain text not null)",
    "create table audit(entry integer primary key, utc text not null, who text not null, what text not null, "
    "subject text not null, before_json text not null, after_json text not null, chain text not null)",
    "create table person(name text primary key, role text not null, email text not null, rights text not "
    "null, password text not null, valid_from text not null, valid_to text not null)",
    "create table login(token_hash text primary key, person text not null references person, created_utc "
    "text not null, expires_utc text not null)",
    "create table signing_key(fingerprint text primary key, owner text not null, kind text not null, "
    "public_pem text not null, valid_from text not null, valid_to text not null)",
    "create table equipment(identity text primary key, name text not null, maker text not null, model text "
    "not null, serial_number text not null, quantity text not null, retired text not null)",
    "create table calibration(certificate text primary key, equipment text not null references equipment, "
    "issuer text not null, performed text not null, due text not null, sha256 text not null, values_json "
    "text not null)",
    "create table item(identity text primary key, maker text not null, model text not null, serial_number "
    "text not null, owner text not null, retired text not null)",
    "create table check_standard(name text primary key, item text not null references item, baseline_json "
    "text not null, approved_by text not null, approved_utc text not null, retired text not null)",
    "create table certificate(number text primary key, state text not null, run_sha256 text not null, "
    "xml_sha256 text not null, item text not null, measured_by text not null, approved_by text not null, "
    "issue_date text not null, replaces text not null, reason text not null, utc text not null, approval "
    "text not null)",
    "create index certificate_of_run on certificate(run_sha256)",
};

// Charts of check standards, their blocks, and the scope of the laboratory.
constexpr std::array kStep2{
    "create table check_point(identity text primary key, check_standard text not null references "
    "check_standard, run_sha256 text not null, date text not null, values_json text not null, state text not "
    "null, found text not null, begins text not null, added_by text not null, utc text not null)",
    "create table bench_block(identity text primary key, check_standard text not null references "
    "check_standard, stage text not null, bench text not null, found text not null, set_utc text not null, "
    "lifted_by text not null, lifted_utc text not null, reason text not null)",
    "create table scope(identity text primary key, quantity text not null, unit text not null, range_from "
    "text not null, range_to text not null, cmc text not null, kind text not null, valid_from text not null, "
    "retired text not null)",
};

// Runs of check standards that wait to be judged.
constexpr std::array kStep3{
    "create table check_run(identity text primary key, check_standard text not null references "
    "check_standard, run_sha256 text not null, file text not null, date text not null, told_by text not "
    "null, utc text not null)",
};

// Heads of the audit that a witness signed.
constexpr std::array kStep4{
    "create table witnessed_head(entries integer primary key, line text not null, signature text not null)",
};

// The records that runs rest on, to whom certificates went, what was withdrawn, how long records are kept.
constexpr std::array kStep5{
    "create table known_run(run_sha256 text primary key, file text not null, item text not null, date text "
    "not null, told_by text not null, utc text not null)",
    "create table used_source(identity text primary key, run_sha256 text not null references known_run, kind "
    "text not null, name text not null, serial_number text not null, role text not null)",
    "create index used_source_by_name on used_source(name)",
    "create index used_source_by_serial_number on used_source(serial_number)",
    "create index used_source_of_run on used_source(run_sha256)",
    "create index calibration_of_equipment on calibration(equipment)",
    "create table certified_run(identity text primary key, certificate text not null references certificate, "
    "run_sha256 text not null)",
    "create index certified_run_by_run on certified_run(run_sha256)",
    "create index certified_run_of_certificate on certified_run(certificate)",
    "create index certificate_by_replaced on certificate(replaces)",
    "create table addressee(certificate text primary key references certificate, name text not null, address "
    "text not null, email text not null, language text not null)",
    "create table withdrawal(identity text primary key, kind text not null, name text not null, reason text "
    "not null, withdrawn_by text not null, utc text not null)",
    "create index withdrawal_by_name on withdrawal(name)",
    "create table retention(kind text primary key, years text not null, set_by text not null, utc text not "
    "null)",
};

constexpr std::array<std::string_view, 3> kSchemaStep{"step", "utc", "program_version"};
constexpr std::array<std::string_view, 6> kLaboratory{"id",   "identity",      "name",
                                                      "kind", "number_prefix", "created_utc"};
constexpr std::array<std::string_view, 2> kCounter{"name", "last"};
constexpr std::array<std::string_view, 3> kAuditHead{"id", "entries", "chain"};
constexpr std::array<std::string_view, 8> kAudit{"entry",   "utc",         "who",        "what",
                                                 "subject", "before_json", "after_json", "chain"};
constexpr std::array<std::string_view, 7> kPerson{"name",     "role",       "email",   "rights",
                                                  "password", "valid_from", "valid_to"};
constexpr std::array<std::string_view, 4> kLogin{"token_hash", "person", "created_utc", "expires_utc"};
constexpr std::array<std::string_view, 6> kSigningKey{"fingerprint", "owner",      "kind",
                                                      "public_pem",  "valid_from", "valid_to"};
constexpr std::array<std::string_view, 7> kEquipment{"identity",      "name",     "maker",  "model",
                                                     "serial_number", "quantity", "retired"};
constexpr std::array<std::string_view, 7> kCalibration{"certificate", "equipment", "issuer",     "performed",
                                                       "due",         "sha256",    "values_json"};
constexpr std::array<std::string_view, 6> kItem{"identity",      "maker", "model",
                                                "serial_number", "owner", "retired"};
constexpr std::array<std::string_view, 6> kCheckStandard{"name",        "item",         "baseline_json",
                                                         "approved_by", "approved_utc", "retired"};
constexpr std::array<std::string_view, 12> kCertificate{
    "number",      "state",      "run_sha256", "xml_sha256", "item", "measured_by",
    "approved_by", "issue_date", "replaces",   "reason",     "utc",  "approval"};

constexpr std::array<std::string_view, 10> kCheckPoint{
    "identity", "check_standard", "run_sha256", "date",     "values_json",
    "state",    "found",          "begins",     "added_by", "utc"};
constexpr std::array<std::string_view, 9> kBenchBlock{
    "identity", "check_standard", "stage", "bench", "found", "set_utc", "lifted_by", "lifted_utc", "reason"};
constexpr std::array<std::string_view, 9> kScope{
    "identity", "quantity", "unit", "range_from", "range_to", "cmc", "kind", "valid_from", "retired"};

constexpr std::array<std::string_view, 7> kCheckRun{"identity", "check_standard", "run_sha256", "file",
                                                    "date",     "told_by",        "utc"};

constexpr std::array<std::string_view, 3> kWitnessedHead{"entries", "line", "signature"};

constexpr std::array<std::string_view, 6> kKnownRun{"run_sha256", "file", "item", "date", "told_by", "utc"};
constexpr std::array<std::string_view, 6> kUsedSource{"identity", "run_sha256",    "kind",
                                                      "name",     "serial_number", "role"};
constexpr std::array<std::string_view, 3> kCertifiedRun{"identity", "certificate", "run_sha256"};
constexpr std::array<std::string_view, 5> kAddressee{"certificate", "name", "address", "email", "language"};
constexpr std::array<std::string_view, 6> kWithdrawal{"identity", "kind",         "name",
                                                      "reason",   "withdrawn_by", "utc"};
constexpr std::array<std::string_view, 4> kRetention{"kind", "years", "set_by", "utc"};

// In an order in which rows that refer to others follow them.
constexpr std::array kTables{
    TableDescription{"schema_step", kSchemaStep, "step"},
    TableDescription{"laboratory", kLaboratory, "id"},
    TableDescription{"counter", kCounter, "name"},
    TableDescription{"audit_head", kAuditHead, "id"},
    TableDescription{"audit", kAudit, "entry"},
    TableDescription{"person", kPerson, "name"},
    TableDescription{"login", kLogin, "token_hash"},
    TableDescription{"signing_key", kSigningKey, "fingerprint"},
    TableDescription{"equipment", kEquipment, "identity"},
    TableDescription{"calibration", kCalibration, "certificate"},
    TableDescription{"item", kItem, "identity"},
    TableDescription{"check_standard", kCheckStandard, "name"},
    TableDescription{"certificate", kCertificate, "number"},
    TableDescription{"check_point", kCheckPoint, "check_standard, length(identity), identity", 2},
    TableDescription{"bench_block", kBenchBlock, "set_utc, identity", 2},
    TableDescription{"scope", kScope, "identity", 2},
    TableDescription{"check_run", kCheckRun, "check_standard, date, identity", 3},
    TableDescription{"witnessed_head", kWitnessedHead, "entries", 4},
    TableDescription{"known_run", kKnownRun, "date, run_sha256", 5},
    TableDescription{"used_source", kUsedSource, "identity", 5},
    TableDescription{"certified_run", kCertifiedRun, "identity", 5},
    TableDescription{"addressee", kAddressee, "certificate", 5},
    TableDescription{"withdrawal", kWithdrawal, "utc, identity", 5},
    TableDescription{"retention", kRetention, "kind", 5},
};

void note_step(Database& database, int step, const std::string& utc) {
  database.insert("schema_step",
                  {{"step", std::to_string(step)}, {"utc", utc}, {"program_version", program_version()}});
}

}  // namespace

std::span<const TableDescription> register_tables() {
  return kTables;
}

std::string select_all(const TableDescription& table) {
  std::string columns;
  for (const std::string_view column : table.columns)
    columns.append(columns.empty() ? "" : ", ").append(column);
  return fmt::format("select {} from {} order by {}", columns, table.name, table.order);
}

void apply_schema_steps(Database& database, int database_step, const std::string& utc, int to_step) {
  if (database_step < 1) {
    for (const char* statement : kStep1) database.execute(statement);
    note_step(database, 1, utc);
  }
  if (database_step < 2 && to_step >= 2) {
    for (const char* statement : kStep2) database.execute(statement);
    note_step(database, 2, utc);
  }
  if (database_step < 3 && to_step >= 3) {
    for (const char* statement : kStep3) database.execute(statement);
    note_step(database, 3, utc);
  }
  if (database_step < 4 && to_step >= 4) {
    for (const char* statement : kStep4) database.execute(statement);
    note_step(database, 4, utc);
  }
  if (database_step < 5 && to_step >= 5) {
    for (const char* statement : kStep5) database.execute(statement);
    note_step(database, 5, utc);
  }
}

int schema_step(Database& database) {
  const auto rows = database.query(1, "select max(step) from schema_step");
  const int step = rows.empty() || rows[0][0].empty() ? 0 : std::stoi(rows[0][0]);
  if (step > kNewestSchemaStep)
    throw RegisterError(fmt::format(
        "register {}: was written by a newer abcal (schema step {}, this program knows {}); update abcal",
        without_password(database.location()), step, kNewestSchemaStep));
  return step;
}

}  // namespace abcal::lab
