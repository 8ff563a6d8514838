#pragma once

#include <array>
#include <cstdint>

namespace abcal::sim {

/// Purpose of a random number of the world. The streams of different purposes are independent.
enum class NoiseStream : std::uint64_t {
  kStepError = 1,
  kReading = 2,
  kReadingAtPose = 3,
  kSmoothError = 4,
  kWobble = 5,
  kRandomWalk = 6,
  kFlicker = 7,
  kCorrelated = 8,
  kScenario = 9,  ///< Studies that draw whole benches.
  kFineMap = 10,
  kVisit = 11,
  kHoming = 12,
  kFloor = 13,
  kGrowth = 14,
  kKnock = 15,
  kRipple = 16,
  kEncoder = 17,
  kTimeStamp = 18,
  kStated = 19,  ///< Truths drawn from what a bench file states.
};

/// Four independent standard normal numbers: a pure function of seed, stream and counter (Philox4x64-10 and
/// the Box-Muller transform of Random123), so that nothing depends on the order in which they are asked for.
std::array<double, 4> normal_numbers(std::uint64_t seed, NoiseStream stream,
                                     const std::array<std::uint64_t, 4>& counter);

}  // namespace abcal::sim
