#include "protocol/estimators/measurement/size_posterior.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <utility>
#include <vector>

namespace abcal {
namespace {

/// Densities of the logarithm of a size, by the size.
using Densities = std::map<double, double>;

/// Logarithm of the density of the logarithm of a size, up to a constant.
double log_density_before(const SizeFound& before, double size) {
  if (before.log_density.empty()) {
    const double in_rms = size / before.rms;
    return -0.5 * in_rms * in_rms + std::log(in_rms);
  }
  const auto& points = before.log_density;
  auto next = std::ranges::lower_bound(points, size, {}, &std::pair<double, double>::first);
  // Extrapolates linearly.
  next = std::clamp(next, points.begin() + 1, points.end() - 1);
  const auto last = std::prev(next);
  const double share = std::log(size / last->first) / std::log(next->first / last->first);
  return last->second + share * (next->second - last->second);
}

Densities::const_iterator mode_of(const Densities& densities) {
  return std::ranges::max_element(densities, {}, &Densities::value_type::second);
}

/// Sizes with their probabilities, by a density whose logarithm is linear in that of the size between the
/// given ones.
std::vector<ProbableSize> list_of(const Densities& densities, int parts) {
  const auto mode = mode_of(densities);
  std::vector<ProbableSize> out;
  double total = 0.0;
  for (auto next = std::next(densities.begin()); next != densities.end(); ++next) {
    const auto before = std::prev(next);
    const double width = std::log(next->first / before->first) / parts;
    for (int i = 0; i < parts; ++i) {
      const double share = (i + 0.5) / parts;
      const double p =
          width * std::exp(before->second + share * (next->second - before->second) - mode->second);
      out.push_back({before->first * std::pow(next->first / before->first, share), p});
      total += p;
    }
  }
  for (ProbableSize& one : out) one.probability /= total;
  return out;
}

SizeFound integrated(const Densities& densities) {
  constexpr int kParts = 32;
  const auto mode = mode_of(densities);
  const std::vector<ProbableSize> list = list_of(densities, kParts);
  double square = 0.0;
  for (const auto& [size, p] : list) square += p * size * size;
  SizeFound out;
  out.most_probable = mode->first;
  out.rms = std::sqrt(square);
  const auto quantile = [&](double probability) {
    double sum = 0.0;
    for (const auto& [size, p] : list)
      if ((sum += p) >= probability) return size;
    return list.back().size;
  };
  out.lower = quantile(0.025);
  out.upper = quantile(0.975);
  for (const auto& [size, log] : densities) out.log_density.emplace_back(size, log - mode->second);
  return out;
}

}  // namespace

SizeFound size_posterior(double scale, const SizeFound& before,
                         const std::function<double(double)>& log_likelihood) {
  constexpr double kLeast = 0.01, kMost = 2.0;
  constexpr int kCoarse = 9, kRounds = 3;
  Densities densities;
  const auto add = [&](double size) {
    densities[size] = log_likelihood(size) + log_density_before(before, size);
  };
  for (int i = 0; i < kCoarse; ++i)
    add(scale * kLeast * std::pow(kMost / kLeast, static_cast<double>(i) / (kCoarse - 1)));
  // Sizes between those next to the mode: the density falls steeply on both sides of it.
  for (int round = 0; round < kRounds; ++round) {
    const auto mode = mode_of(densities);
    std::vector<double> between;
    if (mode != densities.begin()) between.push_back(std::sqrt(mode->first * std::prev(mode)->first));
    if (std::next(mode) != densities.end())
      between.push_back(std::sqrt(mode->first * std::next(mode)->first));
    for (const double size : between) add(size);
  }
  return integrated(densities);
}

std::vector<ProbableSize> probable_sizes(const SizeFound& size) {
  constexpr int kParts = 4;
  Densities densities;
  for (const auto& [at, log] : size.log_density) densities[at] = log;
  if (densities.empty() && size.rms > 0.0)
    for (const double share : {0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 4.0})
      densities[share * size.rms] = log_density_before(size, share * size.rms);
  if (densities.size() < 2) return {{size.rms, 1.0}};
  return list_of(densities, kParts);
}

}  // namespace abcal
