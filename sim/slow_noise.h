#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "sim/counter_noise.h"

namespace abcal::sim {

/// Noise with memory: a Gauss-Markov process of unit size for each output, as a function of time. Without a
/// correlation time it is a random walk, zero at time 0, of standard deviation 1 after one block; with one it
/// is stationary (Ornstein-Uhlenbeck) of standard deviation 1. Any time may be asked for, in any order: ends
/// of blocks are a chain, values in between come from halving the block (Levy's construction), with random
/// numbers keyed by the place. Finer than a 2^-20th of a block it is a straight line.
class MarkovNoise {
 public:
  /// @param correlation_blocks  correlation time over the block; absent: random walk
  MarkovNoise(std::uint64_t seed, NoiseStream stream, double block_s,
              std::optional<double> correlation_blocks);

  /// u, v, w. @throws std::invalid_argument a time that is not finite or before 0
  Eigen::Vector3d at(double time_s);

 private:
  Eigen::Vector3d draw(std::uint64_t block, std::uint64_t place) const;
  void extend(std::size_t block);

  std::uint64_t seed_;
  NoiseStream stream_;
  double block_s_;
  std::optional<double> correlation_;
  std::vector<Eigen::Vector3d> ends_;  ///< Values at the block boundaries so far.
};

/// Noise of unit standard deviation with a spectrum of 1/frequency from a quarter of a cycle to 256 cycles in
/// a span: as many waves in each octave, of equal power, amplitudes and phases drawn from the seed.
class FlickerNoise {
 public:
  FlickerNoise(std::uint64_t seed, double span_s);
  Eigen::Vector3d at(double time_s) const;  ///< u, v, w.

 private:
  struct Wave {
    double cycles_per_s;
    Eigen::Vector3d cosine, sine;
  };
  std::vector<Wave> waves_;
};

}  // namespace abcal::sim
