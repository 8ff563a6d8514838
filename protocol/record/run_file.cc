#include "protocol/record/run_file.h"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <system_error>
#include <utility>

#include "protocol/record/limits_entries.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr std::int64_t kApplicationId = 0x4142434C;  // "ABCL"
constexpr std::int64_t kSchemaVersion = 2;           // 2: events are chained, and say who
constexpr std::string_view kSqliteMagic{"SQLite format 3\0", 16};

constexpr const char* kSchema = R"(
create table meta(key text primary key, value text not null) without rowid;
create table instrument(role text primary key, maker text, model text, serial_number text, firmware text,
                        details text) without rowid;
create table plan(position integer primary key, experiment integer, n integer, closing integer, alpha_deg real,
                  x_deg real, z_deg real);
create table dwell(id integer primary key, position integer not null references plan, experiment integer, n integer,
                   closing integer, alpha_deg real, commanded_x_deg real, commanded_z_deg real, encoder_x_deg real,
                   encoder_z_deg real, time_s real, settle_s real, count integer, lost integer,
                   r_u real, r_v real, r_w real, spread_u real, spread_v real, spread_w real,
                   u_u real, u_v real, u_w real, temperature_degc real, flags integer, flag_words text);
create table reading(dwell integer not null references dwell, k integer not null, sequence integer, time_s real,
                     u real, v real, w real, temperature_degc real, primary key(dwell, k)) without rowid;
create table environment(id integer primary key, utc text, moment text, temperature_degc real,
                         humidity_percent real, pressure_hpa real);
create table event(id integer primary key, utc text, who text, kind text, text text, chain text);
)";

/// Only in a run that was recorded with a transcript.
constexpr const char* kWireSchema =
    "create table wire(id integer primary key, role text, time_ns integer, arrival_ns integer, kind text, "
    "bytes "
    "blob)";
constexpr std::string_view kWireStart = "wire.start_utc_ns";

/// The first dwell of each planned angle: one that is measured again after an interruption is a check, in a
/// row of its own.
constexpr const char* kDwells =
    "select position, experiment, n, closing, alpha_deg, commanded_x_deg, commanded_z_deg, encoder_x_deg,"
    " encoder_z_deg, time_s, settle_s, count, lost, r_u, r_v, r_w, spread_u, spread_v, spread_w, u_u, u_v, "
    "u_w,"
    " temperature_degc, flags from dwell where id in (select min(id) from dwell group by position) order by "
    "id";

std::string number(double value) {
  return fmt::format("{}", value);
}

class WriterLock {
 public:
  explicit WriterLock(const std::filesystem::path& path) : fd_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
    if (fd_ < 0 || ::flock(fd_, LOCK_EX | LOCK_NB) != 0) {
      const int error = errno;
      if (fd_ >= 0) ::close(fd_);
      throw RunFileError(path.string() + (error == EWOULDBLOCK
                                              ? ": another abcal is writing this run; wait for it or stop it"
                                              : ": cannot be locked: " + std::string(std::strerror(error))));
    }
  }
  WriterLock(const WriterLock&) = delete;
  WriterLock& operator=(const WriterLock&) = delete;
  ~WriterLock() { ::close(fd_); }

 private:
  int fd_;
};

[[noreturn]] void refuse_to_overwrite(const std::filesystem::path& path) {
  throw RunFileError(path.string() +
                     ": exists already; a run is never overwritten: choose another name with -o");
}

/// A program that was killed may leave a change half made, which a read-only connection cannot take back.
void recover(const std::filesystem::path& path) {
  std::error_code ignored;
  if (!std::filesystem::exists(path.string() + "-journal", ignored)) return;
  SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).value("pragma schema_version");
}

/// Opens a run file and refuses what is not one.
SqliteDatabase open_checked(const std::filesystem::path& path, SqliteDatabase::Mode mode) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) throw RunFileError(path.string() + ": no such file");
  if (!std::filesystem::is_regular_file(path, error)) throw RunFileError(path.string() + ": not a file");
  if (::access(path.c_str(), R_OK) != 0) throw RunFileError(path.string() + ": cannot be read by this user");
  if (std::filesystem::file_size(path, error) == 0)
    throw RunFileError(path.string() + ": is empty, not a run file");
  if (!RunFile::looks_like_run_file(path)) {
    throw RunFileError(path.string() + ": is not a run file (it does not begin as an SQLite file does)");
  }
  recover(path);
  SqliteDatabase database(path, mode);
  const std::string application = database.value("pragma application_id").value_or("");
  if (application != std::to_string(kApplicationId)) {
    throw RunFileError(path.string() + ": is an SQLite file of another program (application id " +
                       application + ", a run file has " + std::to_string(kApplicationId) + ")");
  }
  const std::string version = database.value("pragma user_version").value_or("0");
  if (std::stoll(version) > kSchemaVersion) {
    throw RunFileError(path.string() + ": was written by a newer abcal (run file version " + version +
                       ", this program reads up to " + std::to_string(kSchemaVersion) + "); update abcal");
  }
  if (const auto verdict = database.value("pragma quick_check(1)"); verdict != "ok") {
    throw RunFileError(path.string() + ": is damaged or cut short (" + verdict.value_or("no answer") +
                       "); restore it from a copy");
  }
  return database;
}

