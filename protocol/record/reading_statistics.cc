#include "protocol/record/reading_statistics.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <unsupported/Eigen/FFT>
#include <vector>

namespace abcal {
namespace {

/// Lags that are summed one by one: readings that hardly correlate need no more, and beyond them a transform
/// of all lags at once is faster.
constexpr std::size_t kDirectLags = 64;

/// Sums of values[k] values[k - lag] for every lag below `lags`.
std::vector<double> autocovariance_sums(const std::vector<double>& values, std::size_t lags) {
  // Zeros behind the values, so that no lag wraps around. A size without large prime factors is fast.
  const std::size_t least = values.size() + lags;
  std::size_t size = std::size_t{1};
  while (size < least) size *= 2;
  for (const std::size_t odd : {std::size_t{3}, std::size_t{5}, std::size_t{9}}) {
    std::size_t candidate = 2 * odd;
    while (candidate < least) candidate *= 2;
    size = std::min(size, candidate);
  }
  std::vector<double> padded(values);
  padded.resize(size, 0.0);
  Eigen::FFT<double> transform;
  transform.SetFlag(Eigen::FFT<double>::HalfSpectrum);
  std::vector<std::complex<double>> spectrum;
  transform.fwd(spectrum, padded);
  for (std::complex<double>& line : spectrum) line = std::norm(line);
  transform.inv(padded, spectrum, static_cast<Eigen::Index>(size));
  padded.resize(lags);
  return padded;
}

}  // namespace

double effective_number_of_readings(std::span<const double> values) {
  const std::size_t n = values.size();
  const auto count = static_cast<double>(n);
  if (n < 4) return count;
  double mean = 0.0;
  for (const double value : values) mean += value / count;
  double variance = 0.0;
  for (const double value : values) variance += (value - mean) * (value - mean);
  if (!(variance > 0.0)) return count;
  const double significant = 2.0 / std::sqrt(count);
  const std::size_t lags = n / 4;  // The first that is not summed.
  double correlation_time = 1.0;
  const auto stands_out = [&](double covariance) {
    const double correlation = covariance / variance;
    if (correlation < significant) return false;
    correlation_time += 2.0 * correlation;
    return true;
  };
  std::size_t lag = 1;
  for (; lag < std::min(lags, kDirectLags); ++lag) {
    double covariance = 0.0;
    for (std::size_t k = lag; k < n; ++k) covariance += (values[k] - mean) * (values[k - lag] - mean);
    if (!stands_out(covariance)) return std::clamp(count / correlation_time, 1.0, count);
  }
  if (lag < lags) {
    std::vector<double> deviations(values.begin(), values.end());
    for (double& deviation : deviations) deviation -= mean;
    const std::vector<double> covariances = autocovariance_sums(deviations, lags);
    while (lag < lags && stands_out(covariances[lag])) ++lag;
  }
  return std::clamp(count / correlation_time, 1.0, count);
}

ReadingStatistics mean_and_spread(std::span<const Eigen::Vector3d> outputs) {
  ReadingStatistics result;
  if (outputs.empty()) return result;
  // Two passes, the mean first and relative to the first reading, so that a large offset costs the spread no
  // digits and readings that are all the same have a spread of exactly zero.
  const auto n = static_cast<double>(outputs.size());
  const Eigen::Vector3d origin = outputs.front();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& output : outputs) sum += output - origin;
  result.mean = origin + sum / n;
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& output : outputs) squares += (output - result.mean).cwiseAbs2();
  result.spread = Eigen::Vector3d::Zero();
  if (n > 1) result.spread = (squares / (n - 1.0)).cwiseSqrt();
  return result;
}

ReadingStatistics reading_statistics(std::span<const Eigen::Vector3d> outputs, double resolution) {
  ReadingStatistics result = mean_and_spread(outputs);
  if (outputs.empty()) return result;
  const double least = resolution / std::sqrt(12.0);
  std::vector<double> output(outputs.size());
  for (int j = 0; j < 3; ++j) {
    std::transform(outputs.begin(), outputs.end(), output.begin(), [j](const auto& all) { return all[j]; });
    const double standard_error = result.spread[j] / std::sqrt(effective_number_of_readings(output));
    result.u_mean[j] = std::max(standard_error, least);
  }
  return result;
}

}  // namespace abcal
