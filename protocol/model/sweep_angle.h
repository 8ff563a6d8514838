#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>

namespace abcal {

/// Position of an axis at a time with an arbitrary zero.
struct AngleAtTime {
  double time_s = 0.0;
  double angle_deg = 0.0;
};

/// The angle of an axis that turns at a constant rate, as a function of time: a line, and a ripple of the
/// orders 1 to 6 of the turn.
class SweepAngle {
 public:
  static constexpr int kOrders = 6;
  using Coefficients = Eigen::Matrix<double, 2 + 2 * kOrders, 1>;

  /// @param coefficients  angle (degree) at `middle_s`, rate (degree/s), then sine and cosine of each order
  /// (degree)
  SweepAngle(double middle_s, const Coefficients& coefficients, double rms_deg, std::size_t samples)
      : middle_s_(middle_s), coefficients_(coefficients), rms_deg_(rms_deg), samples_(samples) {}

  double angle_deg(double time_s) const;
  double rate_deg_per_s(double time_s) const;
  double acceleration_deg_per_s2(double time_s) const;
  double mean_rate_deg_per_s() const { return coefficients_(1); }
  double rms_deg() const { return rms_deg_; }  ///< Scatter of one sample about the function.
  /// Standard uncertainty of the function, of the mean and of each part of its course alike.
  double u_deg() const;

 private:
  double phase_rad(double time_s) const;

  double middle_s_;
  Coefficients coefficients_;
  double rms_deg_;
  std::size_t samples_;
};

/// Fits the samples of one sweep by least squares; the ripple has a prior of 0.2/order % of the rate, so that
/// a scatter of the samples' times is not taken for it (docs/constant_rate.md).
/// @return nothing for fewer than 24 samples, or samples of one time
std::optional<SweepAngle> fit_sweep_angle(std::span<const AngleAtTime> samples);

}  // namespace abcal
