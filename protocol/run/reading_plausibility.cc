#include "protocol/run/reading_plausibility.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// Fewest readings from which anything is concluded.
constexpr std::int64_t kFewReadings = 8;

/// Usual spread of an output. If it was frozen from the start, that of the quietest of the others, if well
/// above the resolution: the outputs of one accelerometer have similar noise. 0: not known.
double usual_of(const Eigen::Vector3d& usual_spread, int output, double resolution) {
  if (!std::isnan(usual_spread[output])) return usual_spread[output];
  double quietest = std::numeric_limits<double>::infinity();
  for (int j = 0; j < 3; ++j)
    if (usual_spread[j] > 2.0 * resolution) quietest = std::min(quietest, usual_spread[j]);
  return std::isfinite(quietest) ? quietest : 0.0;
}

}  // namespace

bool is_stuck(const DwellStatistics& statistics, const std::optional<Eigen::Vector3d>& usual_spread,
              double resolution) {
  if (statistics.count < kFewReadings || !usual_spread) return false;
  for (int j = 0; j < 3; ++j) {
    const double usual = usual_of(*usual_spread, j, resolution);
    if (statistics.spread[j] != 0.0 || !(usual > 0.0)) continue;
    // Rounding to the resolution is part of the usual spread.
    const double rounding = resolution * resolution / 12.0;
    const double noise = std::sqrt(std::max(usual * usual - rounding, 0.0));
    // Probability of the likeliest step of the resolution; all readings but the first must fall into it.
    const double one = noise > 0.0 ? std::erf(resolution / (2.0 * std::numbers::sqrt2 * noise)) : 1.0;
    if (std::pow(one, static_cast<double>(statistics.count - 1)) <= kFalseAlarm) return true;
  }
  return false;
}

bool is_shaken(const DwellStatistics& statistics, const std::optional<Eigen::Vector3d>& usual_spread,
               double resolution, const LimitsConfig& limits) {
  if (statistics.count < kFewReadings || !usual_spread) return false;
  const auto freedom = static_cast<double>(statistics.count - 1);
  // The square of a spread is chi2 over its degrees of freedom.
  const double of_noise = std::sqrt(chi2_above(kFalseAlarm / 3.0, freedom) / freedom);
  const double factor = std::max(limits.spread_factor, of_noise);
  for (int j = 0; j < 3; ++j) {
    if (std::isnan((*usual_spread)[j])) continue;  // Frozen so far: not known.
    if (!(statistics.spread[j] <= std::max(factor * (*usual_spread)[j], resolution))) return true;
  }
  return false;
}

std::optional<Message> temperature_excess(std::optional<double> temperature_degc,
                                          std::optional<double> first_degc, const LimitsConfig& limits,
                                          const Tolerances& tolerances) {
  if (!temperature_degc) return std::nullopt;
  const double t = *temperature_degc;
  const bool inside = t >= limits.temperature_min_degc && t <= limits.temperature_max_degc;
  if (!inside) {
    return Message(
        "temperature {found:.2f} degC; required: {lowest:g} to {highest:g} degC ([limits] "
        "temperature_min_degc, temperature_max_degc)",
        t, limits.temperature_min_degc, limits.temperature_max_degc);
  }
  const double allowed = temperature_change_limit_degc(limits, tolerances);
  if (first_degc && !(std::abs(t - *first_degc) <= allowed)) {
    return Message(
        "temperature {found:.2f} degC, {change:+.2f} from the first angle; required: within {allowed:.2g} "
        "degC of it ([limits] temperature_change_degc)",
        t, t - *first_degc, allowed);
  }
  return std::nullopt;
}

bool norm_is_wrong(const Eigen::Vector3d& mean, double nominal, const LimitsConfig& limits) {
  return !(std::abs(mean.norm() / nominal - 1.0) <= limits.norm_fraction);
}