void set_meta(SqliteDatabase& database, std::string_view key, std::string_view value) {
  database.prepare("insert or replace into meta values(?,?)").bind(1, key).bind(2, value).run();
}

void set_timing(SqliteDatabase& database, const RunTiming& timing) {
  set_meta(database, "timing.moving_s", number(timing.moving_s));
  set_meta(database, "timing.settling_s", number(timing.settling_s));
  set_meta(database, "timing.dwelling_s", number(timing.dwelling_s));
  set_meta(database, "timing.overhead_s", number(timing.overhead_s));
}

/// A transaction that is rolled back unless it is committed.
class Transaction {
 public:
  explicit Transaction(SqliteDatabase& database) : database_(database) {
    database_.execute("begin immediate");
  }
  Transaction(const Transaction&) = delete;
  Transaction& operator=(const Transaction&) = delete;
  ~Transaction() {
    if (committed_) return;
    try {
      database_.execute("rollback");
    } catch (const RunFileError&) {
      // SQLite has rolled back by itself already (a full disk does that); the first error is the one to
      // report.
    }
  }
  void commit() {
    database_.execute("commit");
    committed_ = true;
  }

 private:
  SqliteDatabase& database_;
  bool committed_ = false;
};

/// All that a run file holds before the first angle, in one transaction.
void write_header(SqliteDatabase& database, const RunHeader& header) {
  Transaction transaction(database);
  database.execute(
      fmt::format("pragma application_id={}; pragma user_version={};", kApplicationId, kSchemaVersion));
  database.execute(kSchema);
  const std::map<std::string, std::string> meta{
      {"schema", "abcal.run/1"},
      {"state", std::string(to_string(RunState::kRunning))},
      {"program_version", header.program_version},
      {"created_utc", header.created_utc},
      {"bench_toml", header.bench_toml},
      {"response_unit", header.response_unit},
      {"g_loc.value_mps2", number(header.g_loc.value_mps2)},
      {"g_loc.expanded_uncertainty_mps2", number(header.g_loc.expanded_uncertainty_mps2)},
      {"g_loc.coverage_factor", number(header.g_loc.coverage_factor)},
      {"g_loc.source", header.g_loc.source},
      {"tolerances.alignment_deg", number(header.tolerances.alignment.deg())},
      {"tolerances.step_deg", number(header.tolerances.step.deg())},
      {"tolerances.initial_turn_deg", number(header.tolerances.initial_turn.deg())},
      {"tolerances.zero_deg", number(header.tolerances.zero.deg())},
      {"tolerances.drift", number(header.tolerances.drift)},
      {"protocol.step_deg", number(header.step.deg())},
      {"protocol.steps", std::to_string(header.steps)},
  };
  for (const auto& [key, value] : meta) set_meta(database, key, value);
  // The five "tolerances" above stay, so that older programs open the file; these are what is read.
  for (const auto& [key, value] : effect_size_entries(header.tolerances)) set_meta(database, key, value);
  const auto alignment = [&](const std::string& name, const std::optional<MeasuredValue>& measured) {
    if (!measured) return;
    set_meta(database, "alignment." + name, number(measured->value));
    set_meta(database, "alignment.u_" + name, number(measured->standard_uncertainty));
  };
  alignment("zx", header.measured_alignment.zx);
  alignment("zy", header.measured_alignment.zy);
  alignment("xz", header.measured_alignment.xz);
  for (const auto& [key, value] : limits_entries(header.limits, header.expected))
    set_meta(database, key, value);
  for (const auto& [key, value] : header.labels) set_meta(database, "label." + key, value);
  set_timing(database, {});
  SqliteStatement instrument = database.prepare("insert into instrument values(?,?,?,?,?,?)");
  for (const InstrumentIdentity& identity : header.instruments) {
    instrument.bind(1, std::string_view(identity.role))
        .bind(2, std::string_view(identity.maker))
        .bind(3, std::string_view(identity.model))
        .bind(4, std::string_view(identity.serial_number))
        .bind(5, std::string_view(identity.firmware))
        .bind(6, std::string_view(identity.details))
        .run();
  }
  SqliteStatement plan = database.prepare("insert into plan values(?,?,?,?,?,?,?)");
  for (std::size_t position = 0; position < header.plan.size(); ++position) {
    const PlannedAngle& angle = header.plan[position];
    plan.bind(1, static_cast<std::int64_t>(position))
        .bind(2, std::int64_t{angle.experiment})
        .bind(3, std::int64_t{angle.n})
        .bind(4, std::int64_t{angle.closing})
        .bind(5, angle.alpha.deg())
        .bind(6, angle.x.deg())
        .bind(7, angle.z.deg())
        .run();
  }
  transaction.commit();
}

