#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "protocol/record/table_columns.h"

namespace abcal {

/// The cells of one row after another, by the names of their columns. What is wrong with a cell becomes a
/// problem, and the cell has no value.
class TableCells {
 public:
  /// @param table, columns, problems  must outlive this
  TableCells(TableReader& table, const TableColumns& columns, TableProblems& problems)
      : table_(table), columns_(columns), problems_(problems) {}

  bool next() { return table_.next(row_); }
  std::size_t line() const { return row_.line; }
  /// Whether the table has the column, and the row something in it.
  bool has(std::string_view name) const { return columns_.has(name) && !text(name).empty(); }
  const std::string& text(std::string_view name) const {
    return row_.cells[columns_.place.find(name)->second];
  }

  void problem(std::string_view name, std::string found, std::string required);
  /// A finite number.
  std::optional<double> number(std::string_view name, const char* required = "a number");
  /// Absent without a problem if the cell is empty or the table has no such column.
  std::optional<double> optional_number(std::string_view name);
  std::optional<std::int64_t> whole_number(std::string_view name, double lowest, double highest,
                                           const char* required);
  /// r_u, r_v, r_w; NaN where they have no value.
  Eigen::Vector3d readings();
  /// Upwards in the axes of the mount, of length 1, from up_x..z, pose_roll_deg and pose_pitch_deg, or
  /// pose_qw..z; absent where the table has none of them, or with a problem.
  std::optional<Eigen::Vector3d> up();
  /// u_u, u_v, u_w: all three or none.
  std::optional<Eigen::Vector3d> uncertainties();

 private:
  TableReader& table_;
  const TableColumns& columns_;
  TableProblems& problems_;
  TableRow row_;
};

}  // namespace abcal
