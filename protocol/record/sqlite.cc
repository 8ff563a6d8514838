#include "protocol/record/sqlite.h"

#include <algorithm>
#include <cmath>
#include <thread>
#include <utility>

namespace abcal {

namespace {

/// The words for a failed SQLite call, with the recommended action.
std::string explain(const std::string& file, int code, std::string_view message) {
  std::string text = file + ": " + std::string(message);
  switch (code & 0xFF) {
    case SQLITE_FULL:
      return text + "; the disk is full: free some space, then continue with `abcal resume`";
    case SQLITE_IOERR:
      return text +
             "; the disk could not be written or read, the file itself may be sound: check its space and "
             "condition, then try again";
    case SQLITE_READONLY:
    case SQLITE_PERM:
      return text + "; the file or its folder cannot be written by this user";
    case SQLITE_CANTOPEN:
      return text + "; check that the folder exists and is writable";
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return text + "; another program is using the file";
    case SQLITE_NOTADB:
      return text + "; this is not a run file";
    case SQLITE_TOOBIG:
      return text +
             "; a value in it is larger than any that abcal writes: another program has changed the file";
    case SQLITE_CORRUPT:
      return text + "; the file is damaged or truncated: restore it from a copy";
    default:
      return text + " (SQLite code " + std::to_string(code) + ")";
  }
}

}  // namespace

void throw_sqlite_error(const std::string& file, int code, std::string_view message) {
  const std::string words = explain(file, code, message);
  if ((code & 0xFF) == SQLITE_IOERR) throw DiskError(words);
  throw RunFileError(words);
}

IdleStatements::~IdleStatements() {
  for (const auto& [sql, statement] : idle_) sqlite3_finalize(statement);
}

sqlite3_stmt* IdleStatements::take(const std::string& sql) {
  const auto found = idle_.find(sql);
  if (found == idle_.end()) return nullptr;
  sqlite3_stmt* statement = found->second;
  idle_.erase(found);
  return statement;
}

void IdleStatements::put(const std::string& sql, sqlite3_stmt* statement) {
  sqlite3_reset(statement);
  sqlite3_clear_bindings(statement);
  if (!idle_.emplace(sql, statement).second) sqlite3_finalize(statement);
}

SqliteStatement::SqliteStatement(sqlite3* database, std::shared_ptr<IdleStatements> idle,
                                 const std::string& file, std::string_view sql)
    : database_(database), file_(file), handle_(nullptr, PutBack{std::move(idle), std::string(sql)}) {
  sqlite3_stmt* statement = handle_.get_deleter().idle->take(handle_.get_deleter().sql);
  if (statement == nullptr)
    check(sqlite3_prepare_v3(database, sql.data(), static_cast<int>(sql.size()), SQLITE_PREPARE_PERSISTENT,
                             &statement, nullptr));
  handle_.reset(statement);
}

void SqliteStatement::check(int code) const {
  if (code != SQLITE_OK && code != SQLITE_ROW && code != SQLITE_DONE) {
    throw_sqlite_error(file_, code, sqlite3_errmsg(database_));
  }
}

SqliteStatement& SqliteStatement::bind(int position, std::int64_t value) {
  check(sqlite3_bind_int64(handle_.get(), position, value));
  return *this;
}

SqliteStatement& SqliteStatement::bind(int position, double value) {
  check(std::isfinite(value) ? sqlite3_bind_double(handle_.get(), position, value)
                             : sqlite3_bind_null(handle_.get(), position));
  return *this;
}

SqliteStatement& SqliteStatement::bind(int position, std::string_view value) {
  check(sqlite3_bind_text(handle_.get(), position, value.data(), static_cast<int>(value.size()),
                          SQLITE_TRANSIENT));
  return *this;
}

SqliteStatement& SqliteStatement::bind(int position, const std::optional<double>& value) {
  if (value) return bind(position, *value);
  check(sqlite3_bind_null(handle_.get(), position));
  return *this;
}

SqliteStatement& SqliteStatement::bind(int position, const std::optional<std::int64_t>& value) {
  check(value ? sqlite3_bind_int64(handle_.get(), position, *value)
              : sqlite3_bind_null(handle_.get(), position));
  return *this;
}

SqliteStatement& SqliteStatement::bind_blob(int position, std::string_view bytes) {
  check(sqlite3_bind_blob(handle_.get(), position, bytes.empty() ? "" : bytes.data(),
                          static_cast<int>(bytes.size()), SQLITE_TRANSIENT));
  return *this;
}

bool SqliteStatement::step() {
  const int code = sqlite3_step(handle_.get());
  check(code);
  return code == SQLITE_ROW;
}

void SqliteStatement::run() {
  step();
  reset();
}

void SqliteStatement::reset() {
  sqlite3_reset(handle_.get());
  sqlite3_clear_bindings(handle_.get());
}

int SqliteStatement::parameter_index(const std::string& parameter) const {
  const int position = sqlite3_bind_parameter_index(handle_.get(), (":" + parameter).c_str());
  if (position == 0) throw RunFileError(file_ + ": a statement without the parameter :" + parameter);
  return position;
}

int SqliteStatement::column(std::string_view name) const {
  for (int k = 0; k < columns(); ++k) {
    if (name == sqlite3_column_name(handle_.get(), k)) return k;
  }
  throw RunFileError(file_ + ": a query without the column " + std::string(name));
}

std::optional<double> SqliteStatement::optional_real(int column) const {
  if (sqlite3_column_type(handle_.get(), column) == SQLITE_NULL) return std::nullopt;
  return real(column);
}

std::string SqliteStatement::text(int column) const {
  const unsigned char* bytes = sqlite3_column_text(handle_.get(), column);
  if (bytes == nullptr) return {};
  return {reinterpret_cast<const char*>(bytes),
          static_cast<std::size_t>(sqlite3_column_bytes(handle_.get(), column))};
}

std::optional<std::int64_t> SqliteStatement::optional_integer(int column) const {
  if (sqlite3_column_type(handle_.get(), column) == SQLITE_NULL) return std::nullopt;
  return integer(column);
}

std::string SqliteStatement::blob(int column) const {
  const void* bytes = sqlite3_column_blob(handle_.get(), column);
  if (bytes == nullptr) return {};  // Empty, or NULL.
  return {static_cast<const char*>(bytes),
          static_cast<std::size_t>(sqlite3_column_bytes(handle_.get(), column))};
}

SqliteDatabase::SqliteDatabase(const std::filesystem::path& path, Mode mode) : file_(path.string()) {
  const int flags = mode == Mode::kReadOnly    ? SQLITE_OPEN_READONLY
                    : mode == Mode::kReadWrite ? SQLITE_OPEN_READWRITE
                                               : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
  sqlite3* database = nullptr;
  // Without SQLite's own lock around every call: one thread at a time uses a database (sqlite.h).
  const int code = sqlite3_open_v2(file_.c_str(), &database, flags | SQLITE_OPEN_NOMUTEX, nullptr);
  handle_.reset(database);
  if (code != SQLITE_OK) {
    throw_sqlite_error(file_, code, database != nullptr ? sqlite3_errmsg(database) : "out of memory");
  }
  wait_at_most(patience_);
  // A file may be from any source: its schema runs only harmless functions, and cannot be written directly.
  sqlite3_db_config(database, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(database, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
}

void SqliteDatabase::wait_at_most(std::chrono::milliseconds patience) {
  patience_ = patience;
  sqlite3_busy_timeout(handle_.get(), static_cast<int>(patience.count()));
}

void SqliteDatabase::limit_values(int bytes) {
  sqlite3_limit(handle_.get(), SQLITE_LIMIT_LENGTH, bytes);
}

void SqliteDatabase::use_write_ahead_log() {
  constexpr auto kLookAgain = std::chrono::milliseconds(10);
  constexpr const char* kSwitch = "pragma journal_mode=wal";
  const auto deadline = std::chrono::steady_clock::now() + patience_;
  while (!execute_unless_busy(kSwitch)) {
    if (std::chrono::steady_clock::now() > deadline) return execute(kSwitch);  // It throws.
    std::this_thread::sleep_for(kLookAgain);
  }
}

void SqliteDatabase::execute(const std::string& sql) {
  if (!execute_unless_busy(sql)) throw_sqlite_error(file_, SQLITE_BUSY, sqlite3_errmsg(handle_.get()));
}

bool SqliteDatabase::execute_unless_busy(const std::string& sql) {
  const int code = sqlite3_exec(handle_.get(), sql.c_str(), nullptr, nullptr, nullptr);
  if ((code & 0xFF) == SQLITE_BUSY) return false;
  if (code != SQLITE_OK) throw_sqlite_error(file_, code, sqlite3_errmsg(handle_.get()));
  return true;
}

bool SqliteDatabase::has_moved() {
  int moved = 0;
  const int code = sqlite3_file_control(handle_.get(), "main", SQLITE_FCNTL_HAS_MOVED, &moved);
  if (code != SQLITE_OK) throw_sqlite_error(file_, code, sqlite3_errstr(code));
  return moved != 0;
}

bool SqliteDatabase::has_table(std::string_view name) {
  SqliteStatement found = prepare("select 1 from sqlite_master where type = 'table' and name = :name");
  found.set("name", name);
  return found.step();
}

bool SqliteDatabase::has_column(std::string_view table, std::string_view column) {
  SqliteStatement found = prepare("select 1 from pragma_table_info(:table) where name = :name");
  found.set("table", table).set("name", column);
  return found.step();
}

std::optional<std::string> SqliteDatabase::value(std::string_view sql) {
  SqliteStatement statement = prepare(sql);
  if (!statement.step()) return std::nullopt;
  return statement.text(0);
}

std::string SqliteDatabase::first_bytes(std::size_t count) {
  sqlite3_file* file = nullptr;
  int code = sqlite3_file_control(handle_.get(), "main", SQLITE_FCNTL_FILE_POINTER, &file);
  if (code != SQLITE_OK) throw_sqlite_error(file_, code, sqlite3_errmsg(handle_.get()));
  sqlite3_int64 size = 0;
  code = file->pMethods->xFileSize(file, &size);
  std::string bytes(std::min(count, static_cast<std::size_t>(size)), '\0');
  if (code == SQLITE_OK) code = file->pMethods->xRead(file, bytes.data(), static_cast<int>(bytes.size()), 0);
  if (code != SQLITE_OK) throw_sqlite_error(file_, code, sqlite3_errstr(code));
  return bytes;
}

Insertion SqliteDatabase::insert(std::string_view table) {
  return {*this, table};
}

void Insertion::run() {
  std::string names, places;
  for (const std::string& column : columns_) {
    const char* comma = names.empty() ? "" : ",";
    names.append(comma).append(column);
    places.append(comma).append("?");
  }
  SqliteStatement row = database_.prepare("insert into " + table_ + "(" + names + ") values(" + places + ")");
  for (std::size_t k = 0; k < values_.size(); ++k) values_[k](row, static_cast<int>(k) + 1);
  row.run();
}

Transaction::Transaction(SqliteDatabase& database) : database_(database) {
  database_.execute("begin immediate");
}

Transaction::~Transaction() {
  if (committed_) return;
  try {
    database_.execute("rollback");
  } catch (const RunFileError&) {
    // SQLite has already rolled back (as with a full disk); the first error is the one to report.
  }
}

void Transaction::commit() {
  database_.execute("commit");
  committed_ = true;
}

}  // namespace abcal
