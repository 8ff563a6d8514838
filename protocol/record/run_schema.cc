#include "protocol/record/run_schema.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "protocol/record/dwell_chain.h"
#include "protocol/record/dwell_rows.h"

namespace abcal {
namespace {

constexpr std::string_view kSqliteMagic{"SQLite format 3\0", 16};

/// In every version since 2.
constexpr const char* kTablesOfVersion2 = R"(
create table meta(key text primary key, value text not null) without rowid;
create table instrument(role text primary key, maker text, model text, serial_number text, firmware text,
                        details text) without rowid;
create table plan(position integer primary key, experiment integer, n integer, closing integer, alpha_deg real,
                  x_deg real, z_deg real);
create table environment(id integer primary key, utc text, moment text, temperature_degc real,
                         humidity_percent real, pressure_hpa real);
create table event(id integer primary key, utc text, who text, kind text, text text, chain text);
)";

/// Version 2 alone has it.
constexpr const char* kDwellsOfVersion2 = R"(
create table dwell(id integer primary key, position integer not null references plan, experiment integer, n integer,
                   closing integer, alpha_deg real, commanded_x_deg real, commanded_z_deg real, encoder_x_deg real,
                   encoder_z_deg real, time_s real, settle_s real, count integer, lost integer,
                   r_u real, r_v real, r_w real, spread_u real, spread_v real, spread_w real,
                   u_u real, u_v real, u_w real, temperature_degc real, flags integer, flag_words text);
create table reading(dwell integer not null references dwell, k integer not null, sequence integer, time_s real,
                     u real, v real, w real, temperature_degc real, primary key(dwell, k)) without rowid;
)";

/// New in version 3. A reading holds the differences from the constants of its dwell; the view timed_reading
/// combines both.
constexpr const char* kTablesOfVersion3 = R"(
create table item(k integer primary key, maker text, model text, serial_number text, firmware text, driver text,
                  port text, mounting text, response_unit text, rate_hz real, full_scale real, resolution real);
create table item_register(item integer not null references item, name text not null, value text,
                           primary key(item, name)) without rowid;
create table session(id integer primary key, begun_utc text, begun_utc_ns integer, origin_ns integer not null,
                     monotonic_ns integer, boot_id text, since_boot_ns integer, clock_offset_s real,
                     clock_error_s real, program_version text, ended_utc text, end_reason text);
create table dwell(id integer primary key, position integer not null references plan,
                   item integer not null references item, role text not null,
                   session integer not null references session, experiment integer, n integer, closing integer,
                   alpha_deg real, commanded_x_deg real, commanded_z_deg real, encoder_x_deg real, encoder_z_deg real,
                   time_ns integer, time_s real, utc text, settle_s real, count integer, lost integer,
                   r_u real, r_v real, r_w real, spread_u real, spread_v real, spread_w real,
                   u_u real, u_v real, u_w real, temperature_degc real, flags integer, flag_words text,
                   first_sequence integer, first_reading_ns integer, reading_interval_ns integer,
                   first_temperature_degc real, temperature_step_degc real, chain text);
create table reading(dwell integer not null references dwell, k integer not null, u real, v real, w real,
                     skipped integer, late_ns integer, temperature_steps, primary key(dwell, k)) without rowid;
create table seal(id integer primary key, utc text, dwells integer, dwell_chain text, event_chain text, signer text,
                  signature blob, time_stamp blob);
create view timed_reading as
  select r.dwell, r.k, d.first_sequence + r.k + r.skipped as sequence,
         d.first_reading_ns + r.k * d.reading_interval_ns + r.late_ns as time_ns,
         s.begun_utc_ns + d.first_reading_ns + r.k * d.reading_interval_ns + r.late_ns as utc_ns,
         (s.origin_ns + d.first_reading_ns + r.k * d.reading_interval_ns + r.late_ns) / 1e9 as time_s,
         r.u, r.v, r.w, d.first_temperature_degc + r.temperature_steps * d.temperature_step_degc as temperature_degc
  from reading r join dwell d on d.id = r.dwell join session s on s.id = d.session;
)";

