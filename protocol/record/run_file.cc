#include "protocol/record/run_file.h"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "protocol/plan/run_config.h"
#include "protocol/record/clock_watch.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/dwell_rows.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_header.h"
#include "protocol/record/run_schema.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr std::string_view kWireStart = "wire.start_utc_ns";
/// Commits reach the disk before they return: an angle that is in the file survives a power cut.
constexpr const char* kWaitForDisk = "pragma synchronous=full";

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
  /// Whether the file has no name any more, in any folder.
  bool is_deleted() const {
    struct stat status {};
    return ::fstat(fd_, &status) == 0 && status.st_nlink == 0;
  }

 private:
  int fd_;
};

/// Space on the disk of a file that nothing uses, so that some is left to write why a run ended when the disk
/// is full. It has no name, and ends with the program; none where the file system has no files without a
/// name.
class ReservedSpace {
 public:
  explicit ReservedSpace(const std::filesystem::path& path) {
    // The reason takes three pages of the log of 4 KiB, and a transcript that waits some more.
    constexpr off_t kBytes = 256 << 10;
    const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
    fd_ = ::open(folder.c_str(), O_TMPFILE | O_WRONLY | O_CLOEXEC, 0600);
    if (fd_ >= 0 && ::fallocate(fd_, 0, 0, kBytes) != 0) release();
  }
  ReservedSpace(const ReservedSpace&) = delete;
  ReservedSpace& operator=(const ReservedSpace&) = delete;
  ~ReservedSpace() { release(); }
  void release() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }

 private:
  int fd_ = -1;
};

