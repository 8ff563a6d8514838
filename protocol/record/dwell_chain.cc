#include "protocol/record/dwell_chain.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>

#include "protocol/record/run_record.h"
#include "protocol/record/run_schema.h"

namespace abcal {
namespace {

/// Order and choice of the columns are part of the format: docs/run_file.md.
constexpr std::array kHeadQueries{
    "select key, value from meta where key not like 'timing.%' and key not in ('state', 'wire.start_utc_ns') "
    "order by key",
    "select role, maker, model, serial_number, firmware, details from instrument order by role",
    "select k, maker, model, serial_number, firmware, driver, port, mounting, response_unit, rate_hz, "
    "full_scale, resolution from item order by k",
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
    "sweep is not null";
constexpr const char* kEncoderOfDwell =
    "select k, time_ns, angle_deg from encoder_sample where dwell = :dwell order by k";
constexpr const char* kSessionOfDwell =
    "select id, begun_utc, begun_utc_ns, origin_ns, monotonic_ns, boot_id, since_boot_ns, clock_offset_s, "
    "clock_error_s, program_version from session where id = (select session from dwell where id = :dwell)";
constexpr const char* kDwell =
    "select id, position, item, role, session, experiment, n, closing, alpha_deg, commanded_x_deg, "
    "commanded_z_deg, encoder_x_deg, encoder_z_deg, time_ns, time_s, utc, settle_s, count, lost, r_u, r_v, "
    "r_w, spread_u, spread_v, spread_w, u_u, u_v, u_w, temperature_degc, flags, flag_words, first_sequence, "
    "first_reading_ns, reading_interval_ns, first_temperature_degc, temperature_step_degc from dwell where "
    "id = :dwell";
constexpr const char* kReadingsOfVersion3 =
    "select k, u, v, w, skipped, late_ns, temperature_steps from reading where dwell = :dwell order by k";
/// The same values since version 5.
constexpr const char* kReadings =
    "select k, u, v, w, coalesce((select skipped from reading_gap g where g.dwell = reading.dwell and g.k <= "
    "reading.k order by g.k desc limit 1), 0), late_ns, temperature_steps from reading where dwell = :dwell "
    "order by k";
/// The same values of a dwell without gaps, in a fraction of the time.
constexpr const char* kReadingsWithoutGaps =
    "select k, u, v, w, 0, late_ns, temperature_steps from reading where dwell = :dwell order by k";

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

/// Version 6 covers every column of every table. Text and views of the schema are those of a run file
/// (run_schema.cc); tables that may be made later are covered by the closing link.
constexpr std::array kHeadQueriesOfVersion6{
    "select type, name, tbl_name, sql from sqlite_master where name not in ('item_drop', 'message', 'wire') "
    "order by type, name",
    "select * from meta where key not like 'timing.%' and key not in ('state', 'wire.start_utc_ns') order by "
    "key",
    "select * from instrument order by role",
    "select * from item order by k",
    "select * from item_register order by item, name",
    "select * from plan order by position",
};
/// A link covers what stood before the dwell and was in no link yet, then the dwell.
constexpr std::array kDwellQueriesOfVersion6{
    "select chain from event where id = (select event from dwell where id = :dwell)",
    "select * from environment where id <= (select environment from dwell where id = :dwell) and id > "
    "coalesce((select environment from dwell where id < :dwell order by id desc limit 1), 0) order by id",
    "select * from session where id < (select session from dwell where id = :dwell) order by id",
    kSessionOfDwell,
    kDwell,
    "select face, sweep, rate_deg_per_s, acceleration_deg_per_s2, u_angle_deg, event, environment from dwell "
    "where id = :dwell",
    "select * from encoder_sample where dwell = :dwell order by k",
};
constexpr const char* kDropsBeforeDwell =
    "select * from item_drop where event <= (select event from dwell where id = :dwell) order by item";
constexpr const char* kGapsOfDwell = "select * from reading_gap where dwell = :dwell order by k";
constexpr std::array kClosingQueriesOfVersion6{
    "select type, name, tbl_name, sql from sqlite_master order by type, name",
    "select * from meta order by key",
    "select * from event order by id",
    "select * from session order by id",
    "select * from environment order by id",
    "select * from seal order by id",
};
/// Tables that only some runs have, for closing_link() of version 6.
constexpr std::array kOptionalTables{std::pair{"item_drop", "select * from item_drop order by item"},
                                     std::pair{"message", "select * from message order by event"},
                                     std::pair{"wire", "select * from wire order by id"}};

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

/// Adds all that the link of a dwell covers but its readings.
void add_facts_of_dwell(Sha256& hash, SqliteDatabase& database, std::int64_t dwell) {
  const auto add = [&](const char* query) { add_rows_of_dwell(hash, database, query, dwell); };
  if (links_all(database)) {
    std::ranges::for_each(kDwellQueriesOfVersion6, add);
    if (database.has_table("item_drop")) add(kDropsBeforeDwell);
    return;
  }
  add(kSessionOfDwell);
  add(kDwell);
  if (!has_faces(database)) return;
  for (const char* query : {kFaceOfDwell, kMotionOfDwell, kEncoderOfDwell}) add(query);
}

bool has_gaps(SqliteDatabase& database, std::int64_t dwell) {
  SqliteStatement gaps = database.prepare("select 1 from reading_gap where dwell = :dwell limit 1");
  return gaps.set("dwell", dwell).step();
}

/// Adds what is stored with the readings of a dwell, behind them.
void add_gaps_of_dwell(Sha256& hash, SqliteDatabase& database, std::int64_t dwell) {
  if (links_all(database)) add_rows_of_dwell(hash, database, kGapsOfDwell, dwell);
}

/// The place of a dwell in the plan.
struct DwellPlace {
  std::string circle;      ///< Experiment and face.
  std::int64_t sweep = 0;  ///< In its circle; 0: at rest.
  std::int64_t position = 0, item = 0;

  /// Whether this dwell was stored together with the one that was written before it.
  bool is_stored_with(const DwellPlace& before) const {
    if (position == before.position) return item > before.item;
    return sweep > 0 && sweep == before.sweep && circle == before.circle && position > before.position;
  }
};

}  // namespace

std::string head_link(SqliteDatabase& database) {
  Sha256 hash;
  const auto add = [&](const char* query) {
    SqliteStatement rows = database.prepare(query);
    add_rows(hash, rows);
  };
  if (links_all(database)) {
    std::ranges::for_each(kHeadQueriesOfVersion6, add);
    return hash.hexadecimal();
  }
  std::ranges::for_each(kHeadQueries, add);
  if (has_faces(database)) {
    add(kFacesOfPlan);
    add(kSweepsOfPlan);
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
  if (links_all(database)) {
    std::ranges::for_each(kClosingQueriesOfVersion6, add);
    for (const auto& [table, query] : kOptionalTables)
      if (database.has_table(table)) add(query);
    return hash.hexadecimal();
  }
  std::ranges::for_each(kClosingQueries, add);
  if (database.has_table("item_drop")) add(kDropsToClose);
  if (database.has_table("wire")) add(kWireToClose);
  return hash.hexadecimal();
}

std::vector<StoredTogether> stored_together(SqliteDatabase& database, std::int64_t from) {
  SqliteStatement rows =
      database.prepare(fmt::format("select position, experiment, n, item, role, {} as circle, {} as sweep, "
                                   "chain, coalesce(count / (select "
                                   "rate_hz from item where item.k = dwell.item), 0.0) as reading_time_s "
                                   "from dwell where id >= :from order "
                                   "by id",
                                   has_faces(database) ? "experiment || '/' || face" : "experiment",
                                   has_faces(database) ? "coalesce(sweep, 0)" : "0"));
  rows.set("from", from);
  std::vector<StoredTogether> stored;
  DwellPlace last;
  std::map<std::int64_t, double> time_of_item;
  while (rows.step()) {
    const DwellPlace place{rows.text("circle"), rows.integer("sweep"), rows.integer("position"),
                           rows.integer("item")};
    if (stored.empty() || !place.is_stored_with(last)) {
      time_of_item.clear();
      stored.push_back({place.position,
                        0,
                        static_cast<int>(rows.integer("experiment")),
                        static_cast<int>(rows.integer("n")),
                        place.sweep > 0,
                        rows.text("role") == to_string(DwellRole::kCheck),
                        0.0,
                        {}});
    }
    StoredTogether& group = stored.back();
    group.angles += group.angles == 0 || place.position != last.position ? 1 : 0;
    double& time_s = time_of_item[place.item] += rows.optional_real("reading_time_s").value_or(0.0);
    group.reading_time_s = std::max(group.reading_time_s, time_s);
    group.link = rows.text("chain");
    last = place;
  }
  return stored;
}

RunLinks run_links(const std::filesystem::path& run) {
  SqliteDatabase database = open_run_file_unchecked(run, SqliteDatabase::Mode::kReadOnly);
  if (run_file_version(database) < 3) return {};
  return {head_link(database), stored_together(database), closing_link(database)};
}

std::string last_dwell_link(const std::filesystem::path& run) {
  SqliteDatabase database = open_run_file_unchecked(run, SqliteDatabase::Mode::kReadOnly);
  if (run_file_version(database) < 3) return {};
  return database.value("select chain from dwell order by id desc limit 1").value_or("");
}

std::string dwell_link(SqliteDatabase& database, std::int64_t dwell, std::string_view before) {
  Sha256 hash;
  hash.add(before);
  add_facts_of_dwell(hash, database, dwell);
  add_rows_of_dwell(hash, database,
                    !has_reading_gaps(database) ? kReadingsOfVersion3
                    : has_gaps(database, dwell) ? kReadings
                                                : kReadingsWithoutGaps,
                    dwell);
  add_gaps_of_dwell(hash, database, dwell);
  return hash.hexadecimal();
}

DwellLink::DwellLink(SqliteDatabase& database, std::int64_t dwell) : database_(database), dwell_(dwell) {
  SqliteStatement last =
      database.prepare("select chain from dwell where id < :dwell order by id desc limit 1");
  last.set("dwell", dwell);
  hash_.add(last.step() ? last.text("chain") : head_link(database));
  add_facts_of_dwell(hash_, database, dwell);
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
  add_gaps_of_dwell(hash_, database_, dwell_);
  database_.prepare("update dwell set chain = :chain where id = :dwell")
      .set("chain", hash_.hexadecimal())
      .set("dwell", dwell_)
      .run();
}

}  // namespace abcal
