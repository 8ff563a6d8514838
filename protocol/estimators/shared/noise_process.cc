#include "protocol/estimators/shared/noise_process.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <cstddef>

#include "protocol/estimators/shared/reading_kernels.h"

namespace abcal {

NoiseWhitener::NoiseWhitener(const std::vector<NoiseAtAngle>& angles, double step,
                             const NoiseProcess& process)
    : at_(angles.size()), white_(process.tau.isZero(0.0)), tau_(process.tau) {
  const Eigen::Vector3d variance = process.tau.cwiseAbs2();
  Eigen::Matrix3d state = variance.asDiagonal();
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const NoiseAtAngle& angle = angles[n];
    WhitenerStep& at = at_[n];
    const Eigen::Vector3d by_step = step * angle.by_step;
    Eigen::Matrix3d innovation = by_step * by_step.transpose();
    innovation.diagonal() += angle.white;
    if (!white_) innovation += state;
    const Eigen::LLT<Eigen::Matrix3d> llt(innovation);
    const Eigen::Matrix3d lower = llt.matrixL();
    at.lower_inverse = lower.triangularView<Eigen::Lower>().solve(Eigen::Matrix3d::Identity());
    log_determinant_ += 2.0 * lower.diagonal().array().log().sum();
    if (white_) continue;
    at.gain = (at.lower_inverse.transpose() * (at.lower_inverse * state)).transpose();
    at.decay = n + 1 < angles.size() ? std::exp(-angles[n + 1].distance / process.rho) : 0.0;
    const Eigen::Matrix3d kept = state - at.gain * state;
    state = 0.5 * at.decay * at.decay * (kept + kept.transpose());
    state.diagonal() += (1.0 - at.decay * at.decay) * variance;
  }

  const auto count = static_cast<Eigen::Index>(angles.size());
  mean_correlation_ = Eigen::VectorXd::Zero(count);
  mean_variance_.setZero();
  if (white_ || count == 0) return;
  double sum = 0.0;
  for (Eigen::Index n = 0; n < count; ++n) {  // from the past, the angle itself included
    sum = 1.0 + (n > 0 ? at_[static_cast<std::size_t>(n - 1)].decay * sum : 0.0);
    mean_correlation_(n) = sum;
  }
  sum = 0.0;
  for (Eigen::Index n = count - 1; n > 0; --n) {  // from the future
    sum = at_[static_cast<std::size_t>(n - 1)].decay * (1.0 + sum);
    mean_correlation_(n - 1) += sum;
  }
  mean_correlation_ /= static_cast<double>(count);
  mean_variance_ = variance * mean_correlation_.mean();
}

void NoiseWhitener::whiten(ReadingRows& rows) const {
  whiten_rows(at_, white_, rows);
}

void NoiseWhitener::whiten_transposed(ReadingRows& rows) const {
  ReadingRows later = ReadingRows::Zero(3, rows.cols());
  ReadingRows innovation(3, rows.cols());
  for (std::size_t n = at_.size(); n-- > 0;) {
    const WhitenerStep& at = at_[n];
    auto three = rows.middleRows<3>(static_cast<Eigen::Index>(3 * n));
    innovation.noalias() = at.lower_inverse.transpose() * three;
    if (!white_) {
      // m(n + 1) = decay (m(n) + gain (r - m(n))): `later` is the derivative by m(n + 1).
      later *= at.decay;
      innovation.noalias() += at.gain.transpose() * later;
      later -= innovation;
    }
    three = innovation;
  }
}

ReadingRows NoiseWhitener::covariance_with_mean() const {
  ReadingRows out = ReadingRows::Zero(3 * static_cast<Eigen::Index>(at_.size()), 3);
  for (Eigen::Index n = 0; n < mean_correlation_.size(); ++n) {
    for (Eigen::Index j = 0; j < 3; ++j) out(3 * n + j, j) = tau_(j) * tau_(j) * mean_correlation_(n);
  }
  return out;
}

}  // namespace abcal