[[noreturn]] void refuse_to_overwrite(const std::filesystem::path& path) {
  throw RunFileError(path.string() +
                     ": exists already; a run is never overwritten: choose another name with -o");
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

/// @throws RunFileError for a name that is no file's to SQLite, or that no text can have
void require_name(const std::filesystem::path& path) {
  const std::string name = path.string();
  const auto refuse = [&](const char* why) {
    throw RunFileError(fmt::format("{}: {}; choose another name with -o", name, why));
  };
  if (name == ":memory:") refuse("no file has this name: the run would be lost at the end of the program");
  try {
    (void)nlohmann::json(name).dump();
  } catch (const nlohmann::json::type_error&) {
    refuse("the name is not UTF-8, so that no result or certificate can state it");
  }
}

void make_read_only(const std::filesystem::path& path) {
  using std::filesystem::perms;
  const perms writing = perms::owner_write | perms::group_write | perms::others_write;
  if ((std::filesystem::status(path).permissions() & writing) == perms::none) return;
  std::filesystem::permissions(path, writing, std::filesystem::perm_options::remove);
}

/// The messages of events by their ids. None of a file of an earlier version.
std::map<std::int64_t, Message> read_messages(SqliteDatabase& database) {
  std::map<std::int64_t, Message> messages;
  if (!database.has_table("message")) return messages;
  SqliteStatement rows = database.prepare(
      "select event.id as id, text, message from message join event on event.id = message.event");
  while (rows.step()) {
    const auto json = nlohmann::ordered_json::parse(rows.text("message"), nullptr, false);
    try {
      Message message = message_from_json(json);
      if (message.english() == rows.text("text")) messages.emplace(rows.integer("id"), std::move(message));
    } catch (const nlohmann::json::exception&) {  // the text stays in English
    }
  }
  return messages;
}

/// How far each item of a run was measured.
std::vector<ItemProgress> read_item_states(SqliteDatabase& database, const std::vector<RunItem>& items) {
  std::vector<ItemProgress> states;
  const bool has_items = database.has_table("item");  // Version 2 has none, and one item.
  SqliteStatement measured =
      database.prepare(has_items ? "select count(distinct position) as n from dwell where item = :item"
                                 : "select count(distinct position) as n from dwell");
  for (const RunItem& item : items) {
    if (has_items) measured.set("item", std::int64_t{item.k});
    measured.step();
    states.push_back({item.k, static_cast<std::size_t>(measured.integer("n")), std::nullopt, {}});
    measured.reset();
  }
  if (!database.has_table("item_drop")) return states;
  const std::map<std::int64_t, Message> messages = read_messages(database);
  SqliteStatement drops = database.prepare(
      "select item, position, event.id as event, text from item_drop join event on event.id = "
      "item_drop.event");
  while (drops.step()) {
    const auto dropped = std::ranges::find(states, static_cast<int>(drops.integer("item")), &ItemProgress::k);
    if (dropped == states.end()) continue;
    dropped->dropped_at = static_cast<std::size_t>(drops.integer("position"));
    const auto known = messages.find(drops.integer("event"));
    dropped->reason = known == messages.end() ? Message::bare(drops.text("text")) : known->second;
  }
  return states;
}

/// Where the session before left the clocks.
struct LastSession {
  std::int64_t id = 0;
  SessionTimes times;
  std::string boot_id;
  std::optional<std::int64_t> since_boot_ns;
  std::int64_t end_ns = 0;  ///< True time up to which the run is known to have lasted.
};

std::optional<LastSession> last_session(SqliteDatabase& database) {
  SqliteStatement row = database.prepare(
      "select *, (select max(time_ns) from dwell where dwell.session = session.id) as last_dwell_ns, (select "
      "sum(value) from meta where key like 'timing.%') as spent_s from session order by id desc limit 1");
  if (!row.step()) return std::nullopt;
  LastSession last;
  last.id = row.integer("id");
  last.times = {last.id, row.integer("origin_ns"), std::nullopt};
  if (const auto begun = row.optional_integer("begun_utc_ns"))
    last.times.begun = Clock::UtcTime(Clock::Duration(*begun));
  last.boot_id = row.text("boot_id");
  last.since_boot_ns = row.optional_integer("since_boot_ns");
  last.end_ns = std::max(last.times.origin_ns + row.optional_integer("last_dwell_ns").value_or(0),
                         std::int64_t{from_seconds(row.real("spent_s")).count()});
  return last;
}

/// Time between two sessions, as begin_session() determines it.
struct Continuation {
  SessionTimes times;
  std::optional<Clock::Duration> step;  ///< Step of the system clock in between.
};

/// @param utc the UTC of the beginning by the system clock
Continuation continue_after(const LastSession& last, const SessionStart& start) {
  const auto& before = last.times;
  const bool same_boot = !last.boot_id.empty() && last.boot_id == start.host.boot_id;
  std::optional<std::int64_t> origin_ns;
  Continuation next{{last.id + 1, last.end_ns, start.utc}, std::nullopt};
  if (same_boot && last.since_boot_ns && start.host.since_boot) {
    const Clock::Duration since_boot(*last.since_boot_ns);
    origin_ns = before.origin_ns + (*start.host.since_boot - since_boot).count();
    if (before.begun && start.utc)
      next.step = clock_step({*before.begun, since_boot}, {*start.utc, *start.host.since_boot});
  } else if (before.begun && start.utc) {
    origin_ns = before.origin_ns + (*start.utc - *before.begun).count();
    // A simulated clock begins where the session before began: this is not a step.
    if (*origin_ns < last.end_ns && !start.host.boot_id.empty())
      next.step = Clock::Duration(*origin_ns - last.end_ns);
  }
  if (origin_ns) next.times.origin_ns = std::max(*origin_ns, last.end_ns);
  // The times of a run never go back, even if the system clock does.
  if (next.times.begun && before.begun) {
    const auto run_begun = *before.begun - Clock::Duration(before.origin_ns);
    next.times.begun = std::max(*next.times.begun, run_begun + Clock::Duration(last.end_ns));
  }
  return next;
}

std::optional<std::int64_t> nanoseconds_of(const std::optional<Clock::Duration>& duration) {
  return duration ? std::optional<std::int64_t>(duration->count()) : std::nullopt;
}

void write_session(SqliteDatabase& database, const SessionTimes& times, const SessionStart& start) {
  const auto utc_ns =
      times.begun ? std::optional<std::int64_t>(times.begun->time_since_epoch().count()) : std::nullopt;
  const auto monotonic_ns = start.monotonic
                                ? std::optional<std::int64_t>(start.monotonic->time_since_epoch().count())
                                : std::nullopt;
  database.insert("session")
      .set("id", times.session)
      .set("begun_utc", times.begun ? format_utc(*times.begun) : std::string())
      .set("begun_utc_ns", utc_ns)
      .set("origin_ns", times.origin_ns)
      .set("monotonic_ns", monotonic_ns)
      .set("boot_id", start.host.boot_id)
      .set("since_boot_ns", nanoseconds_of(start.host.since_boot))
      .set("clock_offset_s", start.host.offset_s)
      .set("clock_error_s", start.host.error_s)
      .set("program_version", start.program_version)
      .run();
}

/// Appends to the event log. Requires a transaction: reading the last link and writing the new row belong
/// together.
/// Writes the message of the event that was written last.
void write_message(SqliteDatabase& database, const Message& message) {
  if (message.id().empty()) return;
  const std::int64_t event = database.last_row_id();
  create_optional_table(database, "message");
  database.insert("message")
      .set("event", event)
      .set("message", message_json(message).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace))
      .run();
}

