#include "app/laboratory/register/register.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/laboratory/register/register_schema.h"
#include "app/system/version.h"
#include "drivers/text/names.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal::lab {
namespace {

constexpr const char* kTraining = "training";

/// A shorter wait is inside the tolerance of the order of times (audit_chain.h), and is not counted.
constexpr std::chrono::milliseconds kWaited{500};
constexpr const char* kLaboratoryKind = "laboratory";

const TableDescription& table_named(const std::string& name) {
  for (const TableDescription& table : register_tables())
    if (table.name == name) return table;
  throw std::logic_error("no table " + name);
}

/// A row in the form of the audit. Instead of a password's hash it has a hash of that hash.
std::string to_json(const TableDescription& table, const Database::Row& row) {
  nlohmann::ordered_json json;
  for (std::size_t k = 0; k < table.columns.size(); ++k) {
    const std::string column(table.columns[k]);
    json[column] = column == "password" && !row[k].empty() ? sha256_of(row[k]) : row[k];
  }
  return json.dump();
}

constexpr auto kRights = names<Right>({{Right::kMeasure, "measure"},
                                       {Right::kOperate, "operate"},
                                       {Right::kApprove, "approve"},
                                       {Right::kAdminister, "administer"}});

}  // namespace

std::string_view to_string(Right right) {
  return kRights.of(right, "unknown");
}

std::string all_rights() {
  return fmt::format("{}", fmt::join(kRights.all(), ", "));
}

std::optional<Right> right_from(std::string_view word) {
  return kRights.value(word);
}

bool Person::may(Right right) const {
  for (const Right has : rights)
    if (has == right) return true;
  return false;
}

LoggedIn::LoggedIn(Person person, std::string register_identity, std::string expires_utc)
    : person_(std::move(person)),
      register_identity_(std::move(register_identity)),
      expires_utc_(std::move(expires_utc)) {}

Register::Register(Database database) : database_(std::move(database)) {}

Register Register::create(const std::string& location, const NewRegister& facts, Clock::UtcTime now) {
  if (facts.administrator.empty() || facts.laboratory.empty())
    throw RegisterError("a register needs the name of its laboratory and of its first administrator");
  if (const std::string why = weakness_of(facts.password); !why.empty())
    throw RegisterError("the administrator's password: " + why);
  Register made(make_empty(location));
  Database& database = made.database_;
  const std::string utc = format_utc(now);
  DatabaseTransaction transaction(database);
  apply_schema_steps(database, 0, utc);
  database.execute("insert into audit_head(id, entries, chain) values(1, 0, '')");
  database.execute("insert into counter(name, last) values('certificate', 0)");
  made.change({facts.administrator, "register made", "laboratory", "1", {}}, now, [&] {
    database.insert("laboratory", {{"id", "1"},
                                   {"identity", random_token().substr(0, 32)},
                                   {"name", facts.laboratory},
                                   {"kind", facts.training ? kTraining : kLaboratoryKind},
                                   {"number_prefix", facts.training ? "T-" : facts.number_prefix},
                                   {"created_utc", utc}});
  });
  made.change({facts.administrator, "first administrator", "person", facts.administrator, {}}, now, [&] {
    database.insert("person", {{"name", facts.administrator},
                               {"role", "administrator"},
                               {"email", ""},
                               {"rights", all_rights()},
                               {"password", hash_password(facts.password, facts.cost)},
                               {"valid_from", utc.substr(0, 10)},
                               {"valid_to", ""}});
  });
  transaction.commit();
  made.read_facts();
  return made;
}

Register Register::open(const std::string& location, Clock::UtcTime now) {
  std::error_code ignored;
  if (!is_postgresql(location) && !std::filesystem::exists(location, ignored))
    throw RegisterError(fmt::format("register {}: no such file; `abcal lab init` makes one", location));
  Register opened{Database(location)};
  if (!opened.database_.has_register())
    throw RegisterError(fmt::format("register {}: holds no register; `abcal lab init` makes one",
                                    without_password(location)));
  if (const int step = schema_step(opened.database_); step < kNewestSchemaStep) {
    DatabaseTransaction transaction(opened.database_);
    opened.lock_audit();
    // Another program may have applied the steps in the meantime.
    opened.bring_to_newest_step(schema_step(opened.database_), now);
    transaction.commit();
  }
  opened.read_facts();
  return opened;
}