/// New in version 4.
constexpr const char* kTablesOfVersion4 = R"(
create table witness(id integer primary key, line text not null, signature blob not null);
)";

/// New in version 5: faces; angles that the stage passes at a constant rate; and the losses of a dwell have a
/// table of their own, as they are rare and a column would make each reading longer. From reading k on
/// `skipped` readings are missing.
constexpr const char* kChangesOfVersion5 = R"(
alter table plan add column face integer not null default 1;
alter table dwell add column face integer not null default 1;
alter table plan add column sweep integer not null default 0;
alter table plan add column rate_deg_per_s real not null default 0;
alter table dwell add column sweep integer;
alter table dwell add column rate_deg_per_s real;
alter table dwell add column acceleration_deg_per_s2 real;
alter table dwell add column u_angle_deg real;
create table encoder_sample(dwell integer not null references dwell, k integer not null, time_ns integer, angle_deg real,
                            primary key(dwell, k)) without rowid;
create table reading_gap(dwell integer not null references dwell, k integer not null, skipped integer not null,
                         primary key(dwell, k)) without rowid;
insert into reading_gap
  select dwell, k, skipped
    from (select dwell, k, skipped, lag(skipped, 1, 0) over (partition by dwell order by k) as before from reading)
    where skipped <> before;
drop view timed_reading;
alter table reading drop column skipped;
create view timed_reading as
  select r.dwell, r.k,
         d.first_sequence + r.k + coalesce((select g.skipped from reading_gap g where g.dwell = r.dwell and g.k <= r.k
                                              order by g.k desc limit 1), 0) as sequence,
         d.first_reading_ns + r.k * d.reading_interval_ns + r.late_ns as time_ns,
         s.begun_utc_ns + d.first_reading_ns + r.k * d.reading_interval_ns + r.late_ns as utc_ns,
         (s.origin_ns + d.first_reading_ns + r.k * d.reading_interval_ns + r.late_ns) / 1e9 as time_s,
         r.u, r.v, r.w, d.first_temperature_degc + r.temperature_steps * d.temperature_step_degc as temperature_degc
  from reading r join dwell d on d.id = r.dwell join session s on s.id = d.session;
)";

/// New in version 6: the last event and the last reading of the room's conditions before the dwell, which its
/// link covers.
constexpr const char* kChangesOfVersion6 = R"(
alter table dwell add column event integer;
alter table dwell add column environment integer;
)";

struct OptionalTable {
  std::string_view name;
  const char* sql;
};
constexpr std::array<OptionalTable, 3> kOptionalTables{
    {{"wire",
      "create table if not exists wire(id integer primary key, role text, time_ns integer, arrival_ns "
      "integer, kind text, bytes blob)"},
     // The event gives the reason.
     {"item_drop",
      "create table if not exists item_drop(item integer primary key references item, position integer not "
      "null, event integer not null references event)"},
     // Sentences and values of the texts of events: what an event says in another language. They count only
     // where they make exactly the text of their event.
     {"message",
      "create table if not exists message(event integer primary key references event, message text not "
      "null)"}}};

/// A program that was killed may leave a change half made, which a read-only connection cannot take back.
void recover(const std::filesystem::path& path) {
  std::error_code ignored;
  if (!std::filesystem::exists(path.string() + "-journal", ignored)) return;
  SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).value("pragma schema_version");
}

void mark_version(SqliteDatabase& database, std::int64_t version) {
  database.execute(
      fmt::format("pragma application_id={}; pragma user_version={};", kRunFileApplicationId, version));
}

std::string meta_value(SqliteDatabase& database, const std::string& key) {
  SqliteStatement row = database.prepare("select value from meta where key = :key");
  row.set("key", std::string_view(key));
  return row.step() ? row.text("value") : "";
}

}  // namespace

