#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "drivers/instrument/clock.h"

namespace abcal {

/// Where an encoder said that its axis was, in the middle between the question and its answer.
struct AngleSample {
  Clock::Instant at;
  double angle_deg = 0.0;
};

/// The angle of an axis that turns at a constant rate, as a function of time: a line, and a ripple of the
/// orders 1 to 6 of the turn.
class SweepAngle {
 public:
  static constexpr int kOrders = 6;
  using Coefficients = Eigen::Matrix<double, 2 + 2 * kOrders, 1>;

  /// @param coefficients  angle (degree) at `middle`, rate (degree/s), then sine and cosine of each order
  /// (degree)
  SweepAngle(Clock::Instant middle, const Coefficients& coefficients, double rms_deg, std::size_t samples)
      : middle_(middle), coefficients_(coefficients), rms_deg_(rms_deg), samples_(samples) {}

  double angle_deg(Clock::Instant at) const;
  double rate_deg_per_s(Clock::Instant at) const;
  double acceleration_deg_per_s2(Clock::Instant at) const;
  double mean_rate_deg_per_s() const { return coefficients_(1); }
  double rms_deg() const { return rms_deg_; }  ///< Scatter of one sample about the function.
  /// Standard uncertainty of the function, of the mean and of each part of its course alike.
  double u_deg() const;

 private:
  double phase_rad(Clock::Instant at) const;

  Clock::Instant middle_;
  Coefficients coefficients_;
  double rms_deg_;
  std::size_t samples_;
};

/// Fits the samples of one sweep by least squares; the ripple has a prior of 0.2/order % of the rate, so that
/// a scatter of the samples' times is not taken for it (docs/constant_rate.md).
/// @return nothing for fewer than 24 samples, or samples of one time
std::optional<SweepAngle> fit_sweep_angle(std::span<const AngleSample> samples);

}  // namespace abcal