/// Gives a file its name, which must be free: two programs that are started at once cannot both have it.
void name_file(const std::filesystem::path& draft, const std::filesystem::path& path) {
  if (::renameat2(AT_FDCWD, draft.c_str(), AT_FDCWD, path.c_str(), RENAME_NOREPLACE) == 0) return;
  int error = errno;
  if (error == EINVAL) {  // This file system cannot.
    if (std::filesystem::exists(path)) {
      error = EEXIST;
    } else if (::rename(draft.c_str(), path.c_str()) == 0) {
      return;
    } else {
      error = errno;
    }
  }
  if (error == EEXIST) refuse_to_overwrite(path);
  throw RunFileError(path.string() + ": cannot be created: " + std::strerror(error));
}

RunState state_from(const std::string& word) {
  for (const RunState state :
       {RunState::kRunning, RunState::kInterrupted, RunState::kComplete, RunState::kAbandoned}) {
    if (word == to_string(state)) return state;
  }
  throw RunFileError("a run in the state \"" + word + "\", which this program does not know");
}

}  // namespace

std::string format_utc(Clock::UtcTime time) {
  const auto milliseconds = std::chrono::floor<std::chrono::milliseconds>(time);
  const auto seconds = std::chrono::floor<std::chrono::seconds>(milliseconds);
  return fmt::format("{:%FT%T}.{:03d}Z", fmt::gmtime(std::chrono::system_clock::to_time_t(seconds)),
                     (milliseconds - seconds).count());
}

std::string_view to_string(RunState state) {
  switch (state) {
    case RunState::kRunning:
      return "running";
    case RunState::kInterrupted:
      return "interrupted";
    case RunState::kComplete:
      return "complete";
    case RunState::kAbandoned:
      return "abandoned";
  }
  return "unknown";
}

struct RunFile::Impl {
  Impl(std::filesystem::path file, SqliteDatabase opened)
      : path(std::move(file)), lock(path), database(std::move(opened)) {
    // Commits reach the disk before they return: an angle that is in the file survives a power cut.
    database.execute("pragma journal_mode=wal; pragma synchronous=full");
  }

  void set_meta(std::string_view key, std::string_view value) { abcal::set_meta(database, key, value); }
  void set_timing(const RunTiming& timing) { abcal::set_timing(database, timing); }

  /// Inside a transaction: writes what has come to the transcript. It is kept until wire_is_stored(), should
  /// the transaction fail.
  void append_wire() {
    if (!take_wire) return;
    for (WireRow& row : take_wire()) wire_waiting.push_back(std::move(row));
    if (wire_waiting.empty()) return;
    SqliteStatement statement = database.prepare("insert into wire values(null,?,?,?,?,?)");
    for (const WireRow& row : wire_waiting) {
      statement.bind(1, std::string_view(row.role))
          .bind(2, row.time_ns)
          .bind(3, row.arrival_ns)
          .bind(4, std::string_view(&row.kind, 1))
          .bind_blob(5, row.bytes)
          .run();
    }
  }
  /// After the commit.
  void wire_is_stored() { wire_waiting.clear(); }

  std::function<std::vector<WireRow>()> take_wire;
  std::vector<WireRow> wire_waiting;
  std::filesystem::path path;
  WriterLock lock;  // Outlives the database: closing any descriptor of the file drops SQLite's own locks.
  SqliteDatabase database;
};