void write_event(SqliteDatabase& database, const std::string& utc, std::string_view kind,
                 const Message& message) {
  const std::string text = message.english();
  const std::string who =
      database.value("select value from meta where key = 'label.operator.name'").value_or("abcal");
  const std::string before = database.value("select chain from event order by id desc limit 1").value_or("");
  database.insert("event")
      .set("utc", utc)
      .set("who", who)
      .set("kind", kind)
      .set("text", text)
      .set("chain", next_link(before, {utc, who, std::string(kind), text}))
      .run();
  write_message(database, message);
}

}  // namespace

std::string format_utc(Clock::UtcTime time) {
  const auto milliseconds = std::chrono::floor<std::chrono::milliseconds>(time);
  const auto seconds = std::chrono::floor<std::chrono::seconds>(milliseconds);
  return fmt::format("{:%FT%T}.{:03d}Z", fmt::gmtime(std::chrono::system_clock::to_time_t(seconds)),
                     (milliseconds - seconds).count());
}

namespace {

/// Lets commits return before they reach the disk, while it lives: a power cut may take back the last of
/// them, and leaves the file sound. docs/decisions/0050.
class WithoutWaitingForDisk {
 public:
  explicit WithoutWaitingForDisk(SqliteDatabase& database) : database_(database) {
    database_.execute("pragma synchronous=normal");
  }
  WithoutWaitingForDisk(const WithoutWaitingForDisk&) = delete;
  WithoutWaitingForDisk& operator=(const WithoutWaitingForDisk&) = delete;
  ~WithoutWaitingForDisk() {
    try {
      database_.execute(kWaitForDisk);
    } catch (const RunFileError&) {
      // Only without memory: the next statement fails as well, and reports it.
    }
  }

 private:
  SqliteDatabase& database_;
};

}  // namespace

struct RunFile::Impl {
  Impl(std::filesystem::path file, SqliteDatabase opened)
      : path(std::move(file)), reserved(path), database(std::move(opened)) {
    lock.emplace(path);
    use_log();
  }

  void use_log() {
    database.use_write_ahead_log();
    database.execute(kWaitForDisk);
  }

  /// Bounds the time whose angles are lost with the log, if somebody removes it: to one minute.
  void merge_log_each_minute(const RunTiming& timing) {
    constexpr double kMinute = 60.0;
    if (repeatable || timing.total_s() < merged_at_s + kMinute) return;
    database.execute("pragma wal_checkpoint(passive)");
    merged_at_s = timing.total_s();
  }