void create_run_schema(SqliteDatabase& database, std::int64_t version) {
  mark_version(database, version);
  database.execute(kTablesOfVersion2);
  database.execute(kTablesOfVersion3);
  if (version >= 4) database.execute(kTablesOfVersion4);
  if (version >= 5) database.execute(kChangesOfVersion5);
  if (version >= 6) database.execute(kChangesOfVersion6);
}

void create_optional_table(SqliteDatabase& database, std::string_view name) {
  database.execute(std::ranges::find(kOptionalTables, name, &OptionalTable::name)->sql);
}

std::int64_t run_file_version(SqliteDatabase& database) {
  return std::stoll(database.value("pragma user_version").value_or("0"));
}

bool has_faces(SqliteDatabase& database) {
  return run_file_version(database) >= 5;
}

bool has_reading_gaps(SqliteDatabase& database) {
  return run_file_version(database) >= 5;
}

bool links_all(SqliteDatabase& database) {
  return run_file_version(database) >= 6;
}

namespace {

/// A loose cable or a network may fail once: reads again then.
template <typename Read>
auto read_twice_if_disk_fails(const Read& read) {
  try {
    return read();
  } catch (const DiskError&) {
    return read();
  }
}

}  // namespace

std::string first_bytes(const std::filesystem::path& path, std::size_t count) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(path, ignored) || ::access(path.c_str(), R_OK) != 0) return {};
  return read_twice_if_disk_fails(
      [&] { return SqliteDatabase(path, SqliteDatabase::Mode::kReadOnly).first_bytes(count); });
}

bool begins_as_sqlite(const std::filesystem::path& path) {
  return first_bytes(path, kSqliteMagic.size()) == kSqliteMagic;
}

bool is_ros2_bag(const std::filesystem::path& path) {
  // SQLite file format, section 1.3: a run file has the application id "ABCL" there, and need not be opened.
  constexpr std::size_t kApplicationIdAt = 68;
  constexpr std::string_view kOfRunFiles = "ABCL";
  if (first_bytes(path, kApplicationIdAt + kOfRunFiles.size()).ends_with(kOfRunFiles)) return false;
  try {
    SqliteDatabase database(path, SqliteDatabase::Mode::kReadOnly);
    return database.has_table("topics") && database.has_table("messages");
  } catch (const RunFileError&) {  // Whoever reads it reports what is wrong.
    return false;
  }
}

bool uses_write_ahead_log(const std::filesystem::path& path) {
  constexpr std::size_t kReadVersionAt = 19;  // SQLite file format, section 1.3: 2 is write-ahead logging.
  const std::string head = first_bytes(path, kReadVersionAt + 1);
  return head.size() > kReadVersionAt && head[kReadVersionAt] == 2;
}