RunFile::RunFile(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RunFile::RunFile(RunFile&&) noexcept = default;
RunFile& RunFile::operator=(RunFile&&) noexcept = default;
RunFile::~RunFile() = default;

const std::filesystem::path& RunFile::path() const {
  return impl_->path;
}

bool RunFile::looks_like_run_file(const std::filesystem::path& path) {
  std::array<char, kSqliteMagic.size()> head{};
  std::ifstream file(path, std::ios::binary);
  file.read(head.data(), static_cast<std::streamsize>(head.size()));
  return std::string_view(head.data(), static_cast<std::size_t>(file.gcount())) == kSqliteMagic;
}

RunFile RunFile::create(const std::filesystem::path& path, const RunHeader& header) {
  std::error_code ignored;
  if (std::filesystem::exists(path, ignored)) refuse_to_overwrite(path);
  // It gets its name when all of its head is in it: a program that is killed meanwhile leaves no run that
  // cannot be read.
  const std::filesystem::path draft = fmt::format("{}.new-{}", path.string(), ::getpid());
  const auto remove_draft = [&] {
    for (const char* suffix : {"", "-wal", "-shm", "-journal"})
      std::filesystem::remove(draft.string() + suffix, ignored);
  };
  remove_draft();
  try {
    {
      // Without a write-ahead log: what a failing disk left there would not go along with the name.
      SqliteDatabase database(draft, SqliteDatabase::Mode::kCreate);
      database.execute("pragma synchronous=full");
      write_header(database, header);
    }
    name_file(draft, path);
  } catch (...) {
    remove_draft();  // It holds no measurement.
    throw;
  }
  return RunFile(std::make_unique<Impl>(path, SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)));
}

RunFile RunFile::open_for_append(const std::filesystem::path& path) {
  {
    // Looked at without writing: even opening a closed run to write would change its bytes.
    SqliteDatabase database = open_checked(path, SqliteDatabase::Mode::kReadOnly);
    const RunState state =
        state_from(database.value("select value from meta where key='state'").value_or(""));
    if (state == RunState::kComplete || state == RunState::kAbandoned) {
      throw RunFileError(path.string() + ": this run is " + std::string(to_string(state)) +
                         "; a closed run cannot be resumed or changed");
    }
    if (const auto version = database.value("pragma user_version");
        version != std::to_string(kSchemaVersion)) {
      throw RunFileError(path.string() + ": was begun with run file version " + version.value_or("0") +
                         ", this program goes on with version " + std::to_string(kSchemaVersion) +
                         " only: finish it with the abcal that began it");
    }
  }
  return RunFile(std::make_unique<Impl>(path, SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)));
}

void RunFile::keep_transcript(Clock::UtcTime start, std::function<std::vector<WireRow>()> take) {
  Transaction transaction(impl_->database);
  impl_->database.execute(kWireSchema);
  impl_->set_meta(kWireStart, std::to_string(start.time_since_epoch().count()));
  impl_->take_wire = std::move(take);
  impl_->append_wire();
  transaction.commit();
  impl_->wire_is_stored();
}

void RunFile::append_dwell(std::size_t plan_position, const DwellRecord& dwell,
                           std::span<const StoredReading> readings, const RunTiming& timing) {
  SqliteDatabase& database = impl_->database;
  Transaction transaction(database);
  const auto angle = [](const std::optional<Angle>& a) { return a ? std::optional(a->deg()) : std::nullopt; };
  SqliteStatement row =
      database.prepare("insert into dwell values(null,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)");
  int column = 0;
  const auto next = [&](const auto& value) { row.bind(++column, value); };
  next(static_cast<std::int64_t>(plan_position));
  next(std::int64_t{dwell.experiment});
  next(std::int64_t{dwell.n});
  next(std::int64_t{dwell.closing});
  next(dwell.alpha.deg());
  next(dwell.commanded_x.deg());
  next(dwell.commanded_z.deg());
  next(angle(dwell.encoder_x));
  next(angle(dwell.encoder_z));
  next(dwell.time_s);
  next(dwell.settle_time_s);
  next(dwell.count);
  next(dwell.lost);
  for (const double value : dwell.mean) next(value);
  for (const double value : dwell.spread) next(value);
  for (int j = 0; j < 3; ++j) next(dwell.u_mean ? std::optional((*dwell.u_mean)[j]) : std::nullopt);
  next(dwell.temperature_degc);
  next(std::int64_t{dwell.flags});
  next(std::string_view(describe_flags(dwell.flags)));
  row.run();
  const std::int64_t id = database.last_row_id();
  SqliteStatement reading_row = database.prepare("insert into reading values(?,?,?,?,?,?,?,?)");
  for (std::size_t k = 0; k < readings.size(); ++k) {
    const StoredReading& reading = readings[k];
    reading_row.bind(1, id)
        .bind(2, static_cast<std::int64_t>(k))
        .bind(3, static_cast<std::int64_t>(reading.sequence))
        .bind(4, reading.time_s)
        .bind(5, reading.output[0])
        .bind(6, reading.output[1])
        .bind(7, reading.output[2])
        .bind(8, reading.temperature_degc)
        .run();
  }
  impl_->set_timing(timing);
  impl_->append_wire();
  transaction.commit();
  impl_->wire_is_stored();
}

