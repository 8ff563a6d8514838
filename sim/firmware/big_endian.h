#pragma once

#include <bit>
#include <cstdint>
#include <string>

namespace abcal::sim {

/// Appends a number, its highest byte first.
template <typename Unsigned>
void put_big_endian(std::string& out, Unsigned value) {
  for (int shift = static_cast<int>(sizeof(Unsigned)) * 8 - 8; shift >= 0; shift -= 8)
    out.push_back(static_cast<char>((value >> static_cast<unsigned>(shift)) & 0xFFU));
}

/// Appends a float32 of IEEE 754.
inline void put_big_endian_float(std::string& out, double value) {
  put_big_endian(out, std::bit_cast<std::uint32_t>(static_cast<float>(value)));
}

}  // namespace abcal::sim
