#include "app/laboratory/register/database.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <soci/soci.h>
#include <soci/version.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <string_view>
#include <thread>
#include <utility>

namespace abcal::lab {
namespace {

/// How long a program waits for others that write the same SQLite file, in seconds.
constexpr int kPatienceS = 120;
/// Interval between its attempts: a change takes a few milliseconds.
constexpr std::chrono::milliseconds kLookAgain{5};

/// The factory of one of SOCI's backends, whose library is loaded now. Only the system's libraries are
/// searched, not the working folder, which SOCI's own search includes.
const soci::backend_factory& backend(const std::string& name) {
  const std::string library =
      fmt::format("libsoci_{}.so.{}.{}", name, SOCI_VERSION / 100000, SOCI_VERSION / 100 % 1000);
  void* handle = ::dlopen(library.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr)
    throw RegisterError(
        fmt::format("{} cannot be loaded ({}); install libsoci-{} of the version that abcal was built with",
                    library, ::dlerror(), name));
  using Factory = const soci::backend_factory*();
  auto* make = reinterpret_cast<Factory*>(::dlsym(handle, ("factory_" + name).c_str()));
  if (make == nullptr) throw RegisterError(library + ": is no backend of SOCI");
  return *make();
}

/// The text as a value of an SQLite connection string.
std::string quoted(const std::string& path) {
  if (path.find('"') != std::string::npos)
    throw RegisterError(path + ": a register's path cannot contain a quotation mark");
  return '"' + path + '"';
}

[[noreturn]] void rethrow(const std::string& location, const std::exception& error) {
  throw RegisterError(fmt::format("register {}: {}", without_password(location), error.what()));
}

/// Makes the file, for this user only: passwords are in it. @throws RegisterError if it exists
void make_private_file(const std::string& path) {
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0)
    throw RegisterError(fmt::format(
        "register {}: cannot be made: {}", path,
        errno == EEXIST ? "there is such a file; a register is never overwritten" : std::strerror(errno)));
  ::close(fd);
}

}  // namespace

std::string without_password(const std::string& location) {
  const std::size_t scheme = location.find("://"), at = location.find('@');
  if (!is_postgresql(location) || at == std::string::npos) return location;
  const std::size_t colon = location.find(':', scheme + 3);
  if (colon == std::string::npos || colon > at) return location;
  return location.substr(0, colon) + location.substr(at);
}

bool is_postgresql(const std::string& location) {
  return location.starts_with("postgresql://") || location.starts_with("postgres://");
}

namespace {

/// A server that does not answer must not hold up the end of a run.
std::string with_connect_timeout(const std::string& location) {
  constexpr int kConnectTimeoutS = 10;
  if (location.find("connect_timeout=") != std::string::npos) return location;
  return fmt::format("{}{}connect_timeout={}", location, location.find('?') == std::string::npos ? '?' : '&',
                     kConnectTimeoutS);
}

}  // namespace

struct Database::Impl {
  std::string location;
  bool one_file = true;
  soci::session session;
  std::chrono::steady_clock::time_point begun;
};

Database::Database(const std::string& location) : impl_(std::make_unique<Impl>()) {
  impl_->location = location;
  impl_->one_file = !is_postgresql(location);
  try {
    if (impl_->one_file) {
      impl_->session.open(backend("sqlite3"),
                          fmt::format("dbname={} timeout={}", quoted(location), kPatienceS));
      impl_->session << "pragma synchronous=full";
      impl_->session << "pragma foreign_keys=on";
    } else {
      impl_->session.open(backend("postgresql"), with_connect_timeout(location));
    }
  } catch (const soci::soci_error& error) {
    rethrow(location, error);
  }
}

Database::Database(Database&&) noexcept = default;
Database& Database::operator=(Database&&) noexcept = default;
Database::~Database() = default;

const std::string& Database::location() const {
  return impl_->location;
}

