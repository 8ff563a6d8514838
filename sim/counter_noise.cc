#include "sim/counter_noise.h"

#include <Random123/philox.h>

#include <Random123/boxmuller.hpp>

namespace abcal::sim {

std::array<double, 4> normal_numbers(std::uint64_t seed, NoiseStream stream,
                                     const std::array<std::uint64_t, 4>& counter) {
  r123::Philox4x64::ctr_type block{};
  for (std::size_t k = 0; k < 4; ++k) block[k] = counter[k];
  r123::Philox4x64::key_type key{};
  key[0] = seed;
  key[1] = static_cast<std::uint64_t>(stream);
  const auto random = r123::Philox4x64{}(block, key);
  const r123::double2 first = r123::boxmuller(random[0], random[1]);
  const r123::double2 second = r123::boxmuller(random[2], random[3]);
  return {first.x, first.y, second.x, second.y};
}

}  // namespace abcal::sim
