#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "protocol/estimators/circle/first_order.h"
#include "protocol/estimators/circle/harmonic_fit.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/limits.h"

namespace abcal {

/// Deviation, in standard uncertainties, above which a diagnostic contradicts the model. A run has some 70
/// diagnostics (15 closures, 9 residuals, 36 harmonics, 9 closing differences); at 1e-6 each, seven in
/// 100 000 sound runs are called doubtful.
inline constexpr double kContradictionLevel = kFalseAlarmDeviate;

/// The readings of one accelerometer in one experiment.
struct ReadingSeries {
  int experiment = 0;     ///< 1, 2, 3
  int accelerometer = 0;  ///< 0, 1, 2 = u, v, w
  /// Where the reading is taken in face 1, or would be to see the same gravity (angle_in_face_1()).
  std::vector<Angle> alpha;
  std::vector<double> readings;    ///< R
  std::vector<double> u;           ///< Standard uncertainty of each (R); empty: not known.
  std::vector<double> rate_radps;  ///< Rate of the axis at each; empty: the stage was at rest.
  Eigen::MatrixXd by_motion;       ///< Columns of its fits beside the harmonics; empty: at rest.
  /// For each reading triple in use (of all experiments): its place in this series, or -1.
  std::vector<int> place_of;
};

/// Change of a fit's coefficients for a change of the input by one unit (first order).
Eigen::VectorXd effect_on_fit(const InputEffect& effect, const ReadingSeries& series, const HarmonicFit& fit);

/// Whether a fit leaves larger residuals than the readings' uncertainty and the tolerances explain.
struct ResidualTest {
  double expected_rms = 0.0;  ///< sqrt(expected sum of squares / readings), R.
  /// Standard normal deviate of the sum of squares found (Wilson and Hilferty, with the degrees of freedom of
  /// Satterthwaite); above kContradictionLevel the residuals are not explained. 0 where there is no
  /// redundancy.
  double deviate = 0.0;
};

/// E[sum of squares] = trace((I - H) V (I - H)'), V the variance of the readings: their own u, the
/// resolution, and the effects. Round-off of the readings (1e-15 of the largest) is part of it. A series
/// without u gives a deviate of 0: the noise is then only known from these very residuals.
ResidualTest test_residuals(const ReadingSeries& series, const HarmonicFit& fit,
                            const std::vector<InputEffect>& effects, double resolution);

}  // namespace abcal