void RunFile::append_event(const std::string& utc, std::string_view kind, std::string_view text) {
  SqliteDatabase& database = impl_->database;
  const std::string who =
      database.value("select value from meta where key = 'label.operator.name'").value_or("abcal");
  const std::string before = database.value("select chain from event order by id desc limit 1").value_or("");
  const std::string link = next_link(before, {utc, who, std::string(kind), std::string(text)});
  database.prepare("insert into event values(null,?,?,?,?,?)")
      .bind(1, std::string_view(utc))
      .bind(2, std::string_view(who))
      .bind(3, kind)
      .bind(4, text)
      .bind(5, std::string_view(link))
      .run();
}

void RunFile::append_environment(const std::string& utc, std::string_view when,
                                 std::optional<double> temperature_degc,
                                 std::optional<double> humidity_percent, std::optional<double> pressure_hpa) {
  impl_->database.prepare("insert into environment values(null,?,?,?,?,?)")
      .bind(1, std::string_view(utc))
      .bind(2, when)
      .bind(3, temperature_degc)
      .bind(4, humidity_percent)
      .bind(5, pressure_hpa)
      .run();
}

void RunFile::set_state(RunState state, const std::string& utc, std::string_view why) {
  Transaction transaction(impl_->database);
  impl_->set_meta("state", to_string(state));
  append_event(utc, to_string(state), why);
  impl_->append_wire();
  transaction.commit();
  impl_->wire_is_stored();
}

bool RunFile::wait_for_readers(int failures) {
  sqlite3_sleep(50);
  return failures < 200;
}

std::string RunFile::close_complete(const std::string& utc, const RunTiming& timing,
                                    const TryAgain& try_again) {
  impl_->set_timing(timing);
  set_state(RunState::kComplete, utc, "all angles measured");
  return close(try_again);
}

std::string RunFile::close(const TryAgain& try_again) {
  const std::filesystem::path path = impl_->path;
  // The log is folded into the file, for which SQLite wants it alone, and does not wait by itself.
  for (int failures = 1; !impl_->database.execute_unless_busy("pragma journal_mode=delete"); ++failures) {
    if (try_again(failures)) continue;
    throw RunFileError(path.string() +
                       ": all angles are measured and stored, but another program keeps the file open, so "
                       "that it cannot be closed: end that program, then close and analyse the run with "
                       "`abcal resume`");
  }
  impl_.reset();
  // All is in the file now; but SQLite does not say if it could not remove its log.
  std::error_code ignored;
  std::filesystem::remove(path.string() + "-wal", ignored);
  using std::filesystem::perms;
  std::filesystem::permissions(path, perms::owner_write | perms::group_write | perms::others_write,
                               std::filesystem::perm_options::remove);
  return sha256_of_file(path);
}

std::string RunFile::finish_closing(const std::filesystem::path& path, const TryAgain& try_again) {
  using std::filesystem::perms;
  if ((std::filesystem::status(path).permissions() & perms::owner_write) == perms::none)
    return sha256_of_file(path);
  return RunFile(std::make_unique<Impl>(path, open_checked(path, SqliteDatabase::Mode::kReadWrite)))
      .close(try_again);
}

