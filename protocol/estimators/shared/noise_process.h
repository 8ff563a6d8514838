#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

namespace abcal {

/// Noise from angle to angle: each output has a white part and an Ornstein-Uhlenbeck process, stationary with
/// the standard deviation tau and the correlation exp(-d / rho) at a distance of d angles; rho much larger
/// than the run is a random walk.
struct NoiseProcess {
  Eigen::Vector3d tau = Eigen::Vector3d::Zero();  ///< In the unit of the readings; 0: white only.
  double rho = 1.0;                               ///< Correlation length, in angles.
};

/// Noise and step error at one angle.
struct NoiseAtAngle {
  Eigen::Vector3d white;    ///< Variances of the outputs' white noise.
  Eigen::Vector3d by_step;  ///< Derivative of the outputs by the step error that they share (per radian).
  double distance = 1.0;    ///< Distance from the angle before, in angles.
};

/// One angle of the whitening filter.
struct WhitenerStep {
  Eigen::Matrix3d lower_inverse;  ///< Inverse Cholesky factor of the innovation's covariance.
  Eigen::Matrix3d gain = Eigen::Matrix3d::Zero();  ///< Change of the process by the innovation.
  double decay = 0.0;                              ///< Decay of the process to the next angle.
};

/// Rows: angle by angle u, v, w. Row-major, so that the three rows of an angle are read in one go.
using ReadingRows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// The covariance V of all readings of a run (white noise, step errors without memory, process), as the
/// operator that whitens them: V^-1 = L' L. The process is Markov, so L is a Kalman filter, and everything
/// here costs a time linear in the number of angles.
class NoiseWhitener {
 public:
  /// @param step  standard deviation of the step errors without memory (radian)
  NoiseWhitener(const std::vector<NoiseAtAngle>& angles, double step, const NoiseProcess& process);

  /// L X, in place.
  void whiten(ReadingRows& rows) const;
  /// L' X, in place: whiten() and then this give V^-1 X.
  void whiten_transposed(ReadingRows& rows) const;
  std::span<const WhitenerStep> steps() const { return at_; }
  bool white() const { return white_; }  ///< No process: the filter has no state.
  /// log det V.
  double log_determinant() const { return log_determinant_; }
  /// Covariance of every reading of each output with that output's mean of the process over the run.
  /// Column j holds that of output j; the mean's own variance in `mean_variance`.
  ReadingRows covariance_with_mean() const;
  Eigen::Vector3d mean_variance() const { return mean_variance_; }

 private:
  std::vector<WhitenerStep> at_;
  bool white_ = true;
  double log_determinant_ = 0.0;
  Eigen::Vector3d tau_;
  Eigen::VectorXd mean_correlation_;  ///< Covariance of a reading with the mean for tau = 1.
  Eigen::Vector3d mean_variance_;
};

}  // namespace abcal