void Register::bring_to_newest_step(int database_step, Clock::UtcTime now) {
  apply_schema_steps(database_, database_step, format_utc(now));
  if (database_step >= 4) return;
  append_audit({std::string("abcal ") + program_version(),
                "schema step 4: from here on each entry has the time at which it was written",
                "schema_step",
                "4",
                {}},
               {}, {}, now);
}

void Register::read_facts() {
  const auto rows =
      database_.query(4, "select identity, name, kind, number_prefix from laboratory where id = 1");
  if (rows.empty())
    throw RegisterError(
        fmt::format("register {}: says nothing of its laboratory", without_password(location())));
  // Becomes part of a file name, so only identities that this program makes are accepted.
  if (rows[0][0].empty() || rows[0][0].find_first_not_of("0123456789abcdef") != std::string::npos)
    throw RegisterError(fmt::format("register {}: has the identity \"{}\"; it is damaged",
                                    without_password(location()), rows[0][0]));
  facts_ = {rows[0][0], rows[0][1], rows[0][2] == kTraining, rows[0][3]};
}

void Register::require(const LoggedIn& by, Right right) const {
  if (by.register_identity() != facts_.identity)
    throw RegisterError(fmt::format("{} is logged in to another register", by.name()));
  if (!by.person().may(right))
    throw RegisterError(
        fmt::format("{} may not do this; required: the right to {}", by.name(), to_string(right)));
}

void Register::require_new(const std::string& table, const std::string& key) {
  if (key.empty()) throw RegisterError(fmt::format("{}: no name is given", table));
  if (!row_json(table, key).empty())
    throw RegisterError(fmt::format("{} {}: is in the register already", table, key));
}

void Register::require_known(const std::string& table, const std::string& key) {
  if (row_json(table, key).empty())
    throw RegisterError(fmt::format("{} {}: is not in the register", table, key));
}

void Register::lock_audit() {
  database_.execute("update audit_head set entries = entries where id = 1");
  const std::chrono::nanoseconds waited =
      database_.since_begin() + std::exchange(hashing_, std::chrono::nanoseconds(0));
  waited_ = waited < kWaited ? std::chrono::nanoseconds(0) : waited;
}

std::string Register::row_json(const std::string& name, const std::string& key) {
  const TableDescription& table = table_named(name);
  std::string columns;
  for (const std::string_view column : table.columns)
    columns.append(columns.empty() ? "" : ", ").append(column);
  const auto rows = database_.query(
      table.columns.size(), fmt::format("select {} from {} where {} = :key", columns, name, table.columns[0]),
      {{"key", key}});
  return rows.empty() ? std::string() : to_json(table, rows[0]);
}

void Register::change(const Change& change, Clock::UtcTime now, const std::function<void()>& write) {
  const std::string before = row_json(change.table, change.key);
  write();
  append_audit(change, before, row_json(change.table, change.key), now);
}

void Register::change_alone(const Change& what, Clock::UtcTime now, const std::function<void()>& write) {
  DatabaseTransaction transaction(database_);
  lock_audit();
  change(what, now, write);
  transaction.commit();
}

AuditHead Register::audit_head() {
  const auto head = database_.query(2, "select entries, chain from audit_head where id = 1");
  if (head.size() != 1)
    throw RegisterError(fmt::format("register {}: its audit has no head", without_password(location())));
  return {std::stoll(head[0][0]), head[0][1]};
}

AuditEntry Register::last_entry() {
  const AuditHead head = audit_head();
  AuditEntry last;
  last.entry = static_cast<std::size_t>(head.entries);
  last.chain = head.sha256;
  const auto rows = database_.query(1, "select utc from audit where entry = :entry",
                                    {{"entry", std::to_string(head.entries)}});
  if (!rows.empty()) last.utc = rows[0][0];
  return last;
}

void Register::append_audit(const Change& change, const std::string& before, const std::string& after,
                            Clock::UtcTime now) {
  AuditEntry predecessor = last_entry();
  const std::string utc = format_utc(now + waited_);
  if (runs_backwards(predecessor.utc, utc)) {
    append_entry({0, utc, change.who, clock_set_back(predecessor, utc), kClock, {}, {}, {}}, predecessor);
    predecessor = last_entry();
  }
  append_entry({0,
                utc,
                change.who,
                change.reason.empty() ? change.what : change.what + ": " + change.reason,
                change.table + "/" + change.key,
                before,
                after,
                {}},
               predecessor);
}