  /// The file was deleted, and lives as long as this program: its contents become a new file of its name.
  void write_again() {
    const std::filesystem::path draft = fmt::format("{}.again-{}", path.string(), ::getpid());
    std::error_code ignored;
    std::filesystem::remove(draft, ignored);
    database.prepare("vacuum into :draft").set("draft", draft.string()).run();
    // The log of the old file, which has the name that the log of the new one will have, goes with it.
    database = SqliteDatabase(draft, SqliteDatabase::Mode::kReadWrite);
    for (const char* suffix : {"-wal", "-shm"}) std::filesystem::remove(path.string() + suffix, ignored);
    name_file(draft, path);
    database = SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite);
    lock.emplace(path);
    use_log();
  }

  /// Commits an angle: the rows that `write` writes, the time spent, and new lines of the transcript.
  void append_angle(const RunTiming& timing, const std::function<void(DwellWriter&)>& write) {
    const SessionTimes& times = session_times();
    std::optional<WithoutWaitingForDisk> without_waiting;
    if (repeatable) without_waiting.emplace(database);
    Transaction transaction(database);
    DwellWriter writer(database, times);
    const std::int64_t last =
        std::stoll(database.value("select coalesce(max(id), 0) from dwell").value_or("0"));
    write(writer);
    if (stored_together(database, last).size() > (last > 0 ? 2U : 1U))
      throw std::logic_error("RunFile: the dwells of one angle, or of one sweep, are stored together");
    set_timing(database, timing);
    append_waiting();
    transaction.commit();
    waiting_is_stored();
    merge_log_each_minute(timing);
    if (ask_witness) {
      const std::string before = std::exchange(last_link, read_last_link());
      ask_witness(before, last_link);
    }
  }

  std::string read_last_link() {
    const auto link = database.value("select chain from dwell order by id desc limit 1");
    return link ? *link : head_link(database);
  }

  /// The session under way; one without any clock where none was begun.
  const SessionTimes& session_times() {
    if (session) return *session;
    const auto last = last_session(database);
    session = last ? continue_after(*last, {}).times : SessionTimes{};
    write_session(database, *session, {});
    return *session;
  }

  void write_state(RunState state, const std::string& utc, const Message& why) {
    set_meta(database, "state", to_string(state));
    write_event(database, utc, to_string(state), why);
    if (session && state != RunState::kRunning) {
      database.prepare("update session set ended_utc = :utc, end_reason = :why where id = :id")
          .set("utc", utc)
          .set("why", why.english())
          .set("id", session->session)
          .run();
    }
    append_waiting();
  }

  /// Inside a transaction: writes new lines of the transcript, and new statements of the witness. They are
  /// kept until waiting_is_stored(), in case the transaction fails.
  void append_waiting() {
    append_wire();
    if (!take_witnessed) return;
    for (WitnessedLine& row : take_witnessed()) witnessed_waiting.push_back(std::move(row));
    for (const WitnessedLine& row : witnessed_waiting) write_witnessed(row);
  }
  void write_witnessed(const WitnessedLine& row) {
    database.prepare("insert into witness(line, signature) values(?, ?)")
        .bind(1, std::string_view(row.line))
        .bind_blob(2, row.signature)
        .run();
  }
  void append_wire() {
    if (!take_wire) return;
    for (WireRow& row : take_wire()) wire_waiting.push_back(std::move(row));
    if (wire_waiting.empty()) return;
    SqliteStatement statement =
        database.prepare("insert into wire(role, time_ns, arrival_ns, kind, bytes) values(?, ?, ?, ?, ?)");
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
  void waiting_is_stored() {
    wire_waiting.clear();
    witnessed_waiting.clear();
  }

  std::function<std::vector<WireRow>()> take_wire;
  std::vector<WireRow> wire_waiting;
  std::function<void(const std::string& before, const std::string& link)> ask_witness;
  std::function<std::vector<WitnessedLine>()> take_witnessed;
  std::vector<WitnessedLine> witnessed_waiting;
  std::string last_link;  ///< Known while there is a witness.
  std::filesystem::path path;
  bool repeatable = false;                        ///< As in SessionStart.
  std::optional<SessionTimes> session;            ///< The present session.
  std::optional<Clock::Instant> session_instant;  ///< Its beginning.
  double merged_at_s = 0.0;                       ///< RunTiming::total_s() at which the log was merged.
  ReservedSpace reserved;
  /// Outlives the database: closing any descriptor of the file drops SQLite's own locks.
  std::optional<WriterLock> lock;
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
  return begins_as_sqlite(path) && !is_ros2_bag(path);
}

