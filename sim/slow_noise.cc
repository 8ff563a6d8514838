#include "sim/slow_noise.h"

#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace abcal::sim {
namespace {

constexpr int kHalvings = 20;
constexpr std::size_t kMostBlocks = 1'000'000;  // 24 MB; at an hour each, 114 years
constexpr double kLowestCycles = 0.25;
constexpr double kOctaves = 10.0;
constexpr int kWaves = 60;

}  // namespace

MarkovNoise::MarkovNoise(std::uint64_t seed, NoiseStream stream, double block_s,
                         std::optional<double> correlation_blocks)
    : seed_(seed), stream_(stream), block_s_(block_s), correlation_(correlation_blocks) {
  ends_.emplace_back(correlation_ ? draw(0, 0) : Eigen::Vector3d::Zero());
}

Eigen::Vector3d MarkovNoise::draw(std::uint64_t block, std::uint64_t place) const {
  const std::array<double, 4> normal = normal_numbers(seed_, stream_, {block, place, 0, 0});
  return {normal[0], normal[1], normal[2]};
}

void MarkovNoise::extend(std::size_t block) {
  while (ends_.size() <= block + 1) {
    // Place 0 is the end of a block; 1, 2, 3, ... are the midpoints, as in a binary heap.
    const Eigen::Vector3d normal = draw(ends_.size(), 0);
    const double kept = correlation_ ? std::exp(-1.0 / *correlation_) : 1.0;
    const double fresh = correlation_ ? std::sqrt(-std::expm1(-2.0 / *correlation_)) : 1.0;
    ends_.emplace_back(kept * ends_.back() + fresh * normal);
  }
}

Eigen::Vector3d MarkovNoise::at(double time_s) {
  const double blocks = time_s / block_s_;
  if (!(blocks >= 0.0) || !(blocks < static_cast<double>(kMostBlocks)))
    throw std::invalid_argument("simulated bench: slow noise outside 0 to 1000000 spans of time");
  const auto block = static_cast<std::size_t>(blocks);
  extend(block);
  Eigen::Vector3d from = ends_[block];
  Eigen::Vector3d to = ends_[block + 1];
  double where = blocks - static_cast<double>(block);  // 0 to 1 between `from` and `to`
  double width = 1.0;                                  // Remaining interval, in blocks
  std::uint64_t place = 1;
  for (int k = 0; k < kHalvings && where != 0.0; ++k) {
    // The middle of a Gauss-Markov process given both ends.
    double weight = 0.5;
    double variance = width / 4.0;
    if (correlation_) {
      const double half = width / (2.0 * *correlation_);
      weight = 0.5 / std::cosh(half);
      variance = std::tanh(half);
    }
    const Eigen::Vector3d middle = weight * (from + to) + std::sqrt(variance) * draw(block + 1, place);
    const bool right = where >= 0.5;
    (right ? from : to) = middle;
    where = 2.0 * where - (right ? 1.0 : 0.0);
    width /= 2.0;
    place = 2 * place + (right ? 1 : 0);
  }
  return from + where * (to - from);
}

FlickerNoise::FlickerNoise(std::uint64_t seed, double span_s) {
  // Equal steps of the logarithm: equal power in each octave.
  const double size = std::sqrt(1.0 / kWaves);
  for (int k = 0; k < kWaves; ++k) {
    const double octave = kOctaves * (k + 0.5) / kWaves;
    const auto number = static_cast<std::uint64_t>(k);
    const auto a = normal_numbers(seed, NoiseStream::kFlicker, {number, 0, 0, 0});
    const auto b = normal_numbers(seed, NoiseStream::kFlicker, {number, 1, 0, 0});
    waves_.push_back({kLowestCycles * std::exp2(octave) / span_s, size * Eigen::Vector3d(a[0], a[1], a[2]),
                      size * Eigen::Vector3d(b[0], b[1], b[2])});
  }
}

Eigen::Vector3d FlickerNoise::at(double time_s) const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Wave& wave : waves_) {
    const double phase = 2.0 * std::numbers::pi * wave.cycles_per_s * time_s;
    sum += std::cos(phase) * wave.cosine + std::sin(phase) * wave.sine;
  }
  return sum;
}

}  // namespace abcal::sim