namespace {

/// Largest text or blob of a run file, in bytes. The largest that abcal writes is a bench file.
constexpr int kLargestValue = 64 << 20;

/// Name and text of each table, view, index and trigger that was made by words of its own.
std::map<std::string, std::string> schema_of(SqliteDatabase& database) {
  std::map<std::string, std::string> schema;
  SqliteStatement rows =
      database.prepare("select type || ' \"' || name || '\"', sql from sqlite_master where sql is not null");
  while (rows.step()) schema.emplace(rows.text(0), rows.text(1));
  return schema;
}

/// The schema of a version.
struct KnownSchema {
  std::map<std::string, std::string> required, allowed;
};

KnownSchema make_known_schema(std::int64_t version) {
  SqliteDatabase model(":memory:", SqliteDatabase::Mode::kCreate);
  if (version >= 3) {
    create_run_schema(model, version);
  } else {
    model.execute(kTablesOfVersion2);
    model.execute(kDwellsOfVersion2);
  }
  KnownSchema known{schema_of(model), {}};
  for (const OptionalTable& table : kOptionalTables) create_optional_table(model, table.name);
  known.allowed = schema_of(model);
  return known;
}

/// Made when a file of that version is opened first: to make one takes as long as to analyse a short run.
const KnownSchema& known_schema(std::int64_t version) {
  static std::array<std::once_flag, kRunFileVersion + 1> made;
  static std::array<KnownSchema, kRunFileVersion + 1> of_versions;
  const auto k = static_cast<std::size_t>(version);
  std::call_once(made.at(k), [&] { of_versions.at(k) = make_known_schema(version); });
  return of_versions.at(k);
}

/// The list gives what is allowed, by its whole text: a view can be endless or show other readings, a trigger
/// can make unwanted changes, and no link covers a table or column that this program does not know.
void require_known_schema(const std::filesystem::path& path, SqliteDatabase& database) {
  const KnownSchema& known = known_schema(run_file_version(database));
  const std::map<std::string, std::string> found = schema_of(database);
  const auto refuse = [&](const char* has, const std::string& what, const char* why) {
    throw RunFileError(fmt::format("{}: {} the {}, {}: another program has changed it, and it is not read",
                                   path.string(), has, what, why));
  };
  for (const auto& [what, sql] : found) {
    const auto like = known.allowed.find(what);
    if (like == known.allowed.end()) refuse("has", what, "which no run file has");
    if (like->second != sql) refuse("has", what, "which is not that of a run file");
  }
  for (const auto& [what, sql] : known.required)
    if (!found.contains(what)) refuse("lacks", what, "which every run file of its version has");
}

/// SQLite reads a log that lies beside a file, also if the file has none, and would show what is in the log.
void require_no_foreign_log(const std::filesystem::path& path) {
  const std::filesystem::path log = path.string() + "-wal";
  const auto has_log = [&] {
    std::error_code error;
    const auto size = std::filesystem::file_size(log, error);
    return !error && size > 0;
  };
  // A log is made after the file says that it has one, and removed before it says that it has none.
  if (!has_log() || uses_write_ahead_log(path) || !has_log()) return;
  throw RunFileError(
      fmt::format("{}: is not of {}, which is a single file and has no log: another program has put it "
                  "there, and the run is not read with it; required: no such file",
                  log.string(), path.string()));
}

}  // namespace

SqliteDatabase open_run_file_unchecked(const std::filesystem::path& path, SqliteDatabase::Mode mode) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) throw RunFileError(path.string() + ": no such file");
  if (!std::filesystem::is_regular_file(path, error)) throw RunFileError(path.string() + ": not a file");
  if (::access(path.c_str(), R_OK) != 0) throw RunFileError(path.string() + ": cannot be read by this user");
  if (std::filesystem::file_size(path, error) == 0)
    throw RunFileError(path.string() + ": is empty, not a run file");
  if (!begins_as_sqlite(path)) {
    throw RunFileError(path.string() + ": is not a run file (it does not begin like an SQLite file)");
  }
  recover(path);
  require_no_foreign_log(path);
  SqliteDatabase database(path, mode);
  database.limit_values(kLargestValue);
  const std::string application = database.value("pragma application_id").value_or("");
  if (application != std::to_string(kRunFileApplicationId)) {
    throw RunFileError(path.string() + ": is an SQLite file of another program (application id " +
                       application + ", a run file has " + std::to_string(kRunFileApplicationId) + ")");
  }
  if (const std::int64_t version = run_file_version(database); version > kRunFileVersion) {
    throw RunFileError(fmt::format(
        "{}: was written by a newer abcal (run file version {}, this program reads up to {}); update abcal",
        path.string(), version, kRunFileVersion));
  }
  require_known_schema(path, database);
  return database;
}