StoredRun RunFile::load(const std::filesystem::path& path) {
  // A run that is being written, or whose program died, has a -wal beside it, which a read-only connection
  // can use too where its -shm may be written; a closed run is a single file.
  SqliteDatabase database = open_checked(path, SqliteDatabase::Mode::kReadOnly);
  std::map<std::string, std::string> meta;
  SqliteStatement meta_rows = database.prepare("select key, value from meta");
  while (meta_rows.step()) meta[meta_rows.text(0)] = meta_rows.text(1);
  const auto text = [&](const std::string& key) {
    const auto found = meta.find(key);
    if (found == meta.end())
      throw RunFileError(path.string() + ": meta \"" + key + "\" is missing; the file is damaged");
    return found->second;
  };
  const auto real = [&](const std::string& key) {
    const std::string value = text(key);
    try {
      return std::stod(value);
    } catch (const std::exception&) {
      throw RunFileError(path.string() + ": meta \"" + key + "\" is \"" + value + "\", not a number");
    }
  };

  StoredRun run;
  run.state = state_from(text("state"));
  RunHeader& header = run.header;
  header.program_version = text("program_version");
  header.created_utc = text("created_utc");
  header.bench_toml = text("bench_toml");
  header.response_unit = text("response_unit");
  header.g_loc = {real("g_loc.value_mps2"), real("g_loc.expanded_uncertainty_mps2"),
                  real("g_loc.coverage_factor"), text("g_loc.source")};
  const auto optional_real = [&](const std::string& key) {
    return meta.contains(key) ? std::optional(real(key)) : std::nullopt;
  };
  const auto optional_text = [&](const std::string& key) {
    return meta.contains(key) ? std::optional(text(key)) : std::nullopt;
  };
  // Version 2 has the five tolerances only: further effects keep their defaults.
  for (const char* key : {"alignment_deg", "step_deg", "initial_turn_deg", "zero_deg", "drift"})
    static_cast<void>(text(std::string("tolerances.") + key));
  read_effect_sizes([&](const std::string& key, double) { return optional_real(key); }, optional_text,
                    header.tolerances);
  const auto alignment = [&](const std::string& name) -> std::optional<MeasuredValue> {
    if (!meta.contains("alignment." + name)) return std::nullopt;
    return MeasuredValue{real("alignment." + name), real("alignment.u_" + name)};
  };
  header.measured_alignment = {alignment("zx"), alignment("zy"), alignment("xz")};
  read_limits_entries(optional_real, optional_text, header.limits, header.expected);
  header.step = Angle::degrees(real("protocol.step_deg"));
  header.steps = static_cast<int>(real("protocol.steps"));
  run.timing = {real("timing.moving_s"), real("timing.settling_s"), real("timing.dwelling_s"),
                real("timing.overhead_s")};
  constexpr std::string_view kLabel = "label.";
  for (const auto& [key, value] : meta) {
    if (key.starts_with(kLabel)) header.labels[key.substr(kLabel.size())] = value;
  }
  SqliteStatement instruments =
      database.prepare("select role, maker, model, serial_number, firmware, details from instrument");
  while (instruments.step()) {
    header.instruments.push_back({instruments.text(0), instruments.text(1), instruments.text(2),
                                  instruments.text(3), instruments.text(4), instruments.text(5)});
  }
  SqliteStatement plan =
      database.prepare("select experiment, n, closing, alpha_deg, x_deg, z_deg from plan order by position");
  while (plan.step()) {
    header.plan.push_back({static_cast<int>(plan.integer(0)), static_cast<int>(plan.integer(1)),
                           plan.integer(2) != 0, Angle::degrees(plan.real(3)), Angle::degrees(plan.real(4)),
                           Angle::degrees(plan.real(5))});
  }

  RunRecord& record = run.record;
  record.source = path.string();
  record.response_unit = header.response_unit;
  record.g_loc = header.g_loc;
  record.g_loc_known = true;
  record.tolerances = header.tolerances;
  record.limits = header.limits;
  record.expected = header.expected;
  record.measured_alignment = header.measured_alignment;
  record.step = header.step;
  record.steps = header.steps;
  const auto angle = [](const std::optional<double>& degrees) {
    return degrees ? std::optional(Angle::degrees(*degrees)) : std::nullopt;
  };
  const auto or_nan = [](const std::optional<double>& value) {
    return value.value_or(std::numeric_limits<double>::quiet_NaN());
  };
  SqliteStatement dwells = database.prepare(kDwells);
  while (dwells.step()) {
    run.measured.push_back(static_cast<std::size_t>(dwells.integer(0)));
    DwellRecord dwell;
    dwell.experiment = static_cast<int>(dwells.integer(1));
    dwell.n = static_cast<int>(dwells.integer(2));
    dwell.closing = dwells.integer(3) != 0;
    dwell.alpha = Angle::degrees(dwells.real(4));
    dwell.commanded_x = Angle::degrees(dwells.real(5));
    dwell.commanded_z = Angle::degrees(dwells.real(6));
    dwell.encoder_x = angle(dwells.optional_real(7));
    dwell.encoder_z = angle(dwells.optional_real(8));
    dwell.time_s = dwells.optional_real(9);
    dwell.settle_time_s = dwells.real(10);
    dwell.count = dwells.integer(11);
    dwell.lost = dwells.integer(12);
    for (int j = 0; j < 3; ++j) {
      dwell.mean[j] = or_nan(dwells.optional_real(13 + j));
      dwell.spread[j] = or_nan(dwells.optional_real(16 + j));
    }
    if (dwells.optional_real(19)) {
      dwell.u_mean = Eigen::Vector3d(dwells.real(19), or_nan(dwells.optional_real(20)),
                                     or_nan(dwells.optional_real(21)));
    }
    dwell.temperature_degc = dwells.optional_real(22);
    dwell.flags = static_cast<std::uint32_t>(dwells.integer(23));
    record.dwells.push_back(dwell);
  }
  SqliteStatement events = database.prepare("select utc, kind, text from event order by id");
  while (events.step()) {
    run.events.push_back({events.text(0), events.text(1), events.text(2)});
    // set_state() wrote it when the run went on.
    if (run.events.back().kind == to_string(RunState::kRunning)) ++record.continuations;
    if (run.events.back().kind == kReconnectedEvent) ++record.reconnections;
  }
  SqliteStatement environment = database.prepare(
      "select utc, moment, temperature_degc, humidity_percent, pressure_hpa from environment order by id");
  while (environment.step()) {
    run.environment.push_back({environment.text(0), environment.text(1), environment.optional_real(2),
                               environment.optional_real(3), environment.optional_real(4)});
  }
  return run;
}

