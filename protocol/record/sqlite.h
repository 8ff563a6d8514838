#pragma once

#include <sqlite3.h>

#include <chrono>
#include <concepts>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// A run file or its results cannot be created, read or written; what() names the file, the finding and the
/// remedy.
class RunFileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The disk did not read or write, which does not concern the contents of the file and may be temporary.
class DiskError final : public RunFileError {
 public:
  using RunFileError::RunFileError;
};

/// Statements of one database that are prepared and not in use, by their text. To prepare one takes longer
/// than most of them run.
class IdleStatements {
 public:
  IdleStatements() = default;
  IdleStatements(const IdleStatements&) = delete;
  IdleStatements& operator=(const IdleStatements&) = delete;
  ~IdleStatements();
  /// Null if no statement has this text.
  sqlite3_stmt* take(const std::string& sql);
  /// Resets it, so that it holds no lock and no value; finalises it if there is one of that text already.
  void put(const std::string& sql, sqlite3_stmt* statement);

 private:
  std::map<std::string, sqlite3_stmt*> idle_;
};

/// One prepared statement, reset after each use. Bind with 1-based positions as SQLite does.
class SqliteStatement {
 public:
  SqliteStatement(sqlite3* database, std::shared_ptr<IdleStatements> idle, const std::string& file,
                  std::string_view sql);

  SqliteStatement& bind(int position, std::int64_t value);
  SqliteStatement& bind(int position, double value);  ///< A value that is not finite is stored as NULL.
  SqliteStatement& bind(int position, std::string_view value);
  SqliteStatement& bind(int position, const std::optional<double>& value);
  SqliteStatement& bind(int position, const std::optional<std::int64_t>& value);
  SqliteStatement& bind_blob(int position, std::string_view bytes);
  /// Binds a named parameter: set("alpha_deg", 5.0) for ":alpha_deg".
  template <class Value>
  SqliteStatement& set(const std::string& parameter, const Value& value) {
    return bind(parameter_index(parameter), value);
  }

  /// True while there is a row.
  /// @throws RunFileError with SQLite's own words.
  bool step();
  /// Carries the statement out and resets it.
  void run();
  void reset();

  std::int64_t integer(int column) const { return sqlite3_column_int64(handle_.get(), column); }
  double real(int column) const { return sqlite3_column_double(handle_.get(), column); }
  std::optional<double> optional_real(int column) const;
  std::optional<std::int64_t> optional_integer(int column) const;
  std::string text(int column) const;
  std::string blob(int column) const;
  bool is_null(int column) const { return type(column) == SQLITE_NULL; }
  /// SQLITE_INTEGER, SQLITE_FLOAT, SQLITE_TEXT, SQLITE_BLOB or SQLITE_NULL.
  int type(int column) const { return sqlite3_column_type(handle_.get(), column); }
  int columns() const { return sqlite3_column_count(handle_.get()); }

  /// Position of the column of that name in the result. @throws RunFileError if there is none.
  int column(std::string_view name) const;
  std::int64_t integer(std::string_view name) const { return integer(column(name)); }
  double real(std::string_view name) const { return real(column(name)); }
  std::optional<double> optional_real(std::string_view name) const { return optional_real(column(name)); }
  std::optional<std::int64_t> optional_integer(std::string_view name) const {
    return optional_integer(column(name));
  }
  std::string text(std::string_view name) const { return text(column(name)); }

 private:
  int parameter_index(const std::string& parameter) const;
  void check(int code) const;

  struct PutBack {
    std::shared_ptr<IdleStatements> idle;
    std::string sql;
    void operator()(sqlite3_stmt* statement) const { idle->put(sql, statement); }
  };
  sqlite3* database_;
  std::string file_;
  std::unique_ptr<sqlite3_stmt, PutBack> handle_;
};

class Insertion;

/// An open SQLite database whose errors name the file and the cause. One thread at a time may use it and its
/// statements.
class SqliteDatabase {
 public:
  enum class Mode { kReadOnly, kReadWrite, kCreate };
  /// Waits up to 2 s for another connection that holds a lock, unless wait_at_most() sets another time.
  SqliteDatabase(const std::filesystem::path& path, Mode mode);

  void wait_at_most(std::chrono::milliseconds patience);
  /// Texts and blobs that are longer than so many bytes are not read or written.
  void limit_values(int bytes);
  /// Switches to a write-ahead log, for which SQLite does not wait while another connection holds a lock.
  void use_write_ahead_log();
  void execute(const std::string& sql);
  /// Like execute(), but returns false if another connection prevents it.
  bool execute_unless_busy(const std::string& sql);
  SqliteStatement prepare(std::string_view sql) { return {handle_.get(), idle_, file_, sql}; }
  /// A new row of a table: insert("run").set("sha256", hash).set("note", note).run().
  Insertion insert(std::string_view table);
  /// The first column of the first row of a query; nullopt if there is no row.
  std::optional<std::string> value(std::string_view sql);
  /// Whether the file that is open is not, or no longer, the one of its name: renamed, removed or replaced.
  bool has_moved();
  bool has_table(std::string_view name);
  bool has_column(std::string_view table, std::string_view column);
  std::int64_t last_row_id() const { return sqlite3_last_insert_rowid(handle_.get()); }
  /// The first bytes of the file, fewer if the file is shorter. Reads them through SQLite: a stream of our
  /// own would, when it closes, release the locks of every connection that this process has to the file
  /// (POSIX), and another process could then remove the write-ahead log that is in use.
  std::string first_bytes(std::size_t count);

 private:
  struct Close {
    void operator()(sqlite3* database) const { sqlite3_close_v2(database); }
  };
  std::string file_;
  std::chrono::milliseconds patience_{2000};
  std::unique_ptr<sqlite3, Close> handle_;
  std::shared_ptr<IdleStatements> idle_ = std::make_shared<IdleStatements>();
};

/// A row to be inserted. Each column is named once, with its value; columns that are not named are NULL or
/// have their default.
class Insertion {
 public:
  Insertion(SqliteDatabase& database, std::string_view table) : database_(database), table_(table) {}

  /// Copies the value, so that it need not live until run().
  template <class Value>
  Insertion& set(std::string_view column, const Value& value) {
    columns_.emplace_back(column);
    if constexpr (std::convertible_to<Value, std::string_view>)
      values_.emplace_back([value = std::string(value)](SqliteStatement& row, int position) {
        row.bind(position, std::string_view(value));
      });
    else
      values_.emplace_back([value](SqliteStatement& row, int position) { row.bind(position, value); });
    return *this;
  }
  void run();

 private:
  SqliteDatabase& database_;
  std::string table_;
  std::vector<std::string> columns_;
  std::vector<std::function<void(SqliteStatement& row, int position)>> values_;
};

/// A transaction that may write from its beginning, rolled back unless it is committed. Data read in it stay
/// valid until the commit: no other connection can write until then.
class Transaction {
 public:
  explicit Transaction(SqliteDatabase& database);
  Transaction(const Transaction&) = delete;
  Transaction& operator=(const Transaction&) = delete;
  ~Transaction();
  void commit();

 private:
  SqliteDatabase& database_;
  bool committed_ = false;
};

/// Reports a failed SQLite call on `file`, with the recommended action. @throws DiskError, RunFileError
[[noreturn]] void throw_sqlite_error(const std::string& file, int code, std::string_view message);

}  // namespace abcal
