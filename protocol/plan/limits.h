#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/angle.h"
#include "protocol/plan/tolerances.h"

namespace abcal {

/// Limits beyond which the program reports a number (`[limits]` of a bench file). Absent limits follow from
/// the tolerances and the readings' noise.
struct LimitsConfig {
  // While it measures.
  double max_lost_fraction = 0.5;  ///< More readings than this lost at one angle stops the run.
  double temperature_min_degc = -1e9;
  double temperature_max_degc = +1e9;
  int max_replugs = 3;                            ///< A port that vanishes once more than this stops the run.
  std::optional<double> temperature_change_degc;  ///< Largest distance from the first angle's temperature.
  double temperature_wait_s = 3600.0;  ///< Longest wait for the temperature to be back; 0: only flagged.
  double spread_factor = 3.0;          ///< Spread above this multiple of the median spread is vibration.
  int repeats = 3;             ///< How often a shaken angle, or one that the axis leaves, is measured again.
  double norm_fraction = 0.2;  ///< Relative distance of the norm of the readings, with offsets, from gravity.
  std::optional<double> stability;       ///< Before the first angle: change of the outputs, over their norm.
  std::optional<double> stability_degc;  ///< Before the first angle: change of the temperature.
  // In the analysis.
  Angle mounting = Angle::degrees(45.0);  ///< Between an output's direction and the one it should have.
  std::optional<Angle> slip;              ///< A lasting turn of the accelerometer, or of an axis.
  std::optional<Angle> angle;             ///< Error of one angle.
  std::optional<double> drift;            ///< Change of an output, over the run or at once; relative to the
                                          ///< sensitivity.

  bool operator==(const LimitsConfig&) const = default;
};

/// Expected properties of the accelerometer (`[item]` of a bench file); a result that differs is called
/// doubtful.
struct ExpectedItem {
  /// R for 9.80665 m/s2. Absent: from the response unit (g, m/s2), otherwise unknown.
  std::optional<double> nominal_sensitivity;
  double sensitivity_tolerance = 0.005;  ///< Largest relative difference from it.
  std::string mounting = "x y z";        ///< Along which axes u, v, w point at the default orientation.

  bool operator==(const ExpectedItem&) const = default;
};

/// Rate at which a check of a sound bench fails, where its limit follows from tolerances and noise.
inline constexpr double kFalseAlarm = 1e-6;
/// In standard uncertainties: a normal variable is farther from its mean, on either side, once in 1e6 (the
/// quantile of the standard normal distribution for 1 - kFalseAlarm / 2).
inline constexpr double kFalseAlarmDeviate = 4.891638;

/// m/s2, exact by definition (CGPM 1901): the unit g, in which instruments report.
inline constexpr double kStandardGravity = 9.80665;

/// A turn that occurred once: each of both positions may be off by the tolerance of a zero or of a turn.
Angle slip_limit(const LimitsConfig& limits, const Tolerances& tolerances);
/// An angle and its step error.
Angle angle_limit(const LimitsConfig& limits, const Tolerances& tolerances);
/// Relative to the sensitivity.
double drift_limit(const LimitsConfig& limits, const Tolerances& tolerances);
/// Sudden relative change of a sensitivity: the same as its largest drift over the run.
double gain_limit(const Tolerances& tolerances);
/// The change of temperature that makes an accelerometer drift as far as it may, at the temperature
/// coefficient of usual ones: 1e-4 of the sensitivity (0.1 mg at 1 g) for each kelvin.
double temperature_change_limit_degc(const LimitsConfig& limits, const Tolerances& tolerances);

/// Before the first angle, outputs (relative) and temperature must stay within these, as far as one may
/// drift.
double stability_limit(const LimitsConfig& limits, const Tolerances& tolerances);
double stability_limit_degc(const LimitsConfig& limits, const Tolerances& tolerances);

/// R for one g_loc, if the bench file or the unit determines it; absent: not known.
std::optional<double> nominal_response(const ExpectedItem& item, std::string_view response_unit,
                                       double g_loc_mps2);

/// The directions of u, v, w at the default orientation, as rows: of a signed permutation, "x y z" or
/// "-y x z"; or of a rotation, nine numbers row by row (to about three digits). Nullopt if it is neither.
std::optional<Eigen::Matrix3d> mounting_matrix(std::string_view mounting);

}  // namespace abcal
