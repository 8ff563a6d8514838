#pragma once

#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// The numbers that Geist & Gaitan (J. Res. NIST 126, 126038, 2021) print, as they print them (but for Table
/// 8, whose rows "s" and "O" are interchanged in print and put right here; docs/reproduction.md, error 1).
/// Entries are known to half a unit of the fourth digit; entries that are not printed are NaN.
const StudyOutput& published_table_2();  ///< The accelerometer itself, 15 decimals.
const StudyOutput& published_table_3_and_4_mean();
const StudyOutput& published_table_3_and_4_standard_deviation();
const StudyOutput& published_table_5();
const StudyOutput& published_table_6();
const StudyOutput& published_table_7();
const StudyOutput& published_table_8();

/// Section 5's upper bounds of the type B standard uncertainty, read as the abstract means them
/// (docs/reproduction.md, errors 5 and 6): relative to the norm S of the row, 2e-5 S on the diagonal,
/// 2e-4 S off it, 1e-5 S for the intrinsic sensitivities, 5e-5 S for the offsets; 5e-3 degrees for the
/// angles.
/// @throws std::invalid_argument for a matrix that is not finite
StudyOutput published_bounds(const Eigen::Matrix3d& sensitivity_matrix);

}  // namespace abcal
