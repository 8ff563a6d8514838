#include "protocol/model/sweep_angle.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "drivers/instrument/angle.h"

namespace abcal {
namespace {

constexpr std::size_t kLeastSamples = 24;
/// Size of the ripple of order 1, as a part of the rate; that of order m is 1/m of it (radian in angle).
constexpr double kRipple = 2e-3;
/// Scatter and ripple depend on each other: three rounds settle both to a per cent.
constexpr int kRounds = 3;

using Coefficients = SweepAngle::Coefficients;

}  // namespace

double SweepAngle::phase_rad(double time_s) const {
  return Angle::degrees(coefficients_(0) + coefficients_(1) * (time_s - middle_s_)).rad();
}

double SweepAngle::angle_deg(double time_s) const {
  double angle = coefficients_(0) + coefficients_(1) * (time_s - middle_s_);
  const double phase = phase_rad(time_s);
  for (int m = 1; m <= kOrders; ++m)
    angle += coefficients_(2 * m) * std::sin(m * phase) + coefficients_(2 * m + 1) * std::cos(m * phase);
  return angle;
}

double SweepAngle::rate_deg_per_s(double time_s) const {
  const double phase = phase_rad(time_s);
  double by_phase = 1.0;
  for (int m = 1; m <= kOrders; ++m)
    by_phase += Angle::degrees(1.0).rad() * m *
                (coefficients_(2 * m) * std::cos(m * phase) - coefficients_(2 * m + 1) * std::sin(m * phase));
  return coefficients_(1) * by_phase;
}

double SweepAngle::acceleration_deg_per_s2(double time_s) const {
  const double phase = phase_rad(time_s);
  const double rate_radps = Angle::degrees(coefficients_(1)).rad();
  double sum = 0.0;
  for (int m = 1; m <= kOrders; ++m)
    sum -=
        m * m * (coefficients_(2 * m) * std::sin(m * phase) + coefficients_(2 * m + 1) * std::cos(m * phase));
  return sum * rate_radps * rate_radps;
}

double SweepAngle::u_deg() const {
  return rms_deg_ / std::sqrt(static_cast<double>(samples_));
}

std::optional<SweepAngle> fit_sweep_angle(std::span<const AngleAtTime> samples) {
  if (samples.size() < kLeastSamples) return std::nullopt;
  const double middle_s = 0.5 * (samples.front().time_s + samples.back().time_s);
  const auto count = static_cast<Eigen::Index>(samples.size());
  Eigen::MatrixXd design(count, Coefficients::RowsAtCompileTime);
  Eigen::VectorXd angles(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const AngleAtTime& sample = samples[static_cast<std::size_t>(i)];
    design(i, 0) = 1.0;
    design(i, 1) = sample.time_s - middle_s;
    angles(i) = sample.angle_deg;
  }
  const Eigen::MatrixXd line = design.leftCols<2>();
  const Eigen::Matrix2d of_line = line.transpose() * line;
  if (!(of_line(1, 1) > 0.0)) return std::nullopt;
  Coefficients found = Coefficients::Zero();
  found.head<2>() = of_line.ldlt().solve(line.transpose() * angles);
  double rms = std::sqrt((angles - design.leftCols<2>() * found.head<2>()).squaredNorm() /
                         static_cast<double>(count - 2));
  for (int round = 0; round < kRounds && rms > 0.0; ++round) {
    for (Eigen::Index i = 0; i < count; ++i) {
      const double phase = Angle::degrees(found(0) + found(1) * design(i, 1)).rad();
      for (int m = 1; m <= SweepAngle::kOrders; ++m) {
        design(i, 2 * m) = std::sin(m * phase);
        design(i, 2 * m + 1) = std::cos(m * phase);
      }
    }
    Eigen::MatrixXd normal = design.transpose() * design;
    for (int m = 1; m <= SweepAngle::kOrders; ++m) {
      const double prior_deg = Angle::radians(kRipple / m).deg();
      const double weight = rms * rms / (prior_deg * prior_deg);
      normal(2 * m, 2 * m) += weight;
      normal(2 * m + 1, 2 * m + 1) += weight;
    }
    found = normal.ldlt().solve(design.transpose() * angles);
    const Eigen::Index free = std::max<Eigen::Index>(1, count - Coefficients::RowsAtCompileTime);
    rms = std::sqrt((angles - design * found).squaredNorm() / static_cast<double>(free));
  }
  return SweepAngle(middle_s, found, rms, samples.size());
}

}  // namespace abcal
