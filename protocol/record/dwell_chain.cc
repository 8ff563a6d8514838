#include "protocol/record/dwell_chain.h"

#include <array>
#include <bit>
#include <cmath>

#include "protocol/record/run_schema.h"

namespace abcal {
namespace {

/// Order and choice of the columns are part of the format: docs/run_file.md.
constexpr std::array kHeadQueries{
    "select key, value from meta where key not like 'timing.%' and key not in ('state', 'wire.start_utc_ns')"
    " order by key",
    "select role, maker, model, serial_number, firmware, details from instrument order by role",
    "select k, maker, model, serial_number, firmware, driver, port, mounting, response_unit, rate_hz, "
    "full_scale,"
    " resolution from item order by k",
    "select item, name, value from item_register order by item, name",
    "select position, experiment, n, closing, alpha_deg, x_deg, z_deg from plan order by position",
};
/// Since version 5. Face 1 adds no row, so that the links of earlier versions stay valid.
constexpr const char* kFacesOfPlan = "select position, face from plan where face <> 1 order by position";
constexpr const char* kFaceOfDwell = "select face from dwell where id = :dwell and face <> 1";
/// Angles at rest add no row either.
constexpr const char* kSweepsOfPlan =
    "select position, sweep, rate_deg_per_s from plan where sweep <> 0 order by position";
constexpr const char* kMotionOfDwell =
    "select sweep, rate_deg_per_s, acceleration_deg_per_s2, u_angle_deg from dwell where id = :dwell and "
    "sweep is "
    "not null";
constexpr const char* kEncoderOfDwell =
    "select k, time_ns, angle_deg from encoder_sample where dwell = :dwell order by k";
constexpr const char* kSessionOfDwell =
    "select id, begun_utc, begun_utc_ns, origin_ns, monotonic_ns, boot_id, since_boot_ns, clock_offset_s,"
    " clock_error_s, program_version from session where id = (select session from dwell where id = :dwell)";
constexpr const char* kDwell =
    "select id, position, item, role, session, experiment, n, closing, alpha_deg, commanded_x_deg, "
    "commanded_z_deg,"
    " encoder_x_deg, encoder_z_deg, time_ns, time_s, utc, settle_s, count, lost, r_u, r_v, r_w, spread_u, "
    "spread_v,"
    " spread_w, u_u, u_v, u_w, temperature_degc, flags, flag_words, first_sequence, first_reading_ns,"
    " reading_interval_ns, first_temperature_degc, temperature_step_degc from dwell where id = :dwell";
constexpr const char* kReadingsOfVersion3 =
    "select k, u, v, w, skipped, late_ns, temperature_steps from reading where dwell = :dwell order by k";
/// The same values since version 5.
constexpr const char* kReadings =
    "select k, u, v, w, coalesce((select skipped from reading_gap g where g.dwell = reading.dwell and"
    " g.k <= reading.k order by g.k desc limit 1), 0), late_ns, temperature_steps"
    " from reading where dwell = :dwell order by k";

/// For closing_link().
constexpr std::array kClosingQueries{
    "select key, value from meta order by key",
    "select chain from event order by id desc limit 1",
    "select id, ended_utc, end_reason from session order by id",
    "select utc, moment, temperature_degc, humidity_percent, pressure_hpa from environment order by id",
    "select utc, dwells, dwell_chain, event_chain from seal order by id",
};
constexpr const char* kDropsToClose = "select item, position, event from item_drop order by item";
constexpr const char* kWireToClose = "select role, time_ns, arrival_ns, kind, bytes from wire order by id";

void add_eight_bytes(Sha256& hash, char kind, std::uint64_t bits) {
  std::array<char, 9> bytes{kind};
  for (std::size_t k = 0; k < 8; ++k) bytes[k + 1] = static_cast<char>((bits >> (8U * k)) & 0xFFU);
  hash.add({bytes.data(), bytes.size()});
}

void add_null(Sha256& hash) {
  hash.add("n");
}

void add_integer(Sha256& hash, std::int64_t value) {
  add_eight_bytes(hash, 'i', static_cast<std::uint64_t>(value));
}

void add_real(Sha256& hash, double value) {
  add_eight_bytes(hash, 'r', std::bit_cast<std::uint64_t>(value));
}

void begin_row(Sha256& hash) {
  hash.add("\n");
}

void add_value(Sha256& hash, const SqliteStatement& row, int column) {
  switch (row.type(column)) {
    case SQLITE_NULL:
      add_null(hash);
      break;
    case SQLITE_INTEGER:
      add_integer(hash, row.integer(column));
      break;
    case SQLITE_FLOAT:
      add_real(hash, row.real(column));
      break;
    default: {
      const std::string bytes = row.blob(column);
      add_eight_bytes(hash, row.type(column) == SQLITE_TEXT ? 't' : 'b', bytes.size());
      hash.add(bytes);
    }
  }
}

void add_rows(Sha256& hash, SqliteStatement& rows) {
  while (rows.step()) {
    begin_row(hash);
    const int columns = rows.columns();
    for (int column = 0; column < columns; ++column) add_value(hash, rows, column);
  }
}

void add_rows_of_dwell(Sha256& hash, SqliteDatabase& database, const char* query, std::int64_t dwell) {
  SqliteStatement rows = database.prepare(query);
  rows.set("dwell", dwell);
  add_rows(hash, rows);
}

void add_rows_of_version_5(Sha256& hash, SqliteDatabase& database, std::int64_t dwell) {
  if (!has_faces(database)) return;
  for (const char* query : {kFaceOfDwell, kMotionOfDwell, kEncoderOfDwell})
    add_rows_of_dwell(hash, database, query, dwell);
}

}  // namespace

std::string head_link(SqliteDatabase& database) {
  Sha256 hash;
  for (const char* query : kHeadQueries) {
    SqliteStatement rows = database.prepare(query);
    add_rows(hash, rows);
  }
  if (has_faces(database)) {
    for (const char* query : {kFacesOfPlan, kSweepsOfPlan}) {
      SqliteStatement rows = database.prepare(query);
      add_rows(hash, rows);
    }
  }
  return hash.hexadecimal();
}

std::string closing_link(SqliteDatabase& database) {
  Sha256 hash;
  const auto add = [&](const char* query) {
    hash.add("\n");
    SqliteStatement rows = database.prepare(query);
    add_rows(hash, rows);
  };
  for (const char* query : kClosingQueries) add(query);
  if (database.has_table("item_drop")) add(kDropsToClose);
  if (database.has_table("wire")) add(kWireToClose);
  return hash.hexadecimal();
}

RunLinks run_links(const std::filesystem::path& run) {
  SqliteDatabase database = open_run_file_unchecked(run, SqliteDatabase::Mode::kReadOnly);
  RunLinks links;
  if (run_file_version(database) < 3) return links;
  links.head = head_link(database);
  SqliteStatement rows = database.prepare(
      "select position, experiment, n, item, chain, coalesce(count / (select rate_hz from item where item.k "
      "= "
      "dwell.item), 0.0) as reading_time_s from dwell order by id");
  while (rows.step())
    links.dwells.push_back({rows.integer("position"), static_cast<int>(rows.integer("experiment")),
                            static_cast<int>(rows.integer("n")), static_cast<int>(rows.integer("item")),
                            rows.optional_real("reading_time_s").value_or(0.0), rows.text("chain")});
  links.closing = closing_link(database);
  return links;
}

std::string last_dwell_link(const std::filesystem::path& run) {
  SqliteDatabase database = open_run_file_unchecked(run, SqliteDatabase::Mode::kReadOnly);
  if (run_file_version(database) < 3) return {};
  return database.value("select chain from dwell order by id desc limit 1").value_or("");
}

std::string dwell_link(SqliteDatabase& database, std::int64_t dwell, std::string_view before) {
  Sha256 hash;
  hash.add(before);
  for (const char* query : {kSessionOfDwell, kDwell}) add_rows_of_dwell(hash, database, query, dwell);
  add_rows_of_version_5(hash, database, dwell);
  add_rows_of_dwell(hash, database, has_reading_gaps(database) ? kReadings : kReadingsOfVersion3, dwell);
  return hash.hexadecimal();
}

DwellLink::DwellLink(SqliteDatabase& database, std::int64_t dwell) : database_(database), dwell_(dwell) {
  SqliteStatement last =
      database.prepare("select chain from dwell where id < :dwell order by id desc limit 1");
  last.set("dwell", dwell);
  hash_.add(last.step() ? last.text("chain") : head_link(database));
  for (const char* query : {kSessionOfDwell, kDwell}) add_rows_of_dwell(hash_, database, query, dwell);
  add_rows_of_version_5(hash_, database, dwell);
}

void DwellLink::add(const ReadingRow& reading) {
  begin_row(hash_);
  add_integer(hash_, reading.k);
  for (const double output : reading.output) {
    if (std::isfinite(output)) {
      add_real(hash_, output + 0.0);  // SQLite stores -0 as 0 in a column of reals.
    } else {
      add_null(hash_);
    }
  }
  add_integer(hash_, reading.skipped);
  add_integer(hash_, reading.late_ns);
  if (const auto* steps = std::get_if<std::int64_t>(&reading.temperature_steps)) {
    add_integer(hash_, *steps);
  } else if (const auto* degc = std::get_if<double>(&reading.temperature_steps)) {
    add_real(hash_, *degc);
  } else {
    add_null(hash_);
  }
}

void DwellLink::store() {
  database_.prepare("update dwell set chain = :chain where id = :dwell")
      .set("chain", hash_.hexadecimal())
      .set("dwell", dwell_)
      .run();
}

}  // namespace abcal