RunFile RunFile::create(const std::filesystem::path& path, const RunHeader& header) {
  require_name(path);
  std::error_code ignored;
  if (std::filesystem::exists(path, ignored)) refuse_to_overwrite(path);
  // SQLite would take it for that of the new file.
  const std::filesystem::path log = path.string() + "-wal";
  if (std::error_code absent; std::filesystem::file_size(log, absent) > 0 && !absent)
    throw RunFileError(
        log.string() +
        ": is the log of a run whose own file is gone; choose another name with -o, or move the log "
        "away if nobody needs that run");
  ResultsFile::require_none(path);
  // The file gets its name when its head is complete: a program that is killed before leaves no run that
  // cannot be read.
  const std::filesystem::path draft = fmt::format("{}.new-{}", path.string(), ::getpid());
  const auto remove_draft = [&] {
    for (const char* suffix : {"", "-wal", "-shm", "-journal"})
      std::filesystem::remove(draft.string() + suffix, ignored);
  };
  remove_draft();
  try {
    {
      // No write-ahead log is used, because the rename would not include data that a failing disk left in it.
      SqliteDatabase database(draft, SqliteDatabase::Mode::kCreate);
      database.execute(kWaitForDisk);
      Transaction transaction(database);
      create_run_schema(database);
      write_run_header(database, header);
      transaction.commit();
    }
    name_file(draft, path);
  } catch (...) {
    remove_draft();  // It holds no measurement.
    throw;
  }
  return RunFile(std::make_unique<Impl>(path, SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)));
}

std::optional<Message> RunFile::missing_log(const std::filesystem::path& path) {
  const std::filesystem::path log = path.string() + "-wal";
  // Whoever has looked at the file since has left an empty one.
  std::error_code absent;
  const bool has_log = std::filesystem::file_size(log, absent) > 0 && !absent;
  if (has_log || !uses_write_ahead_log(path)) return std::nullopt;
  SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
  if (!database.has_column("session", "ended_utc")) return std::nullopt;
  const auto open = database.value(
      "select count(*) from session where id = (select max(id) from session) and ended_utc is null");
  if (open != "1") return std::nullopt;
  return Message(
      "{file}: its program ended without closing it, and its log {log} is gone, with what was measured last; "
      "if you have it, put it beside the file and resume again",
      path.string(), log.filename().string());
}

RunFile RunFile::open_for_append(const std::filesystem::path& path) {
  {
    // Read only: even opening a closed run for writing would change its bytes.
    SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
    const RunState state =
        run_state_from(database.value("select value from meta where key='state'").value_or(""));
    if (state == RunState::kComplete || state == RunState::kAbandoned) {
      throw RunFileError(path.string() + ": this run is " + std::string(to_string(state)) +
                         "; a closed run cannot be resumed or changed");
    }
  }
  ResultsFile::require_none(path);
  auto impl = std::make_unique<Impl>(path, SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite));
  upgrade_run_schema(impl->database, path);
  return RunFile(std::move(impl));
}

RunFile RunFile::open_to_close(const std::filesystem::path& path) {
  {
    SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
    const auto state = database.value("select value from meta where key='state'");
    if (state != to_string(RunState::kComplete))
      throw RunFileError(fmt::format("{}: this run is {}; required: a run whose angles are all measured",
                                     path.string(), state.value_or("without a state")));
  }
  return RunFile(std::make_unique<Impl>(path, SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)));
}

void RunFile::begin_session(const SessionStart& start) {
  Transaction transaction(impl_->database);
  Continuation next{SessionTimes{1, 0, start.utc}, std::nullopt};
  if (const auto last = last_session(impl_->database)) next = continue_after(*last, start);
  write_session(impl_->database, next.times, start);
  if (next.step && next.times.begun)
    write_event(impl_->database, format_utc(*next.times.begun), kClockStepEvent,
                describe_clock_step(*next.step));
  transaction.commit();
  impl_->session = next.times;
  impl_->repeatable = start.repeatable;
  impl_->session_instant = start.monotonic;
}

bool RunFile::in_session() const {
  return impl_->session_instant.has_value();
}

double RunFile::time_s(Clock::Instant instant) const {
  if (!impl_->session_instant) throw std::logic_error("RunFile::time_s() before begin_session()");
  return to_seconds(Clock::Duration(impl_->session->origin_ns) + (instant - *impl_->session_instant));
}

