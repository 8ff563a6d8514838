#include "protocol/record/dwell_rows.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

#include "drivers/text/letters.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/run_schema.h"

namespace abcal {
namespace {

constexpr double kNanosecondsPerSecond = 1e9;
constexpr int kDoubleDigits = std::numeric_limits<double>::digits;
constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();

/// Readings of one statement. To begin and end a statement costs as much as to insert a row; beyond some tens
/// nothing more is gained.
constexpr std::size_t kRowsAtOnce = 50;
constexpr int kParametersOfRow = 6;  // Without the dwell, which all rows share.

std::int64_t nanoseconds(double seconds) {
  return static_cast<std::int64_t>(std::llround(seconds * kNanosecondsPerSecond));
}

/// Constants from which all readings of a dwell are computed.
struct ReadingConstants {
  std::optional<std::int64_t> first_sequence, first_ns, interval_ns;
  std::optional<TemperatureScale> temperature;
};

ReadingConstants constants_of(std::span<const StoredReading> readings, std::int64_t origin_ns) {
  ReadingConstants constants;
  constants.temperature = temperature_scale(readings);
  if (readings.empty()) return constants;
  const std::int64_t first = nanoseconds(readings.front().time_s) - origin_ns;
  const std::int64_t last = nanoseconds(readings.back().time_s) - origin_ns;
  const auto intervals = static_cast<std::int64_t>(readings.size() - 1);
  constants.first_sequence = static_cast<std::int64_t>(readings.front().sequence);
  constants.first_ns = first;
  constants.interval_ns = intervals > 0 ? (last - first) / intervals : 0;
  return constants;
}

decltype(ReadingRow::temperature_steps) temperature_steps(const std::optional<double>& degc,
                                                          const std::optional<TemperatureScale>& scale) {
  if (!degc || !std::isfinite(*degc) || !scale) return std::monostate();
  if (!scale->whole) return *degc;
  return static_cast<std::int64_t>(std::llround((*degc - scale->first_degc) / scale->step_degc));
}

ReadingRow row_of(std::span<const StoredReading> readings, std::size_t index,
                  const ReadingConstants& constants, std::int64_t origin_ns) {
  const StoredReading& reading = readings[index];
  const auto k = static_cast<std::int64_t>(index);
  const std::uint64_t expected = readings.front().sequence + index;
  const std::int64_t even = *constants.first_ns + k * *constants.interval_ns;
  return {k, reading.output, static_cast<std::int64_t>(reading.sequence - expected),
          nanoseconds(reading.time_s) - origin_ns - even,
          temperature_steps(reading.temperature_degc, constants.temperature)};
}

/// Parameters by position, since there may be a million readings: ?1 is the dwell, the rest follow row by row
/// in the order of bind_reading().
std::string insert_readings(std::size_t rows) {
  std::string sql = "insert into reading(dwell, k, u, v, w, late_ns, temperature_steps) values";
  for (std::size_t row = 0; row < rows; ++row) sql += row == 0 ? "(?1,?,?,?,?,?,?)" : ",(?1,?,?,?,?,?,?)";
  return sql;
}

void bind_reading(SqliteStatement& statement, int first, const ReadingRow& row) {
  statement.bind(first, row.k)
      .bind(first + 1, row.output[0])
      .bind(first + 2, row.output[1])
      .bind(first + 3, row.output[2])
      .bind(first + 4, row.late_ns);
  if (const auto* steps = std::get_if<std::int64_t>(&row.temperature_steps)) {
    statement.bind(first + 5, *steps);
  } else if (const auto* degc = std::get_if<double>(&row.temperature_steps)) {
    statement.bind(first + 5, *degc);
  } else {
    statement.bind(first + 5, std::optional<double>());
  }
}

void write_readings(SqliteDatabase& database, std::int64_t dwell, std::span<const StoredReading> readings,
                    const ReadingConstants& constants, std::int64_t origin_ns) {
  DwellLink link(database, dwell);
  std::int64_t skipped = 0;
  for (std::size_t index = 0; index < readings.size();) {
    const std::size_t rows = std::min(kRowsAtOnce, readings.size() - index);
    SqliteStatement statement = database.prepare(insert_readings(rows));
    statement.bind(1, dwell);
    int position = 2;
    for (std::size_t row = 0; row < rows; ++row, ++index, position += kParametersOfRow) {
      const ReadingRow reading = row_of(readings, index, constants, origin_ns);
      bind_reading(statement, position, reading);
      link.add(reading);
      if (std::exchange(skipped, reading.skipped) == reading.skipped) continue;
      database.insert("reading_gap")
          .set("dwell", dwell)
          .set("k", reading.k)
          .set("skipped", reading.skipped)
          .run();
    }
    statement.run();
  }
  link.store();
}

std::optional<double> degrees(const std::optional<Angle>& angle) {
  return angle ? std::optional(angle->deg()) : std::nullopt;
}

/// ID of the row that was written last; nullopt: there is none.
std::optional<std::int64_t> last_id(SqliteDatabase& database, const char* table) {
  SqliteStatement last = database.prepare(fmt::format("select max(id) from {}", table));
  return last.step() ? last.optional_integer(0) : std::nullopt;
}

/// The role that a row gets: an angle that is there already is measured again for comparison only.
DwellRole role_of(SqliteDatabase& database, std::int64_t position, int item, const DwellRecord& dwell) {
  if (dwell.role == DwellRole::kReturn) return dwell.role;
  SqliteStatement before =
      database.prepare("select 1 from dwell where position = :position and item = :item");
  before.set("position", position).set("item", std::int64_t{item});
  if (before.step()) return DwellRole::kCheck;
  return dwell.closing ? DwellRole::kClosing : dwell.role;
}

/// Columns that all versions have alike, and those of version 5.
DwellRecord dwell_from(const SqliteStatement& row, bool of_version_5) {
  const auto angle = [&](std::string_view column) {
    const auto value = row.optional_real(column);
    return value ? std::optional(Angle::degrees(*value)) : std::nullopt;
  };
  const auto vector = [&](std::string_view u, std::string_view v, std::string_view w) {
    return Eigen::Vector3d(row.optional_real(u).value_or(kNotANumber),
                           row.optional_real(v).value_or(kNotANumber),
                           row.optional_real(w).value_or(kNotANumber));
  };
  DwellRecord dwell;
  dwell.experiment = static_cast<int>(row.integer("experiment"));
  dwell.n = static_cast<int>(row.integer("n"));
  dwell.closing = row.integer("closing") != 0;
  dwell.role = dwell.closing ? DwellRole::kClosing : DwellRole::kPlan;
  dwell.alpha = Angle::degrees(row.real("alpha_deg"));
  dwell.commanded_x = Angle::degrees(row.real("commanded_x_deg"));
  dwell.commanded_z = Angle::degrees(row.real("commanded_z_deg"));
  dwell.encoder_x = angle("encoder_x_deg");
  dwell.encoder_z = angle("encoder_z_deg");
  dwell.time_s = row.optional_real("time_s");
  dwell.settle_time_s = row.real("settle_s");
  dwell.count = row.integer("count");
  dwell.lost = row.integer("lost");
  dwell.mean = vector("r_u", "r_v", "r_w");
  dwell.spread = vector("spread_u", "spread_v", "spread_w");
  if (row.optional_real("u_u")) dwell.u_mean = vector("u_u", "u_v", "u_w");
  dwell.temperature_degc = row.optional_real("temperature_degc");
  dwell.flags = static_cast<std::uint32_t>(row.integer("flags"));
  if (!of_version_5) return dwell;
  dwell.face = static_cast<int>(row.integer("face"));
  if (const auto sweep = row.optional_integer("sweep"))
    dwell.motion = DwellMotion{static_cast<int>(*sweep), row.real("rate_deg_per_s"),
                               row.real("acceleration_deg_per_s2"), row.real("u_angle_deg")};
  return dwell;
}

std::vector<StoredReading> readings_from(SqliteStatement& rows) {
  std::vector<StoredReading> readings;
  const int sequence = rows.column("sequence"), time_s = rows.column("time_s");
  const int u = rows.column("u"), temperature = rows.column("temperature_degc");
  while (rows.step()) {
    StoredReading& reading = readings.emplace_back();
    reading.sequence = static_cast<std::uint64_t>(rows.integer(sequence));
    reading.time_s = rows.real(time_s);
    for (int j = 0; j < 3; ++j) reading.output[j] = rows.optional_real(u + j).value_or(kNotANumber);
    reading.temperature_degc = rows.optional_real(temperature);
  }
  rows.reset();
  return readings;
}

bool is_version_2(SqliteDatabase& database) {
  return run_file_version(database) < 3;
}

}  // namespace

std::optional<TemperatureScale> temperature_scale(std::span<const StoredReading> readings) {
  std::optional<TemperatureScale> scale;
  std::optional<int> lowest_bit;  // exponent of the lowest bit set in any of the values
  for (const StoredReading& reading : readings) {
    if (!reading.temperature_degc || !std::isfinite(*reading.temperature_degc)) continue;
    const double value = *reading.temperature_degc;
    if (!scale) scale = TemperatureScale{value, 1.0, true};
    if (value == 0.0) continue;
    int exponent = 0;
    const double mantissa = std::abs(std::ldexp(std::frexp(value, &exponent), kDoubleDigits));
    exponent += std::countr_zero(static_cast<std::uint64_t>(mantissa)) - kDoubleDigits;
    lowest_bit = std::min(lowest_bit.value_or(exponent), exponent);
  }
  if (!scale || !lowest_bit) return scale;
  scale->step_degc = std::ldexp(1.0, *lowest_bit);
  const double most = std::ldexp(1.0, kDoubleDigits);
  for (const StoredReading& reading : readings) {
    if (!reading.temperature_degc || !std::isfinite(*reading.temperature_degc)) continue;
    const double steps = (*reading.temperature_degc - scale->first_degc) / scale->step_degc;
    if (!(std::abs(steps) <= most)) return TemperatureScale{0.0, 1.0, false};
  }
  return scale;
}

void DwellWriter::write(std::int64_t position, const DwellRecord& dwell,
                        std::span<const StoredReading> readings, const Row& of_row) {
  const ReadingConstants constants = constants_of(readings, times_.origin_ns);
  std::optional<std::int64_t> time_ns;
  if (dwell.time_s && std::isfinite(*dwell.time_s)) time_ns = nanoseconds(*dwell.time_s) - times_.origin_ns;
  Insertion row = database_.insert("dwell");
  row.set("id", of_row.id)
      .set("position", position)
      .set("item", std::int64_t{of_row.item})
      .set("role", to_string(role_of(database_, position, of_row.item, dwell)))
      .set("session", times_.session)
      .set("experiment", std::int64_t{dwell.experiment})
      .set("n", std::int64_t{dwell.n})
      .set("closing", std::int64_t{dwell.closing})
      .set("alpha_deg", dwell.alpha.deg())
      .set("commanded_x_deg", dwell.commanded_x.deg())
      .set("commanded_z_deg", dwell.commanded_z.deg())
      .set("encoder_x_deg", degrees(dwell.encoder_x))
      .set("encoder_z_deg", degrees(dwell.encoder_z))
      .set("time_ns", time_ns)
      .set("time_s", dwell.time_s)
      .set("settle_s", dwell.settle_time_s)
      .set("count", dwell.count)
      .set("lost", dwell.lost)
      .set("temperature_degc", dwell.temperature_degc)
      .set("flags", std::int64_t{dwell.flags})
      .set("flag_words", describe_flags(dwell.flags).english())
      .set("first_sequence", constants.first_sequence)
      .set("first_reading_ns", constants.first_ns)
      .set("reading_interval_ns", constants.interval_ns);
  if (has_faces(database_)) {  // Files before version 5 lack these columns.
    const std::optional<DwellMotion>& motion = dwell.motion;
    row.set("face", std::int64_t{dwell.face})
        .set("sweep", motion ? std::optional<std::int64_t>(motion->sweep) : std::nullopt)
        .set("rate_deg_per_s", motion ? std::optional(motion->rate_deg_per_s) : std::nullopt)
        .set("acceleration_deg_per_s2",
             motion ? std::optional(motion->acceleration_deg_per_s2) : std::nullopt)
        .set("u_angle_deg", motion ? std::optional(motion->u_angle_deg) : std::nullopt);
  }
  if (links_all(database_))
    row.set("event", last_id(database_, "event")).set("environment", last_id(database_, "environment"));
  if (times_.begun && time_ns) row.set("utc", format_utc(*times_.begun + Clock::Duration(*time_ns)));
  const auto& scale = constants.temperature;
  row.set("first_temperature_degc", scale ? std::optional(scale->first_degc) : std::nullopt)
      .set("temperature_step_degc", scale ? std::optional(scale->step_degc) : std::nullopt);
  for (int j = 0; j < 3; ++j) {
    const std::string output(kOutputNames[j]);
    row.set("r_" + output, dwell.mean[j]).set("spread_" + output, dwell.spread[j]);
    row.set("u_" + output, dwell.u_mean ? std::optional((*dwell.u_mean)[j]) : std::nullopt);
  }
  row.run();
  const std::int64_t written = database_.last_row_id();
  for (std::size_t k = 0; k < of_row.encoder.size(); ++k) {
    database_.insert("encoder_sample")
        .set("dwell", written)
        .set("k", static_cast<std::int64_t>(k))
        .set("time_ns", nanoseconds(of_row.encoder[k].time_s) - times_.origin_ns)
        .set("angle_deg", of_row.encoder[k].angle_deg)
        .run();
  }
  write_readings(database_, written, readings, constants, times_.origin_ns);
}

void read_counting_dwells(SqliteDatabase& database, int item,
                          const std::function<void(std::size_t, DwellRecord)>& each) {
  const bool version_2 = is_version_2(database);
  const bool with_face = has_faces(database);
  SqliteStatement rows = database.prepare(
      version_2 ? "select * from dwell where id in (select min(id) from dwell group by position) order by id"
                : "select * from dwell where item = :item and id in"
                  " (select min(id) from dwell where item = :item group by position) order by id");
  if (!version_2) rows.set("item", std::int64_t{item});
  while (rows.step()) {
    DwellRecord dwell = dwell_from(rows, with_face);
    if (!version_2) dwell.role = dwell_role_from(rows.text("role")).value_or(dwell.role);
    each(static_cast<std::size_t>(rows.integer("position")), std::move(dwell));
  }
}

void read_all_dwells(SqliteDatabase& database, const std::function<void(const StoredDwell&)>& each,
                     int item) {
  const bool version_2 = is_version_2(database);
  const bool with_face = has_faces(database);
  SqliteStatement dwells = database.prepare(
      version_2 ? "select *, 1 as item, id not in (select min(id) from dwell group by position) as again"
                  " from dwell order by id"
                : "select *, id not in (select min(id) from dwell group by position, item) as again"
                  " from dwell order by id");
  const bool has_gaps =
      !has_reading_gaps(database) || database.value("select 1 from reading_gap limit 1").has_value();
  SqliteStatement readings = database.prepare(
      version_2
          ? "select sequence, time_s, u, v, w, temperature_degc from reading where dwell = :dwell order by k"
      : has_gaps
          ? "select sequence, time_s, u, v, w, temperature_degc from timed_reading where dwell = :dwell"
            " order by k"
          // timed_reading of a run without gaps: the view looks for them at each reading.
          : "select d.first_sequence + r.k as sequence, (s.origin_ns + d.first_reading_ns + r.k *"
            " d.reading_interval_ns + r.late_ns) / 1e9 as time_s, r.u, r.v, r.w,"
            " d.first_temperature_degc + r.temperature_steps * d.temperature_step_degc as"
            " temperature_degc from reading r join dwell d on d.id = r.dwell join session s on"
            " s.id = d.session where r.dwell = :dwell order by r.k");
  while (dwells.step()) {
    StoredDwell dwell;
    dwell.item = static_cast<int>(dwells.integer("item"));
    if (item != 0 && dwell.item != item) continue;
    dwell.plan_position = static_cast<std::size_t>(dwells.integer("position"));
    dwell.experiment = static_cast<int>(dwells.integer("experiment"));
    dwell.n = static_cast<int>(dwells.integer("n"));
    dwell.closing = dwells.integer("closing") != 0;
    if (with_face) dwell.face = static_cast<int>(dwells.integer("face"));
    dwell.alpha = Angle::degrees(dwells.real("alpha_deg"));
    dwell.repeat = dwells.integer("again") != 0;
    readings.set("dwell", dwells.integer("id"));
    dwell.readings = readings_from(readings);
    each(dwell);
  }
}

DwellWithReadings read_dwell_of_version_2(SqliteDatabase& database, std::int64_t id) {
  SqliteStatement row = database.prepare("select * from dwell_2 where id = :id");
  row.set("id", id);
  row.step();
  SqliteStatement readings = database.prepare(
      "select sequence, time_s, u, v, w, temperature_degc from reading_2 where dwell = :dwell order by k");
  readings.set("dwell", id);
  return {dwell_from(row, false), readings_from(readings)};
}

}  // namespace abcal