void RunFile::read_dwells(const std::filesystem::path& path,
                          const std::function<void(const StoredDwell&)>& each) {
  SqliteDatabase database = open_checked(path, SqliteDatabase::Mode::kReadOnly);
  SqliteStatement dwells = database.prepare(
      "select id, position, experiment, n, closing, alpha_deg,"
      " id not in (select min(id) from dwell group by position) from dwell order by id");
  SqliteStatement readings = database.prepare(
      "select sequence, time_s, u, v, w, temperature_degc from reading where dwell = ? order by k");
  while (dwells.step()) {
    StoredDwell dwell;
    dwell.plan_position = static_cast<std::size_t>(dwells.integer(1));
    dwell.experiment = static_cast<int>(dwells.integer(2));
    dwell.n = static_cast<int>(dwells.integer(3));
    dwell.closing = dwells.integer(4) != 0;
    dwell.alpha = Angle::degrees(dwells.real(5));
    dwell.repeat = dwells.integer(6) != 0;
    readings.bind(1, dwells.integer(0));
    while (readings.step()) {
      StoredReading reading;
      reading.sequence = static_cast<std::uint64_t>(readings.integer(0));
      reading.time_s = readings.real(1);
      for (int j = 0; j < 3; ++j) {
        reading.output[j] = readings.optional_real(2 + j).value_or(std::numeric_limits<double>::quiet_NaN());
      }
      reading.temperature_degc = readings.optional_real(5);
      dwell.readings.push_back(reading);
    }
    readings.reset();
    each(dwell);
  }
}

std::optional<WireTranscript> RunFile::load_transcript(const std::filesystem::path& path) {
  SqliteDatabase database = open_checked(path, SqliteDatabase::Mode::kReadOnly);
  if (!database.value("select 1 from sqlite_master where type='table' and name='wire'")) return std::nullopt;
  SqliteStatement start = database.prepare("select cast(value as integer) from meta where key=?");
  start.bind(1, kWireStart);
  if (!start.step()) {
    throw RunFileError(path.string() + ": meta \"" + std::string(kWireStart) +
                       "\" is missing; the file is damaged");
  }
  WireTranscript transcript{Clock::UtcTime(Clock::Duration(start.integer(0))), {}};
  SqliteStatement rows =
      database.prepare("select role, time_ns, arrival_ns, kind, bytes from wire order by id");
  while (rows.step()) {
    const std::string kind = rows.text(3);
    transcript.rows.push_back({rows.text(0), rows.integer(1), rows.optional_integer(2),
                               kind.empty() ? '\0' : kind.front(), rows.blob(4)});
  }
  return transcript;
}

std::filesystem::path ResultsFile::path_beside(const std::filesystem::path& run_path) {
  return run_path.string() + ".results";
}

ResultsFile::ResultsFile(const std::filesystem::path& run_path, const std::string& run_sha256)
    : database_(path_beside(run_path), SqliteDatabase::Mode::kCreate) {
  database_.execute(
      "pragma synchronous=full;"
      "create table if not exists run(sha256 text primary key) without rowid;"
      "create table if not exists analysis(id integer primary key, utc text, program_version text, estimator "
      "text,"
      " result_json text, chain text);"
      "create table if not exists certificate(id integer primary key, utc text, number text unique, "
      "measured_by "
      "text, approved_by text, date text, replaces text, reason text, program_version text, laboratory_toml "
      "text, xml text, chain text)");
  // Results of before analyses were chained: they stay readable, and `verify` says what they lack.
  if (database_.value("select count(*) from pragma_table_info('analysis') where name = 'chain'") == "0")
    database_.execute("alter table analysis add column chain text");
  if (const auto stored = database_.value("select sha256 from run"); stored && *stored != run_sha256) {
    throw RunFileError(path_beside(run_path).string() + ": belongs to a run with SHA-256 " + *stored +
                       ", but " + run_path.string() + " has " + run_sha256 + ": one of the two was changed");
  }
  database_.prepare("insert or ignore into run values(?)").bind(1, std::string_view(run_sha256)).run();
}