Clock::UtcTime RunFile::utc(Clock::Instant instant) const {
  if (!impl_->session_instant || !impl_->session->begun)
    throw std::logic_error("RunFile::utc() before begin_session()");
  return *impl_->session->begun + (instant - *impl_->session_instant);
}

Clock::UtcTime RunFile::utc_now(const Clock& clock) const {
  return impl_->session_instant && impl_->session->begun ? utc(clock.now()) : clock.utc_now();
}

void RunFile::keep_transcript(Clock::UtcTime start, std::function<std::vector<WireRow>()> take) {
  Transaction transaction(impl_->database);
  create_optional_table(impl_->database, "wire");
  set_meta(impl_->database, kWireStart, std::to_string(start.time_since_epoch().count()));
  impl_->take_wire = std::move(take);
  impl_->append_waiting();
  transaction.commit();
  impl_->waiting_is_stored();
}

void RunFile::keep_witness(std::function<void(const std::string&, const std::string&)> ask,
                           std::function<std::vector<WitnessedLine>()> take) {
  impl_->ask_witness = std::move(ask);
  impl_->take_witnessed = std::move(take);
  impl_->last_link = impl_->read_last_link();
}

void RunFile::append_witness(const WitnessedLine& row) {
  impl_->write_witnessed(row);
}

std::string RunFile::head() {
  return head_link(impl_->database);
}

std::string RunFile::last_link() {
  return impl_->read_last_link();
}

std::string RunFile::closing() {
  return closing_link(impl_->database);
}

std::vector<WitnessedLine> RunFile::witnessed(const std::filesystem::path& path) {
  SqliteDatabase database = open_run_file_unchecked(path, SqliteDatabase::Mode::kReadOnly);
  std::vector<WitnessedLine> rows;
  if (!database.has_table("witness")) return rows;
  SqliteStatement statement = database.prepare("select line, signature from witness order by id");
  while (statement.step()) rows.push_back({statement.text(0), statement.blob(1)});
  return rows;
}

void RunFile::append_dwell(std::size_t plan_position, const DwellRecord& dwell,
                           std::span<const StoredReading> readings, const RunTiming& timing) {
  impl_->append_angle(timing, [&](DwellWriter& writer) {
    writer.write(static_cast<std::int64_t>(plan_position), dwell, readings, {});
  });
}

void RunFile::append_dwells(std::size_t plan_position, std::span<const ItemDwell> dwells,
                            const RunTiming& timing) {
  impl_->append_angle(timing, [&](DwellWriter& writer) {
    for (const ItemDwell& each : dwells)
      writer.write(static_cast<std::int64_t>(plan_position), each.dwell, each.readings, {.item = each.item});
  });
}

void RunFile::append_sweep(std::span<const PassedAngle> angles, const RunTiming& timing) {
  impl_->append_angle(timing, [&](DwellWriter& writer) {
    for (const PassedAngle& angle : angles) {
      for (const ItemDwell& each : angle.dwells)
        writer.write(static_cast<std::int64_t>(angle.position), each.dwell, each.readings,
                     {.item = each.item, .encoder = each.encoder});
    }
  });
}

void RunFile::drop_item(int item, std::size_t plan_position, const std::string& utc, const Message& why) {
  Transaction transaction(impl_->database);
  create_optional_table(impl_->database, "item_drop");
  write_event(impl_->database, utc, kItemDroppedEvent, why);
  impl_->database.insert("item_drop")
      .set("item", std::int64_t{item})
      .set("position", static_cast<std::int64_t>(plan_position))
      .set("event", impl_->database.last_row_id())
      .run();
  transaction.commit();
}

void RunFile::append_event(const std::string& utc, std::string_view kind, const Message& text) {
  Transaction transaction(impl_->database);
  write_event(impl_->database, utc, kind, text);
  transaction.commit();
}

void RunFile::append_environment(const std::string& utc, std::string_view when,
                                 std::optional<double> temperature_degc,
                                 std::optional<double> humidity_percent, std::optional<double> pressure_hpa) {
  impl_->database.insert("environment")
      .set("utc", utc)
      .set("moment", when)
      .set("temperature_degc", temperature_degc)
      .set("humidity_percent", humidity_percent)
      .set("pressure_hpa", pressure_hpa)
      .run();
}

