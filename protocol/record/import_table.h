#pragma once

#include <cstddef>
#include <filesystem>
#include <istream>
#include <string>
#include <vector>

#include "protocol/record/run_record.h"
#include "protocol/record/static_stretches.h"
#include "protocol/record/table_columns.h"

namespace abcal {

/// A table of readings as a record of a run, of which nothing but the readings is known.
struct ImportedTable {
  /// Its estimator is the stated one, else `joint` with angles and `norm` without.
  RunRecord record;
  TableKind kind = TableKind::kPoses;
  std::size_t rows = 0;                  ///< Rows that were used.
  std::vector<StaticStretch> stretches;  ///< Those of a time series.
};

/// Reads any table of readings; its header, or `options`, decides what it is (docs/your_file.md):
///
/// Averages at the angles of the three experiments: `experiment,n,alpha_deg,r_u,r_v,r_w`, optional columns
/// `u_u,u_v,u_w` (standard uncertainty of each mean, R), `time_s`, `count`, `temperature_degc`, `flags` (bits
/// of DwellFlag), `face` and `closing` (0 or 1). Without a column `closing`, an alpha of 360 degrees is the
/// closing angle if the same experiment has an alpha of 0. Missing angles are allowed: the analysis reports
/// whether the rest determines the fit. Encoder angles are absent.
///
/// Poses: three columns of readings, and `u_u,u_v,u_w`, `time_s`, `count` optional. Where these are absent
/// and most rows differ from the row before far less than the others do, neighbouring rows of one direction
/// are one pose.
///
/// Poses of known directions have the columns up_x..z (upwards in the axes of the mount), pose_roll_deg and
/// pose_pitch_deg (R = Rz Ry Rx, z upwards), or pose_qw..z (from the mount to axes with z upwards), and the
/// comment `pose_uncertainty_deg`.
///
/// A time series: a column of time, and three of readings. Its poses are the stretches at rest. Rows whose
/// time does not come after that of the row before are left out.
///
/// Effects of the item that a table without angles does not state are left out of its fit. The dwells of such
/// a table have experiment 0 (has_angles()), and the lines of their rows. At most 4e6 rows are read, and
/// 1e5 averages.
/// @throws TableError with every problem
/// @throws std::runtime_error the file cannot be read
ImportedTable import_table(const std::filesystem::path& path, const TableOptions& options = {});

/// As import_table(path), from a stream; `source` names it in messages.
ImportedTable import_table(std::istream& input, const std::string& source, const TableOptions& options = {},
                           const StaticSearch& search = {});

}  // namespace abcal
