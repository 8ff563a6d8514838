#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

/// WitMotion frames decoded the slow way, from docs/protocols/witmotion.md and without a line of the driver's
/// codec: tests at every byte of a whole recording whether a frame begins.
namespace abcal::test::witmotion_reference {

inline int byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<unsigned char>(bytes[index]);
}

inline std::string from_hex(std::string_view hex) {
  std::string bytes;
  std::string digits;
  for (const char c : hex) {
    if (c == ' ') continue;
    digits += c;
    if (digits.size() < 2) continue;
    bytes += static_cast<char>(std::stoi(digits, nullptr, 16));
    digits.clear();
  }
  return bytes;
}

inline int sum_of(std::string_view bytes) {
  int sum = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) sum += byte_at(bytes, i);
  return sum % 256;
}

inline std::string frame(int type, std::array<int, 4> words) {
  std::string bytes{'\x55', static_cast<char>(type)};
  for (const int word : words) {
    const int pattern = (word + 65536) % 65536;
    bytes += static_cast<char>(pattern % 256);
    bytes += static_cast<char>(pattern / 256);
  }
  return bytes + static_cast<char>(sum_of(bytes));
}

/// Words of x, y, z in units of 16/32768 g, and of the temperature in hundredths of a degree.
inline std::string acceleration(int x, int y, int z, int temperature = 2500) {
  return frame(0x51, {x, y, z, temperature});
}

struct FoundFrame {
  std::size_t offset = 0;
  int type = 0;
  std::array<int, 4> words{};  ///< Signed.
};

struct Decoded {
  std::vector<FoundFrame> frames;
  std::size_t bad_frames = 0;
  std::size_t skipped_bytes = 0;
  std::size_t undecided_from = 0;  ///< From here on a frame may begin that is not complete.
};

inline Decoded decode(std::string_view bytes) {
  Decoded decoded;
  std::size_t offset = 0;
  while (offset < bytes.size()) {
    const std::string_view rest = bytes.substr(offset, 11);
    const bool may_begin = byte_at(rest, 0) == 0x55 && (rest.size() < 2 || byte_at(rest, 1) / 16 == 0x5);
    if (may_begin && rest.size() < 11) break;
    if (may_begin && sum_of(rest.substr(0, 10)) == byte_at(rest, 10)) {
      FoundFrame found{offset, byte_at(rest, 1)};
      for (std::size_t i = 0; i < 4; ++i) {
        const int pattern = byte_at(rest, 2 + 2 * i) + 256 * byte_at(rest, 3 + 2 * i);
        found.words[i] = pattern < 32768 ? pattern : pattern - 65536;
      }
      decoded.frames.push_back(found);
      offset += 11;
      continue;
    }
    if (may_begin) ++decoded.bad_frames;
    ++decoded.skipped_bytes;
    ++offset;
  }
  decoded.undecided_from = offset;
  return decoded;
}

}  // namespace abcal::test::witmotion_reference