RunFile::Place RunFile::look_for_file() {
  if (!impl_->database.has_moved()) return Place::kInPlace;
  std::error_code ignored;
  if (std::filesystem::exists(std::filesystem::symlink_status(impl_->path, ignored))) return Place::kReplaced;
  const std::filesystem::path folder = std::filesystem::absolute(impl_->path).parent_path();
  if (impl_->lock->is_deleted() && std::filesystem::is_directory(folder, ignored)) {
    impl_->write_again();
    return Place::kWrittenAgain;
  }
  // So that the file is whole wherever it is now: its log did not go with it.
  impl_->database.execute("pragma wal_checkpoint(passive)");
  return Place::kMoved;
}

void RunFile::set_state(RunState state, const std::string& utc, const Message& why) {
  if (state != RunState::kRunning) impl_->reserved.release();
  Transaction transaction(impl_->database);
  impl_->write_state(state, utc, why);
  transaction.commit();
  impl_->waiting_is_stored();
}

bool RunFile::wait_for_readers(int failures) {
  sqlite3_sleep(50);
  return failures < 200;
}

void RunFile::complete(const std::string& utc, const RunTiming& timing) {
  impl_->reserved.release();
  SqliteDatabase& database = impl_->database;
  Transaction transaction(database);
  set_timing(database, timing);
  impl_->write_state(RunState::kComplete, utc, Message("all angles measured"));
  database
      .prepare(
          "insert into seal(utc, dwells, dwell_chain, event_chain) values(:utc, (select count(*) from "
          "dwell), (select chain from dwell order by id desc limit 1), (select chain from event order by id "
          "desc limit 1))")
      .set("utc", utc)
      .run();
  transaction.commit();
  impl_->waiting_is_stored();
}

std::string RunFile::close_complete(const std::string& utc, const RunTiming& timing,
                                    const TryAgain& try_again) {
  complete(utc, timing);
  const std::filesystem::path path = impl_->path;
  if (auto hash = close(try_again)) return *std::move(hash);
  throw RunFileError(
      path.string() +
      ": all angles are measured and stored, but the file cannot be closed because another program keeps the "
      "file open: end that program, then close and analyse the run with `abcal resume`");
}

std::optional<std::string> RunFile::close(const TryAgain& try_again) {
  const std::filesystem::path path = impl_->path;
  try {
    ResultsFile::begin(path);
  } catch (const RunFileError&) {
    // The run takes precedence. The step that stores the first analysis tries again, and reports the error.
  }
  // The log is merged into the file, for which SQLite needs exclusive access, and does not wait for it.
  for (int failures = 1; !impl_->database.execute_unless_busy("pragma journal_mode=delete"); ++failures) {
    if (!try_again(failures)) return std::nullopt;
  }
  impl_.reset();
  // All is in the file now; but SQLite does not report if it could not remove its log.
  std::error_code ignored;
  std::filesystem::remove(path.string() + "-wal", ignored);
  make_read_only(path);
  return sha256_of_file(path);
}

bool RunFile::is_closed(const std::filesystem::path& path) {
  // Whoever reads the run has all of its pages checked then.
  return !uses_write_ahead_log(path) && state_of_run_file(path) == to_string(RunState::kComplete);
}

std::string RunFile::finish_closing(const std::filesystem::path& path, const TryAgain& try_again) {
  if (is_closed(path)) {
    make_read_only(path);
    return sha256_of_file(path);
  }
  if (auto hash = open_to_close(path).close(try_again)) return *std::move(hash);
  throw RunFileError(path.string() +
                     ": the run is complete, but the file cannot be closed because another program keeps the "
                     "file open: end that program, then close and analyse the run with `abcal resume`");
}