void Register::append_entry(AuditEntry entry, const AuditEntry& predecessor) {
  entry.entry = predecessor.entry + 1;
  entry.chain = chain_of(predecessor.chain, entry);
  const std::string number = std::to_string(entry.entry);
  database_.insert("audit", {{"entry", number},
                             {"utc", entry.utc},
                             {"who", entry.who},
                             {"what", entry.what},
                             {"subject", entry.subject},
                             {"before_json", entry.before_json},
                             {"after_json", entry.after_json},
                             {"chain", entry.chain}});
  database_.execute("update audit_head set entries = :entry, chain = :chain where id = 1",
                    {{"entry", number}, {"chain", entry.chain}});
}

std::vector<AuditEntry> Register::audit() {
  std::vector<AuditEntry> entries;
  for (auto& row : database_.query(
           8,
           "select entry, utc, who, what, subject, before_json, after_json, chain from audit order by entry"))
    entries.push_back({std::stoul(row[0]), row[1], row[2], row[3], row[4], row[5], row[6], row[7]});
  return entries;
}

std::optional<std::int64_t> Register::newest_witnessed_head() {
  const auto rows = database_.query(1, "select entries from witnessed_head order by entries desc limit 1");
  return rows.empty() ? std::nullopt : std::optional<std::int64_t>(std::stoll(rows[0][0]));
}

std::vector<RegisterFinding> Register::verify() {
  DatabaseTransaction reading(database_, DatabaseTransaction::Purpose::kRead);
  std::vector<RegisterFinding> findings;
  const auto head = database_.query(2, "select entries, chain from audit_head where id = 1");
  std::map<std::string, std::string> last;
  if (head.empty()) return {{"audit", false, "it has no head"}};
  const std::vector<AuditEntry> entries = audit();
  findings.push_back(check_audit_chain(entries, {std::stoll(head[0][0]), head[0][1]}, last));
  findings.push_back(check_audit_times(entries));

  std::string wrong;
  std::size_t rows = 0;
  for (const TableDescription& table : register_tables()) {
    static constexpr std::array<std::string_view, 6> kNotAudited{"schema_step", "counter", "audit_head",
                                                                 "audit",       "login",   "witnessed_head"};
    if (std::find(kNotAudited.begin(), kNotAudited.end(), table.name) != kNotAudited.end()) continue;
    for (const Database::Row& row : database_.query(table.columns.size(), select_all(table))) {
      const std::string subject = std::string(table.name) + "/" + row[0];
      ++rows;
      const auto audited = last.find(subject);
      if (audited == last.end() || audited->second != to_json(table, row))
        wrong += (wrong.empty() ? "" : "; ") + subject + " is not as the audit says";
      if (audited != last.end()) last.erase(audited);
    }
  }
  for (const auto& [subject, row] : last)
    if (!row.empty()) wrong += (wrong.empty() ? "" : "; ") + subject + " is missing";
  findings.push_back(
      {"records", wrong.empty(), wrong.empty() ? fmt::format("{} as the audit says", rows) : wrong});

  const auto given = database_.query(1, "select last from counter where name = 'certificate'");
  const auto count = database_.query(1, "select count(*) from certificate");
  const bool each_once = !given.empty() && given[0][0] == count[0][0];
  findings.push_back(
      {"certificate numbers", each_once,
       each_once ? fmt::format("{} given, each once", count[0][0])
                 : fmt::format("{} given, {} known", given.empty() ? "?" : given[0][0], count[0][0])});

  if (const std::optional<std::int64_t> newest = newest_witnessed_head()) {
    const auto heads = database_.query(1, "select count(*) from witnessed_head");
    const std::int64_t count_of_entries = static_cast<std::int64_t>(entries.size());
    findings.push_back({"witnessed heads", *newest <= count_of_entries,
                        fmt::format("{}, the newest of entry {}; the audit has {} entries", heads[0][0],
                                    *newest, count_of_entries)});
  }
  reading.commit();
  return findings;
}

}  // namespace abcal::lab
