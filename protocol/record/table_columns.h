#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/record/table_reader.h"

namespace abcal {

/// Statements about a table that it does not make itself; empty: none.
struct TableOptions {
  /// Names of the columns in their order, in place of a header: "t,x,y,z". "-" and columns beyond the last
  /// name are ignored.
  std::string columns;
  std::string unit;       ///< Unit of the readings: "g", "m/s2", "LSB".
  std::string time_unit;  ///< "s", "ms", "us" or "ns".
  std::string topic;      ///< The one to be read of a log with several.
  bool keep = false;      ///< These are to be kept in a file beside the table (table_mapping.h).
  /// Who states the columns and the unit of time, in messages.
  std::string columns_by = "--columns", time_unit_by = "--time-unit";

  bool is_empty() const {
    return columns.empty() && unit.empty() && time_unit.empty() && topic.empty() && !keep;
  }
};

enum class TableKind {
  kCircles,     ///< Averaged readings at the angles of the three experiments.
  kPoses,       ///< Each row is a pose, or one of several rows at a pose.
  kTimeSeries,  ///< Each row is a reading with its time.
};

/// The columns of a table under the names that abcal has for them: `experiment`, `n`, `alpha_deg`, `r_u`,
/// `u_u`, `time_s` (of an average), `t` (of a reading) ...
struct TableColumns {
  TableKind kind = TableKind::kPoses;
  std::map<std::string, std::size_t, std::less<>> place;
  std::string unit, time_unit;       ///< As the header states them; empty: it does not.
  std::vector<std::string> ignored;  ///< Names as they stand in the header.
  std::string readings;              ///< Names of the three columns of readings.

  bool has(std::string_view name) const { return place.contains(name); }
};

/// Finds the columns from the header, from `options.columns`, or from the number of columns. The names of
/// other programs are known too: time, timestamp; ax, acc_x, "Accel X (m/s^2)", x. Reads the header; the row
/// that is none is put back.
/// @throws TableError  columns that cannot be told
TableColumns find_columns(TableReader& table, const TableOptions& options, TableProblems& problems);

}  // namespace abcal
