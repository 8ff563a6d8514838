#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::lab {

/// The register cannot be opened, read or written, or refuses a request; what() names the reason, the finding
/// and the remedy.
class RegisterError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A value for a parameter of a statement, ":name" in its text; or for a column of a new row.
struct Parameter {
  std::string name;
  std::string value;
};

/// The database of a register: one SQLite file, or PostgreSQL. All values are text here; the database
/// converts them. SOCI's backend is loaded when a database is opened, so that a program that opens none
/// starts as fast as without. All functions throw RegisterError.
class Database {
 public:
  using Row = std::vector<std::string>;

  /// @param location  path of an SQLite file, or "postgresql://USER@HOST/DATABASE"
  explicit Database(const std::string& location);
  Database(Database&&) noexcept;
  Database& operator=(Database&&) noexcept;
  ~Database();

  /// The rows of a query with this number of columns; NULL is an empty text.
  std::vector<Row> query(std::size_t columns, const std::string& sql,
                         const std::vector<Parameter>& parameters = {});
  void execute(const std::string& sql, const std::vector<Parameter>& parameters = {});
  /// A new row of a table: its columns by name, with their values.
  void insert(std::string_view table, const std::vector<Parameter>& row);

  /// Whether the database has the tables of a register.
  bool has_register();
  const std::string& location() const;
  /// SQLite: the register is one file.
  bool is_one_file() const;
  /// Time since the last transaction was asked for: how long it waited for others.
  std::chrono::nanoseconds since_begin() const;

 private:
  friend class DatabaseTransaction;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// A transaction that may write from its beginning (SQLite: `begin immediate`, which waits up to 120 s for
/// others), rolled back unless it is committed.
class DatabaseTransaction {
 public:
  enum class Purpose { kWrite, kRead };
  explicit DatabaseTransaction(Database& database, Purpose purpose = Purpose::kWrite);
  DatabaseTransaction(const DatabaseTransaction&) = delete;
  DatabaseTransaction& operator=(const DatabaseTransaction&) = delete;
  ~DatabaseTransaction();
  void commit();

 private:
  Database& database_;
  bool committed_ = false;
};

/// A database without a register at a location; an SQLite file is made, for this user only.
/// @throws RegisterError if a register or such a file exists
Database make_empty(const std::string& location);

/// A location as messages show it: "postgresql://user:secret@host/x" without the secret.
std::string without_password(const std::string& location);

/// Whether a location names a PostgreSQL database.
bool is_postgresql(const std::string& location);

}  // namespace abcal::lab
