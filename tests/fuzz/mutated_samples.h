#pragma once

#include <cstddef>
#include <random>
#include <span>
#include <string>

namespace abcal::test {

/// One to `most` of the samples, one after the other, then changed at up to three places: a byte is lost, or
/// a bit is turned.
inline std::string mutated(std::span<const std::string> samples, std::size_t most, std::mt19937& random) {
  std::string bytes;
  for (std::size_t count = 1 + random() % most; count > 0; --count)
    bytes += samples[random() % samples.size()];
  for (std::size_t changes = random() % 4; changes > 0 && !bytes.empty(); --changes) {
    const std::size_t at = random() % bytes.size();
    if (random() % 2 == 0) {
      bytes.erase(at, 1);
    } else {
      bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

}  // namespace abcal::test