namespace {

/// Whether SQLite's check of a file reports that a page could not be read: "... error code=266".
bool tells_of_disk(const std::string& verdict) {
  constexpr std::string_view kCode = "error code=";
  const std::size_t at = verdict.find(kCode);
  return at != std::string::npos && (std::atoi(verdict.c_str() + at + kCode.size()) & 0xFF) == SQLITE_IOERR;
}

SqliteDatabase open_and_check(const std::filesystem::path& path, SqliteDatabase::Mode mode) {
  SqliteDatabase database = open_run_file_unchecked(path, mode);
  const std::string verdict = database.value("pragma quick_check(1)").value_or("no answer");
  if (verdict == "ok") return database;
  if (tells_of_disk(verdict)) throw_sqlite_error(path.string(), SQLITE_IOERR, verdict);
  throw RunFileError(path.string() + ": is damaged or truncated (" + verdict + "); restore it from a copy");
}

}  // namespace

SqliteDatabase open_run_file(const std::filesystem::path& path, SqliteDatabase::Mode mode) {
  return read_twice_if_disk_fails([&] { return open_and_check(path, mode); });
}

std::optional<std::string> state_of_run_file(const std::filesystem::path& path) {
  return read_twice_if_disk_fails([&] {
    return open_run_file_unchecked(path, SqliteDatabase::Mode::kReadOnly)
        .value("select value from meta where key='state'");
  });
}

void upgrade_run_schema(SqliteDatabase& database, const std::filesystem::path& path) {
  const std::int64_t version = run_file_version(database);
  if (version >= 5) return;
  if (version < 2) {
    throw RunFileError(
        fmt::format("{}: was begun with run file version {}; this program can resume versions 2 to {}: "
                    "finish it with the version of abcal that began it",
                    path.string(), version, kRunFileVersion));
  }
  Transaction transaction(database);
  if (version < 3) {
    upgrade_run_schema_2_to_5(database);
  } else {
    if (version < 4) upgrade_run_schema_3_to_4(database);
    upgrade_run_schema_4_to_5(database);
  }
  transaction.commit();
}

void upgrade_run_schema_2_to_5(SqliteDatabase& database) {
  database.execute("alter table dwell rename to dwell_2; alter table reading rename to reading_2;");
  database.execute(kTablesOfVersion3);
  database.execute(kTablesOfVersion4);
  database.execute(kChangesOfVersion5);
  mark_version(database, 5);
  database.execute("insert or replace into meta(key, value) values('schema', 'abcal.run/3')");
  database
      .prepare(
          "insert into item(k, maker, model, serial_number, response_unit) values(1, :maker, :model, "
          ":serial_number, :response_unit)")
      .set("maker", meta_value(database, "label.item.maker"))
      .set("model", meta_value(database, "label.item.model"))
      .set("serial_number", meta_value(database, "label.item.serial_number"))
      .set("response_unit", meta_value(database, "response_unit"))
      .run();
  database
      .prepare(
          "insert into session(id, begun_utc, origin_ns, program_version, end_reason) values(1, :utc, 0, "
          ":version, 'begun with run file version 2: pauses are not in its times')")
      .set("utc", meta_value(database, "created_utc"))
      .set("version", meta_value(database, "program_version"))
      .run();
  // The instants of version 2 count from the start of the run, as those of a first session do.
  DwellWriter writer(database, SessionTimes{1, 0, std::nullopt});
  SqliteStatement ids = database.prepare("select id, position from dwell_2 order by id");
  while (ids.step()) {
    const DwellWithReadings old = read_dwell_of_version_2(database, ids.integer("id"));
    writer.write(ids.integer("position"), old.dwell, old.readings, {.id = ids.integer("id")});
  }
  ids.reset();
  database.execute("drop table reading_2; drop table dwell_2;");
}

void upgrade_run_schema_3_to_4(SqliteDatabase& database) {
  database.execute(kTablesOfVersion4);
  mark_version(database, 4);
}

void upgrade_run_schema_4_to_5(SqliteDatabase& database) {
  database.execute(kChangesOfVersion5);
  mark_version(database, 5);
}

}  // namespace abcal
