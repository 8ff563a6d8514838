#pragma once

#include <Eigen/Core>
#include <limits>
#include <span>

#include "drivers/instrument/angle.h"
#include "protocol/estimators/shared/unusable_data.h"

namespace abcal {

/// The angles do not determine the coefficients asked for. what() is one sentence: found, required.
class UndeterminedFit : public UnusableData {
 public:
  using UnusableData::UnusableData;
};

/// constant + sum over k = 1..harmonics of S_k sin(k alpha) + C_k cos(k alpha), fitted by least squares.
/// Coefficients, in every vector and matrix below: constant, S_1, C_1, S_2, C_2, ... (2 harmonics + 1 of
/// them), then those of the further columns.
struct HarmonicFit {
  int harmonics = 0;
  Eigen::MatrixXd design;        ///< One row for each reading, one column for each coefficient.
  Eigen::VectorXd coefficients;  ///< In the unit of the readings (R).
  /// coefficients = estimator * readings: one row for each coefficient, one column for each reading.
  Eigen::MatrixXd estimator;
  /// (A' W A)^-1, from the R factor. The covariance of the coefficients where the fit is weighted with 1/u^2;
  /// else to be multiplied by the variance of a reading.
  Eigen::MatrixXd cofactor;
  Eigen::VectorXd residuals;          ///< Reading minus fit (R), not weighted.
  double residual_sum_squares = 0.0;  ///< Weighted: chi2; else sum of the squares in R^2.
  bool weighted = false;
  int rank = 0;
  /// Smallest over largest singular value of the weighted design with its columns scaled to length 1: 1 is
  /// best.
  double reciprocal_condition = 0.0;

  int degrees_of_freedom() const { return static_cast<int>(residuals.size() - coefficients.size()); }
};

/// Least squares by QR with column pivoting, at any angles: any N and steps, incomplete circles and unequal
/// weights are permitted (the orthogonality of a uniform full circle is not used). Paper, Eq. 6: A =
/// S_1, B = C_1, C = constant; one harmonic, or five as a diagnostic (11 coefficients).
/// @param alpha      desired rotation angles
/// @param readings   one for each angle (R)
/// @param u          standard uncertainty of each reading (R), > 0; empty: equal weights
/// @param harmonics  1 or more
/// @param further    columns of the design beside the harmonics, one row for each reading; columns of zeros
///                   alone are left out
/// @throws UndeterminedFit       fewer distinct angles (modulo 360 degrees) than coefficients, or a
///                               reciprocal condition below 1e-8 (the square root of the rounding unit:
///                               fewer than half of the digits of a reading would be left)
/// @throws std::invalid_argument sizes differ, or a number is not finite, or an uncertainty is not > 0
HarmonicFit fit_harmonics(std::span<const Angle> alpha, std::span<const double> readings,
                          std::span<const double> u, int harmonics, const Eigen::MatrixXd& further = {});

/// Columns of the fit to the sweeps of one circle at constant rates, so that constant and harmonics are those
/// of an item at rest: what the elements' places add (rate squared), the loss of amplitude of a low-pass
/// (rate squared, times the sine) and its delay (rate, times the derivative of the sine). Sweeps at two rates
/// determine them.
/// @param of_sine      a fit whose first harmonic is the sine: at first that without these columns
/// @param rate_radps  of each reading, with its sign
Eigen::MatrixXd columns_of_motion(const HarmonicFit& of_sine, std::span<const double> rate_radps);

}  // namespace abcal
