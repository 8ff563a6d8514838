#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/series_leg.h"

namespace abcal {

/// One point of a series: a run at one temperature. Outputs in the order of Covariance9: s_u, s_v, s_w
/// (R/g_loc), phi_uv, phi_vw, phi_wu (degree), O_u, O_v, O_w (R).
struct TemperaturePoint {
  int number = 0;  ///< Number in the series, from 1.
  SeriesLeg leg = SeriesLeg::kUp;
  double set_degc = 0.0;
  double temperature_degc = 0.0;  ///< Abscissa: the item's own sensor, mean over the run.
  bool by_item = true;            ///< False: the item has no sensor, and it is the set point.
  double change_k = 0.0;          ///< Change of that sensor from the first to the last angle of the run.
  Eigen::Matrix<double, 9, 1> value;
  Covariance9 own;     ///< Covariance from the scatter of this point's readings (type A).
  Covariance9 shared;  ///< Covariance from stage and effects, the same at every point (type B).
  Verdict verdict = Verdict::kUsable;
  /// Stage errors from this run alone: Zx, Zy, Xz (1), d2, d3 (degree). Absent if the estimator gives none.
  std::optional<std::array<Quantity, 5>> stage;
};

/// A polynomial of one output over (T - T0), fitted by generalised least squares: every point has its own
/// uncertainty, and the uncertainty that all points share is one common unknown shift.
struct TemperaturePolynomial {
  std::string name;  ///< "s_u", "phi_uv", "O_w"
  std::string unit;
  int order = 0;
  std::vector<double> coefficient;  ///< Unit / K^n, n = 0 ... order.
  Eigen::MatrixXd covariance;       ///< Covariance of the coefficients.
  /// Likelihood ratio of each step up to this order, and of the next step if it was rejected.
  std::vector<double> likelihood_ratio;
  std::vector<double> residual;  ///< One for each point, unit.
  double residual_rms = 0.0, residual_max = 0.0;
  /// Scatter of the points about the polynomial that their own uncertainty does not explain (hysteresis, lag,
  /// instability); it is in the covariance. Unit.
  double excess = 0.0;
  double chi2 = 0.0;  ///< Without the excess.
  int degrees_of_freedom = 0;
  /// The part of the covariance due to the excess, which is estimated from the scatter alone.
  Eigen::MatrixXd excess_covariance;

  double at(double from_t0) const;
  double standard_uncertainty_at(double from_t0) const;
  double slope_at(double from_t0) const;
  /// Effective degrees of freedom (JCGM 100, G.4.1) of the uncertainty of a sum of coefficients with these
  /// weights; infinite where there is no excess.
  double degrees_of_freedom_of(const Eigen::VectorXd& weights) const;
};

/// Temperature coefficients of an output as in data sheets, per kelvin, by three methods. Where no order
/// above 0 is significant, those of a straight line, which have an uncertainty.
struct TemperatureCoefficient {
  std::string name;
  std::string unit;                                       ///< "ppm/K", "ug/K", "urad/K"
  double at_reference = 0.0, standard_uncertainty = 0.0;  ///< Slope of the polynomial at T0.
  double degrees_of_freedom = 0.0;                        ///< Effective, of that uncertainty.
  double box = 0.0;                                       ///< (largest - smallest) / range of temperature.
  double box_uncertainty = 0.0, box_degrees_of_freedom = 0.0;
  double end_point = 0.0;  ///< Difference of both ends / range of temperature.
  double end_point_uncertainty = 0.0, end_point_degrees_of_freedom = 0.0;
};

/// Difference of one output between the ways up and down, at equal temperature of the item.
struct TemperatureHysteresis {
  std::string name, unit;
  double largest = 0.0;  ///< up - down, with its sign.
  double standard_uncertainty = 0.0;
  double at_degc = 0.0;
  double closure = 0.0;  ///< Last point minus first one, both at the reference.
  double closure_uncertainty = 0.0;
  bool has_closure = false, has_both_ways = false;
};

/// A constant of the stage, which the joint fit of each run estimates separately, over the item's
/// temperature: the straight line of least squares. The uncertainty that all points share assumes the same
/// stage at every point; this trend shows whether it is.
struct StageTrend {
  std::string name, unit;                          ///< "Zx", "1"; "d2", "degree"
  double slope = 0.0, standard_uncertainty = 0.0;  ///< Unit / K; type A, with the scatter of the points.
  double probability = 1.0;                        ///< P(slope as large) if there is none.
  bool constant() const;
};

struct TemperatureResult {
  double reference_degc = 23.0;
  double least_degc = 0.0, most_degc = 0.0;  ///< Range of the item's sensor in which the polynomials hold.
  std::vector<TemperaturePoint> points;
  std::vector<TemperaturePolynomial> polynomials;    ///< 9, in the order of the outputs.
  std::vector<TemperatureCoefficient> coefficients;  ///< 9
  std::vector<TemperatureHysteresis> hysteresis;     ///< 9
  std::vector<StageTrend> stage;  ///< 5, or none without stage estimates of at least 4 points.

  /// Whether every temperature is from the item's own sensor.
  bool by_item() const;
  /// Reasons why the result is doubtful; empty: it is usable.
  std::vector<std::string> reasons() const;
  bool usable() const { return reasons().empty(); }
};

/// Largest order that is tried.
inline constexpr int kMostTemperatureOrder = 4;

/// @throws std::invalid_argument for fewer than two temperatures
TemperatureResult fit_temperature(std::vector<TemperaturePoint> points, double reference_degc,
                                  const std::string& response_unit);

/// One run of a series as a point; `number`, `leg` and temperatures are the caller's.
/// @throws std::invalid_argument for a result without covariance
TemperaturePoint temperature_point(const CalibrationResult& result);

}  // namespace abcal
