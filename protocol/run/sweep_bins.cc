#include "protocol/run/sweep_bins.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "protocol/record/reading_statistics.h"

namespace abcal {
namespace {

constexpr int kCurveOrders = 8;
using Curve = Eigen::Matrix<double, 1 + 2 * kCurveOrders, 3>;
using Basis = Eigen::Matrix<double, 1 + 2 * kCurveOrders, 1>;

Basis basis_at(double angle_deg) {
  Basis basis;
  basis(0) = 1.0;
  const double phase = Angle::degrees(angle_deg).rad();
  for (int m = 1; m <= kCurveOrders; ++m) {
    basis(2 * m - 1) = std::cos(m * phase);
    basis(2 * m) = std::sin(m * phase);
  }
  return basis;
}

/// Derivative of basis_at() by the angle, per radian.
Basis slope_at(double angle_deg) {
  Basis slope;
  slope(0) = 0.0;
  const double phase = Angle::degrees(angle_deg).rad();
  for (int m = 1; m <= kCurveOrders; ++m) {
    slope(2 * m - 1) = -m * std::sin(m * phase);
    slope(2 * m) = m * std::cos(m * phase);
  }
  return slope;
}

/// The noise of single readings about the means of their bins, across the direction in which an error of the
/// angle moves the three outputs: the fine errors of a stage that turns are not noise of the item.
class Noise {
 public:
  void add_bin(const std::vector<Eigen::Vector3d>& off, const Eigen::Vector3d& mean,
               const Eigen::Vector3d& by_angle) {
    ++bins_;
    const Eigen::Vector3d along = by_angle.normalized();
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - along * along.transpose();
    for (const Eigen::Vector3d& each : off) {
      const Eigen::Vector3d left = across * (each - mean);
      squares_ += left.cwiseAbs2();
      shares_ += across.cwiseAbs2();
      for (std::size_t j = 0; j < 3; ++j) distances_[j].push_back(left(static_cast<Eigen::Index>(j)));
    }
  }
  /// Standard deviation of one reading of each output.
  Eigen::Vector3d spread() const {
    const auto count = static_cast<double>(distances_[0].size());
    if (!(count > bins_)) return Eigen::Vector3d::Zero();
    // The squares that remain across are a mixture of the three variances.
    const Eigen::Vector3d variance = shares_.ldlt().solve(squares_) * (count / (count - bins_));
    const double usual = squares_.sum() / (2.0 * (count - bins_));
    if (!variance.allFinite() || variance.minCoeff() <= 0.0)
      return Eigen::Vector3d::Constant(std::sqrt(usual));
    return variance.cwiseSqrt();
  }
  /// The root of the number of readings over that of independent ones.
  Eigen::Vector3d lengthened() const {
    Eigen::Vector3d out = Eigen::Vector3d::Ones();
    for (std::size_t j = 0; j < 3 && !distances_[j].empty(); ++j)
      out(static_cast<Eigen::Index>(j)) =
          std::sqrt(static_cast<double>(distances_[j].size()) / effective_number_of_readings(distances_[j]));
    return out;
  }

 private:
  double bins_ = 0.0;
  Eigen::Vector3d squares_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d shares_ = Eigen::Matrix3d::Zero();
  std::array<std::vector<double>, 3> distances_;
};

double angle_deg_at(const SweepAngle& turned, Clock::Instant at) {
  return turned.angle_deg(to_seconds(at.time_since_epoch()));
}

/// When the axis was at an angle: three steps of Newton's.
Clock::Instant time_of(const SweepAngle& turned, double angle_deg, Clock::Instant near) {
  for (int step = 0; step < 3; ++step)
    near += from_seconds((angle_deg - angle_deg_at(turned, near)) /
                         turned.rate_deg_per_s(to_seconds(near.time_since_epoch())));
  return near;
}

Curve fit_curve(const std::vector<SweepBin>& bins, const SweepAngle& turned) {
  Eigen::Matrix<double, Basis::RowsAtCompileTime, Basis::RowsAtCompileTime> normal;
  normal.setZero();
  Curve right = Curve::Zero();
  for (const SweepBin& bin : bins) {
    for (const Reading& reading : bin.readings) {
      if (!reading.output.allFinite()) continue;
      const Basis basis = basis_at(angle_deg_at(turned, reading.arrival));
      normal += basis * basis.transpose();
      right += basis * reading.output.transpose();
    }
  }
  return normal.ldlt().solve(right);
}

}  // namespace

std::vector<SweepBin> bins_of_sweep(std::span<const PlannedAngle> angles, Angle step,
                                    const SweepAngle& turned, std::span<const Reading> readings) {
  std::vector<SweepBin> bins(angles.size());
  const double first_deg = angles.front().turning().deg();
  const double sense = turned.mean_rate_deg_per_s() < 0.0 ? -1.0 : 1.0;
  for (const Reading& reading : readings) {
    const double steps = sense * (angle_deg_at(turned, reading.arrival) - first_deg) / step.deg();
    const double bin = std::floor(steps + 0.5);
    if (!(bin >= 0.0 && bin < static_cast<double>(bins.size()))) continue;
    bins[static_cast<std::size_t>(bin)].readings.push_back(reading);
  }
  const Curve curve = fit_curve(bins, turned);
  Noise noise;
  for (std::size_t k = 0; k < bins.size(); ++k) {
    SweepBin& bin = bins[k];
    std::vector<Eigen::Vector3d> off;
    for (const Reading& reading : bin.readings) {
      if (!reading.output.allFinite()) continue;
      off.emplace_back(reading.output - curve.transpose() * basis_at(angle_deg_at(turned, reading.arrival)));
    }
    if (off.empty()) {
      bin.value.setConstant(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    const double angle_deg = angles[k].turning().deg();
    const Eigen::Vector3d mean = mean_and_spread(off).mean;
    noise.add_bin(off, mean, curve.transpose() * slope_at(angle_deg));
    bin.middle = time_of(turned, angle_deg, bin.readings[bin.readings.size() / 2].arrival);
    bin.value = curve.transpose() * basis_at(angle_deg) + mean;
  }
  const Eigen::Vector3d spread = noise.spread();
  const Eigen::Vector3d lengthened = noise.lengthened();
  for (SweepBin& bin : bins) {
    bin.spread = spread;
    bin.u =
        spread.cwiseProduct(lengthened) / std::sqrt(std::max(1.0, static_cast<double>(bin.readings.size())));
  }
  return bins;
}

}  // namespace abcal
