#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <string>

namespace abcal::sim {

/// Appends a number, its highest byte first.
template <typename Unsigned>
void put_big_endian(std::string& out, Unsigned value) {
  std::array<char, sizeof(Unsigned)> bytes;
  for (std::size_t k = 0; k < bytes.size(); ++k)
    bytes[k] = static_cast<char>((value >> (8U * (bytes.size() - 1 - k))) & 0xFFU);
  out.append(bytes.data(), bytes.size());
}

/// Appends a float32 of IEEE 754.
inline void put_big_endian_float(std::string& out, double value) {
  put_big_endian(out, std::bit_cast<std::uint32_t>(static_cast<float>(value)));
}

}  // namespace abcal::sim