std::size_t ResultsFile::analyses() {
  return static_cast<std::size_t>(
      std::stoull(database_.value("select count(*) from analysis").value_or("0")));
}

void ResultsFile::add_analysis(const std::string& utc, std::string_view program_version,
                               std::string_view estimator, std::string_view result_json) {
  SqliteStatement same = database_.prepare(
      "select 1 from analysis where program_version=?1 and estimator=?2 and result_json=?3");
  same.bind(1, program_version).bind(2, estimator).bind(3, result_json);
  if (same.step()) return;
  const std::string before =
      database_.value("select chain from analysis order by id desc limit 1").value_or("");
  const std::string link = next_link(
      before, {utc, std::string(program_version), std::string(estimator), std::string(result_json)});
  database_.prepare("insert into analysis values(null,?,?,?,?,?)")
      .bind(1, std::string_view(utc))
      .bind(2, program_version)
      .bind(3, estimator)
      .bind(4, result_json)
      .bind(5, std::string_view(link))
      .run();
}

namespace {

std::vector<IssuedCertificate> read_certificates(SqliteDatabase& database) {
  std::vector<IssuedCertificate> certificates;
  // Results of before certificates were issued have no such table.
  if (!database.value("select 1 from sqlite_master where type='table' and name='certificate'"))
    return certificates;
  SqliteStatement rows = database.prepare(
      "select utc, number, measured_by, approved_by, date, replaces, reason, program_version, "
      "laboratory_toml, "
      "xml from certificate order by id");
  while (rows.step()) {
    certificates.push_back({rows.text(0), rows.text(1), rows.text(2), rows.text(3), rows.text(4),
                            rows.text(5), rows.text(6), rows.text(7), rows.text(8), rows.text(9)});
  }
  return certificates;
}

/// @throws RunFileError if a certificate cannot be issued beside those that there are
void require_issuable(const IssuedCertificate& certificate, const std::vector<IssuedCertificate>& issued,
                      const std::string& results) {
  bool replaces_one = false;
  for (const IssuedCertificate& one : issued) {
    if (one.number == certificate.number)
      throw RunFileError(results + ": certificate " + one.number + " was issued on " + one.date +
                         "; a number is given once");
    if (!certificate.replaces.empty() && one.replaces == certificate.replaces)
      throw RunFileError(results + ": certificate " + certificate.replaces + " is replaced by " + one.number +
                         " already; replace that one");
    replaces_one = replaces_one || one.number == certificate.replaces;
  }
  if (!issued.empty() && !replaces_one)
    throw RunFileError(results + ": certificate " + issued.back().number +
                       " was issued for this run already; amend it with --replaces " + issued.back().number +
                       " --reason TEXT");
}

}  // namespace

void ResultsFile::add_certificate(const IssuedCertificate& certificate) {
  Transaction transaction(database_);
  const std::string results = database_.value("select file from pragma_database_list").value_or("results");
  require_issuable(certificate, read_certificates(database_), results);
  const std::vector<std::string> fields{certificate.utc,
                                        certificate.number,
                                        certificate.measured_by,
                                        certificate.approved_by,
                                        certificate.date,
                                        certificate.replaces,
                                        certificate.reason,
                                        certificate.program_version,
                                        certificate.laboratory_toml,
                                        certificate.xml};
  const std::string before =
      database_.value("select chain from certificate order by id desc limit 1").value_or("");
  SqliteStatement row = database_.prepare("insert into certificate values(null,?,?,?,?,?,?,?,?,?,?,?)");
  int column = 0;
  for (const std::string& field : fields) row.bind(++column, std::string_view(field));
  row.bind(++column, std::string_view(next_link(before, fields))).run();
  transaction.commit();
}

std::vector<IssuedCertificate> ResultsFile::certificates(const std::filesystem::path& run_path) {
  std::error_code error;
  if (!std::filesystem::exists(path_beside(run_path), error)) return {};
  SqliteDatabase database(path_beside(run_path), SqliteDatabase::Mode::kReadOnly);
  return read_certificates(database);
}

}  // namespace abcal