std::chrono::nanoseconds Database::since_begin() const {
  return std::chrono::steady_clock::now() - impl_->begun;
}

bool Database::is_one_file() const {
  return impl_->one_file;
}

std::vector<Database::Row> Database::query(std::size_t columns, const std::string& sql,
                                           const std::vector<Parameter>& parameters) {
  try {
    std::vector<Row> rows;
    Row row(columns);
    std::vector<soci::indicator> known(columns, soci::i_ok);
    soci::statement statement(impl_->session);
    for (const Parameter& parameter : parameters)
      statement.exchange(soci::use(parameter.value, parameter.name));
    for (std::size_t k = 0; k < columns; ++k) statement.exchange(soci::into(row[k], known[k]));
    statement.alloc();
    statement.prepare(sql);
    statement.define_and_bind();
    bool more = statement.execute(true);
    while (columns > 0 && more) {
      for (std::size_t k = 0; k < columns; ++k)
        if (known[k] != soci::i_ok) row[k].clear();
      rows.push_back(row);
      more = statement.fetch();
    }
    return rows;
  } catch (const soci::soci_error& error) {
    rethrow(impl_->location, error);
  }
}

void Database::execute(const std::string& sql, const std::vector<Parameter>& parameters) {
  (void)query(0, sql, parameters);
}

void Database::insert(std::string_view table, const std::vector<Parameter>& row) {
  std::string columns, places;
  for (const Parameter& one : row) {
    columns.append(columns.empty() ? "" : ", ").append(one.name);
    places.append(places.empty() ? ":" : ", :").append(one.name);
  }
  execute(fmt::format("insert into {}({}) values({})", table, columns, places), row);
}

bool Database::has_register() {
  const std::string tables =
      impl_->one_file ? "select name from sqlite_master where type = 'table' and name = 'schema_step'"
                      : "select table_name from information_schema.tables where table_name = 'schema_step' "
                        "and table_schema = current_schema()";
  return !query(1, tables).empty();
}

Database make_empty(const std::string& location) {
  if (!is_postgresql(location)) make_private_file(location);
  Database database(location);
  if (database.has_register())
    throw RegisterError(fmt::format("register {}: is there already; a register is never overwritten",
                                    without_password(location)));
  return database;
}

namespace {

/// Begins a transaction of SQLite that may write. SQLite's own waiting prefers latecomers, which retry more
/// often: under load one program may never get its turn. Here all retry equally often.
void begin_immediate(Database& database) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(kPatienceS);
  database.execute("pragma busy_timeout=0");
  for (;;) {
    try {
      database.execute("begin immediate");
      break;
    } catch (const RegisterError& error) {
      if (std::string_view(error.what()).find("locked") == std::string_view::npos ||
          std::chrono::steady_clock::now() > deadline)
        throw;
    }
    std::this_thread::sleep_for(kLookAgain);
  }
  database.execute(fmt::format("pragma busy_timeout={}", 1000 * kPatienceS));
}

}  // namespace

DatabaseTransaction::DatabaseTransaction(Database& database, Purpose purpose) : database_(database) {
  // soci::transaction begins an SQLite transaction that only reads: two that both write later fail at once.
  const bool writes = purpose == Purpose::kWrite;
  database_.impl_->begun = std::chrono::steady_clock::now();
  if (database_.is_one_file()) {
    if (writes) begin_immediate(database_);
    if (!writes) database_.execute("begin");
  } else {
    database_.execute(writes ? "begin" : "begin isolation level repeatable read read only");
  }
}

DatabaseTransaction::~DatabaseTransaction() {
  if (committed_) return;
  try {
    database_.execute("rollback");
  } catch (const RegisterError&) {
    // The connection is lost, or the database rolled back by itself: the first error is the one to report.
  }
}

void DatabaseTransaction::commit() {
  database_.execute("commit");
  committed_ = true;
}

}  // namespace abcal::lab