std::optional<CircleResponse> response_of_circle(std::span<const DwellRecord> experiment) {
  // Sine and cosine of the first and the third harmonic of the half-differences of each output.
  Eigen::Matrix<double, 3, 4> harmonics = Eigen::Matrix<double, 3, 4>::Zero();
  double cosine = 0.0, sine = 0.0;
  int pairs = 0;
  for (std::size_t a = 0; a < experiment.size(); ++a) {
    for (std::size_t b = a + 1; b < experiment.size(); ++b) {
      const DwellRecord &first = experiment[a], &second = experiment[b];
      if (first.closing || second.closing || first.experiment != second.experiment) continue;
      if (std::remainder(second.alpha.deg() - first.alpha.deg() - 180.0, 360.0) != 0.0) continue;
      const SinCos once = sincos(first.alpha), thrice = sincos(first.alpha * 3.0);
      harmonics +=
          0.5 * (second.mean - first.mean) * Eigen::RowVector4d(once.sin, once.cos, thrice.sin, thrice.cos);
      const SinCos twice = sincos(first.alpha * 2.0);
      cosine += twice.cos;
      sine += twice.sin;
      ++pairs;
    }
  }
  // Three pairs cannot distinguish the third harmonic from its mirror image. On an uneven circle the
  // harmonics mix.
  if (pairs < 4 || std::hypot(cosine, sine) > 0.01 * pairs || !harmonics.allFinite()) return std::nullopt;
  harmonics *= 2.0 / pairs;
  // k l^3 of l = A cos(alpha - phi) is 3/4 k A^3 in the first harmonic and 1/4 k A^3 in the third.
  double at_zero = 0.0, at_one_g = 0.0;
  for (Eigen::Index j = 0; j < 3; ++j) {
    const double amplitude = std::hypot(harmonics(j, 0), harmonics(j, 1));
    const double phi = std::atan2(harmonics(j, 0), harmonics(j, 1));
    const double third = harmonics(j, 2) * std::sin(3.0 * phi) + harmonics(j, 3) * std::cos(3.0 * phi);
    at_zero += std::pow(amplitude - 3.0 * third, 2);
    at_one_g += std::pow(amplitude + third, 2);
  }
  // Two of the outputs follow gravity at a time: the squares of the three amplitudes have the sum 2.
  return CircleResponse{std::sqrt(0.5 * at_zero), std::sqrt(0.5 * at_one_g)};
}

std::optional<Message> full_scale_excess(std::span<const DwellRecord> experiment, double nominal,
                                         const ExpectedItem& item) {
  const auto response = response_of_circle(experiment);
  if (!response) return std::nullopt;
  double variance = 0.0;
  for (const DwellRecord& dwell : experiment) {
    if (dwell.u_mean) variance += dwell.u_mean->squaredNorm();
  }
  const auto count = static_cast<double>(experiment.size());
  const double noise = std::sqrt(variance) / count / nominal;
  const double limit = item.sensitivity_tolerance + kFalseAlarmDeviate * noise;
  // The nearest possible response of the item.
  const auto [least, most] = std::minmax(response->at_zero, response->at_one_g);
  const double nearest = std::clamp(nominal, least, most);
  const double difference = nearest / nominal - 1.0;
  if (std::abs(difference) <= limit) return std::nullopt;
  return Message(
      "experiment {experiment}: the response to local gravity is {found:.6g}, {difference:+.3g} % from the "
      "nominal {nominal:.6g}; required: within {allowed:.2g} % ([item] sensitivity_tolerance). Check unit, "
      "full scale and scale factor",
      experiment.front().experiment, nearest, 100.0 * difference, nominal, 100.0 * limit);
}

bool is_stable(std::span<const StabilityWindow> windows, double stability_s, const LimitsConfig& limits,
               const Tolerances& tolerances) {
  if (windows.empty() || windows.back().end_s - windows.front().end_s < stability_s) return false;
  Eigen::Array3d low = windows.back().mean.array(), high = low;
  double u = 0.0;
  double coldest = std::numeric_limits<double>::infinity(), warmest = -coldest;
  for (const StabilityWindow& window : windows) {
    if (window.end_s < windows.back().end_s - stability_s) continue;
    low = low.min(window.mean.array());
    high = high.max(window.mean.array());
    u = std::max(u, window.u_mean.maxCoeff());
    if (window.temperature_degc) {
      coldest = std::min(coldest, *window.temperature_degc);
      warmest = std::max(warmest, *window.temperature_degc);
    }
  }
  const double allowed = std::hypot(stability_limit(limits, tolerances) * windows.back().mean.norm(),
                                    kFalseAlarmDeviate * std::numbers::sqrt2 * u);
  const bool outputs = (high - low).maxCoeff() <= allowed;  // false where a mean is not a number
  return outputs && !(warmest - coldest > stability_limit_degc(limits, tolerances));
}

}  // namespace abcal
