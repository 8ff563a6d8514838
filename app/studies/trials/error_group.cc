#include "app/studies/trials/error_group.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <nlohmann/json.hpp>

#include "app/studies/robustness/scenario.h"

namespace abcal {
namespace {

constexpr double kCoverageFactor = 1.959963984540054;

/// Probability, from resampled benches, of a mean as far from 1 as that of these mean squares.
double probability_of_one(const std::vector<double>& z2, std::uint64_t seed) {
  constexpr int kResamples = 4000;
  if (z2.size() < 2) return 1.0;
  ScenarioDraw draw(seed, 0xB007, z2.size());
  int below = 0, above = 0;
  for (int i = 0; i < kResamples; ++i) {
    double sum = 0.0;
    for (std::size_t k = 0; k < z2.size(); ++k) {
      const auto at = static_cast<std::size_t>(draw.uniform() * static_cast<double>(z2.size()));
      sum += z2[std::min(at, z2.size() - 1)];
    }
    (sum < static_cast<double>(z2.size()) ? below : above) += 1;
  }
  return std::min(1.0, 2.0 * (std::min(below, above) + 1.0) / (kResamples + 1.0));
}

}  // namespace

ErrorGroup error_group(std::span<const ErrorsAndU> benches, double limit, std::uint64_t seed) {
  ErrorGroup group;
  group.limit = limit;
  double u2 = 0.0, error2 = 0.0, covered = 0.0, count = 0.0, z2_sum = 0.0;
  std::vector<double> z2_of_bench;
  for (const ErrorsAndU& bench : benches) {
    if (bench.empty()) continue;
    double z2 = 0.0;
    for (const auto& [error, u] : bench) {
      u2 += u * u;
      error2 += error * error;
      const double z = std::abs(error / u);
      z2 += z * z;
      covered += z <= kCoverageFactor ? 1.0 : 0.0;
      group.most_z = std::max(group.most_z, z);
      count += 1.0;
    }
    z2_sum += z2;
    z2_of_bench.push_back(z2 / static_cast<double>(bench.size()));
  }
  if (count == 0.0) return group;
  group.rms_u = std::sqrt(u2 / count);
  group.rms_error = std::sqrt(error2 / count);
  group.rms_z = std::sqrt(z2_sum / count);
  group.coverage = covered / count;
  group.probability = probability_of_one(z2_of_bench, seed);
  return group;
}

nlohmann::ordered_json error_group_json(std::string_view name, std::string_view unit,
                                        const ErrorGroup& group) {
  return {
      {"name", name},
      {"unit", unit},
      {"rms_uncertainty", group.rms_u},
      {"figure", group.limit > 0.0 ? nlohmann::ordered_json(group.limit) : nlohmann::ordered_json(nullptr)},
      {"rms_error", group.rms_error},
      {"rms_ratio", group.rms_z},
      {"coverage", group.coverage},
      {"largest_ratio", group.most_z},
      {"probability", group.probability}};
}

}  // namespace abcal
