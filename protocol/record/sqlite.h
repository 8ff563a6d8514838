#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

namespace abcal {

/// A run file or its results cannot be created, read or written; what() says which file, what was found and
/// what to do.
class RunFileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One prepared statement, reset after each use. Bind with 1-based positions as SQLite does.
class SqliteStatement {
 public:
  SqliteStatement(sqlite3* database, const std::string& file, std::string_view sql);

  SqliteStatement& bind(int position, std::int64_t value);
  SqliteStatement& bind(int position, double value);  ///< A value that is not finite is stored as NULL.
  SqliteStatement& bind(int position, std::string_view value);
  SqliteStatement& bind(int position, const std::optional<double>& value);
  SqliteStatement& bind(int position, const std::optional<std::int64_t>& value);
  SqliteStatement& bind_blob(int position, std::string_view bytes);

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

 private:
  void check(int code) const;

  struct Finalise {
    void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
  };
  sqlite3* database_;
  std::string file_;
  std::unique_ptr<sqlite3_stmt, Finalise> handle_;
};

/// An open SQLite database that says which file failed and how.
class SqliteDatabase {
 public:
  enum class Mode { kReadOnly, kReadWrite, kCreate };
  SqliteDatabase(const std::filesystem::path& path, Mode mode);

  void execute(const std::string& sql);
  /// As execute(), but tells by `false` that another connection stands in the way.
  bool execute_unless_busy(const std::string& sql);
  SqliteStatement prepare(std::string_view sql) { return {handle_.get(), file_, sql}; }
  /// The first column of the first row of a query; nothing if there is no row.
  std::optional<std::string> value(std::string_view sql);
  std::int64_t last_row_id() const { return sqlite3_last_insert_rowid(handle_.get()); }

 private:
  struct Close {
    void operator()(sqlite3* database) const { sqlite3_close_v2(database); }
  };
  std::string file_;
  std::unique_ptr<sqlite3, Close> handle_;
};

/// The words for a failed SQLite call on `file`, with what a person should do about it.
std::string explain_sqlite_error(const std::string& file, int code, std::string_view message);

}  // namespace abcal
