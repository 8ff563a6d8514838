#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace abcal {

/// Purpose of a stream of random numbers. Streams of different purposes are independent for one seed and
/// trial.
enum class StreamPurpose : std::uint32_t {
  kTypeB = 0,
  kTypeA = 1,
  kAccelerometers = 2,
  kReadings = 3,
  kTest = 4,
  kEffects = 5,    ///< Effects of stage and item, and the noise, of a trial of the joint estimator.
  kComparison = 6  ///< Results of laboratories.
};

/// Counter-based random numbers: Philox4x32-10 (Salmon et al. 2011; Random123). One stream a trial: the
/// numbers depend on seed, purpose, trial and position alone, so a study gives the same bits on any number of
/// threads.
///
/// Key = seed. Counter = (trial low, trial high, pair, purpose). Each counter gives 128 bits = one pair of
/// normals by Box and Muller with own logarithm, sine and cosine made of +, -, *, / and square root only, so
/// that every processor with IEEE arithmetic gives the same bits. Largest possible magnitude: 8.49.
class RandomStream {
 public:
  RandomStream(std::uint64_t seed, StreamPurpose purpose, std::uint64_t trial)
      : seed_(seed), purpose_(purpose), trial_(trial) {}

  /// The next value of N(0, 1).
  double normal();

  /// The next value of the uniform distribution on the open interval (0, 1): 52 bits. Takes a pair of its
  /// own.
  double uniform();

  /// The 128 bits of one counter, as Random123 gives them.
  std::array<std::uint32_t, 4> bits(std::uint32_t pair) const;

  /// Pair `pair` of standard normals of this stream.
  std::array<double, 2> normal_pair(std::uint32_t pair) const;

 private:
  std::uint64_t seed_;
  StreamPurpose purpose_;
  std::uint64_t trial_;
  std::uint32_t next_pair_ = 0;
  bool have_second_ = false;
  double second_ = 0.0;
};

}  // namespace abcal
