#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <span>
#include <string>
#include <string_view>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace abcal::test {

/// Shows the fuzz target one input. It aborts if codec and reference differ.
inline void show_target(std::string_view input) {
  LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
}

/// Shows the fuzz target `count` inputs that `make` draws from one seeded sequence.
template <class Make>
void show_target_seeded(unsigned seed, int count, Make make) {
  std::mt19937 random(seed);
  for (int i = 0; i < count; ++i) show_target(make(random));
}

/// Shows the fuzz target every beginning and every end of an input.
inline void show_target_every_part(std::string_view input) {
  for (std::size_t i = 0; i <= input.size(); ++i) {
    show_target(input.substr(0, i));
    show_target(input.substr(i));
  }
}

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