namespace {

StoredRun load_from(SqliteDatabase& database, const std::filesystem::path& path, int item) {
  StoredRun run;
  run.item = item;
  read_run_header(database, path.string(), run);
  run.items = read_item_states(database, run.header.items);
  const RunHeader& header = run.header;
  RunRecord& record = run.record;
  record.source = path.string();
  record.response_unit = header.response_unit;
  record.g_loc = header.g_loc;
  record.g_loc_known = true;
  record.tolerances = header.tolerances;
  record.limits = header.limits;
  record.expected = header.expected;
  record.measured_alignment = header.measured_alignment;
  if (const auto chosen = header.labels.find(std::string(kEstimatorLabel)); chosen != header.labels.end())
    record.estimator = chosen->second;
  record.step = header.step;
  record.steps = header.steps;
  record.approach = header.approach;
  record.axes_order = header.axes_order;
  read_counting_dwells(database, item, [&](std::size_t position, DwellRecord dwell) {
    run.measured.push_back(position);
    run.dwells.push_back(dwell);
    if (dwell.role == DwellRole::kCheck) {
      record.check_poses.push_back({std::move(dwell), record.dwells.size()});
    } else {
      record.dwells.push_back(std::move(dwell));
    }
  });
  SqliteStatement events = database.prepare("select id, utc, kind, text from event order by id");
  const std::map<std::int64_t, Message> messages = read_messages(database);
  while (events.step()) {
    const auto known = messages.find(events.integer("id"));
    run.events.push_back({events.text("utc"), events.text("kind"),
                          known == messages.end() ? Message::bare(events.text("text")) : known->second});
    // set_state() wrote it when the run continued.
    if (run.events.back().kind == to_string(RunState::kRunning)) ++record.continuations;
    if (run.events.back().kind == kReconnectedEvent) ++record.reconnections;
  }
  SqliteStatement environment = database.prepare("select * from environment order by id");
  while (environment.step()) {
    run.environment.push_back(
        {environment.text("utc"), environment.text("moment"), environment.optional_real("temperature_degc"),
         environment.optional_real("humidity_percent"), environment.optional_real("pressure_hpa")});
  }
  return run;
}

}  // namespace

std::vector<StoredRun> RunFile::load_items(SqliteDatabase& database, const std::filesystem::path& path,
                                           int item) {
  std::vector<StoredRun> items{load_from(database, path, std::max(1, item))};
  const std::size_t count = item == 0 ? items.front().header.items.size() : 1;
  for (std::size_t k = 2; k <= count; ++k) items.push_back(load_from(database, path, static_cast<int>(k)));
  return items;
}

StoredRun RunFile::load(const std::filesystem::path& path, int item) {
  // A run that is being written, or whose program died, has a file -wal, which a read-only connection can use
  // too if it may write the file -shm; a closed run is a single file.
  SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
  return load_from(database, path, item);
}

std::vector<StoredRun> RunFile::load_items(const std::filesystem::path& path) {
  SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
  return load_items(database, path);
}

std::size_t RunFile::count_items(const std::filesystem::path& path) {
  SqliteDatabase database = open_run_file_unchecked(path, SqliteDatabase::Mode::kReadOnly);
  if (!database.has_table("item")) return 1;  // Version 2.
  return std::stoul(database.value("select count(*) from item").value_or("1"));
}

void RunFile::read_dwells(const std::filesystem::path& path,
                          const std::function<void(const StoredDwell&)>& each, int item) {
  SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
  read_all_dwells(database, each, item);
}

std::optional<WireTranscript> RunFile::load_transcript(const std::filesystem::path& path) {
  SqliteDatabase database = open_run_file(path, SqliteDatabase::Mode::kReadOnly);
  if (!database.has_table("wire")) return std::nullopt;
  SqliteStatement start = database.prepare("select cast(value as integer) as ns from meta where key=:key");
  start.set("key", kWireStart);
  if (!start.step()) {
    throw RunFileError(path.string() + ": meta \"" + std::string(kWireStart) +
                       "\" is missing; the file is damaged");
  }
  WireTranscript transcript{Clock::UtcTime(Clock::Duration(start.integer("ns"))), {}};
  SqliteStatement rows =
      database.prepare("select role, time_ns, arrival_ns, kind, bytes from wire order by id");
  while (rows.step()) {
    const std::string kind = rows.text(3);
    transcript.rows.push_back({rows.text(0), rows.integer(1), rows.optional_integer(2),
                               kind.empty() ? '\0' : kind.front(), rows.blob(4)});
  }
  return transcript;
}

}  // namespace abcal
