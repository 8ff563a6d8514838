#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/quantities/quantity_groups.h"

namespace abcal {

/// Axes of corrected readings.
enum class ExportFrame {
  /// The item's own: x along the axis of u, y in the plane of u and v. Free of how it was mounted.
  kItem,
  kPlatter,  ///< The platter's at the default orientation: the mounting of the item is corrected too.
};

/// The white noise of the readings of a run.
struct ReadingNoise {
  double density = 0.0;  ///< Worst output, in units of the response over root hertz.
  double rate_hz = 0.0;
  double tau_s = 0.0;  ///< Averaging time of the Allan deviation that it comes from.
};

/// M = g_loc S^-1 of a = M (r - b), with its derivatives.
struct CorrectionMatrix {
  Eigen::Matrix3d M;  ///< m/s2 per response unit
  /// Rows: M row by row. Columns: S row by row (R/g_loc), g_loc (m/s2).
  Eigen::Matrix<double, 9, 10> derivatives;
};

/// @param S  sensitivity, R/g_loc  @param g_loc_mps2  local gravity
/// @throws std::invalid_argument  outputs that do not determine an acceleration: S is singular
CorrectionMatrix correction_matrix(const Eigen::Matrix3d& S, double g_loc_mps2);

/// Constants that turn readings into accelerations: a = M (r - b).
struct CorrectionConstants {
  Eigen::Matrix3d M = Eigen::Matrix3d::Identity();  ///< m/s2 per response unit
  Eigen::Vector3d b = Eigen::Vector3d::Zero();      ///< Response unit
  /// Covariance of the elements of M, row by row, and of b; the uncertainty of local gravity is part of it.
  Covariance12 covariance = Covariance12::Zero();
  std::string response_unit;
  /// One response unit of the instrument in m/s2; absent: its output is no acceleration (V, LSB).
  std::optional<double> unit_mps2;
  double g_loc_mps2 = 9.80665;
  ExportFrame frame = ExportFrame::kItem;
  std::optional<ReadingNoise> noise;
  std::optional<double> full_scale;  ///< Largest magnitude of a reading; response unit.

  std::vector<NamedQuantity> outputs;  ///< Every output of the result, sensitivities per g_loc.

  // For the heading of a file.
  std::string item;       ///< Maker, model, serial number.
  std::string source;     ///< Run file and estimator.
  std::string performed;  ///< UTC; empty: not known.
  std::string verdict;    ///< "usable"

  /// Standard uncertainties of the elements of M, and of b.
  Eigen::Matrix3d u_matrix() const;
  Eigen::Vector3d u_b() const;
  /// M and b for a reader of m/s2: dimensionless and m/s2.
  /// @throws std::invalid_argument where the output is no acceleration
  Eigen::Matrix3d matrix_si() const;
  Eigen::Vector3d bias_si() const;
  /// Largest error at 1 g in any direction that remains after correcting scales and offsets only: the norm of
  /// the largest row of off-diagonal elements, m/s2.
  double diagonal_remainder_mps2() const;
};

/// Sensitivity in the item's own axes (x along the axis of u, y in the plane of u and v): lower triangular,
/// with the norms and angles of the rows.
/// @param sensitivity  u, v, w; R/g_loc  @param angle_deg  uv, vw, wu
/// @throws std::invalid_argument  axes in one plane
Eigen::Matrix3d sensitivity_in_own_axes(const Eigen::Vector3d& sensitivity, const Eigen::Vector3d& angle_deg);

/// The constants of a result with numbers.
/// @throws std::invalid_argument a result that is not usable, one without g_loc, a frame that it does not
/// have (norm has no platter)
CorrectionConstants constants_of(const CalibrationResult& result, ExportFrame frame);

}  // namespace abcal
