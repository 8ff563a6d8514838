#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

/// Xbus decoded the slow way, from docs/protocols/xbus.md and without a line of the driver's codec: tests at
/// every byte of a whole recording whether a message begins.
namespace abcal::test::xbus_reference {

inline unsigned byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<unsigned char>(bytes[index]);
}

inline std::uint64_t number(std::string_view bytes) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) value = value * 256 + byte_at(bytes, i);
  return value;
}

/// Two's complement of `bytes`, as a whole number.
inline double signed_number(std::string_view bytes) {
  const double unsigned_value = static_cast<double>(number(bytes));
  const double range = std::ldexp(1.0, static_cast<int>(8 * bytes.size()));
  return unsigned_value >= range / 2 ? unsigned_value - range : unsigned_value;
}

inline unsigned sum(std::string_view bytes) {
  unsigned total = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) total += byte_at(bytes, i);
  return total % 256;
}

struct FoundMessage {
  std::size_t offset = 0;
  unsigned id = 0;
  std::string data;
};

struct Decoded {
  std::vector<FoundMessage> messages;
  std::size_t bad_frames = 0;
  std::size_t skipped_bytes = 0;
  std::size_t undecided_from = 0;  ///< From here on a message may begin that is not complete.
};

inline bool filled_by_items(std::string_view data) {
  std::size_t at = 0;
  while (at + 3 <= data.size()) at += 3 + byte_at(data, at + 2);
  return at == data.size();
}

inline Decoded decode(std::string_view bytes) {
  constexpr std::size_t kLongest = 2048;
  Decoded decoded;
  std::size_t offset = 0;
  while (offset < bytes.size()) {
    const std::string_view rest = bytes.substr(offset);
    const bool begins = rest.starts_with("\xFA\xFF") || rest == "\xFA";
    if (begins) {
      if (rest.size() < 4) break;
      std::size_t header = 4;
      std::size_t length = byte_at(rest, 3);
      if (length == 255) {
        header = 6;
        if (rest.size() < header) break;
        length = 256 * byte_at(rest, 4) + byte_at(rest, 5);
      }
      if (length <= kLongest) {
        const std::size_t total = header + length + 1;
        if (rest.size() < total) break;
        const std::string_view data = rest.substr(header, length);
        if (sum(rest.substr(1, total - 1)) == 0 && (byte_at(rest, 2) != 0x36 || filled_by_items(data))) {
          decoded.messages.push_back({offset, byte_at(rest, 2), std::string(data)});
          offset += total;
          continue;
        }
        ++decoded.bad_frames;
      }
    }
    ++offset;
    ++decoded.skipped_bytes;
  }
  decoded.undecided_from = offset;
  return decoded;
}

/// One real number in the format given by the lowest two bits of an id.
inline double real(unsigned id, std::string_view bytes) {
  switch (id % 4) {
    case 0:
      return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(number(bytes))));
    case 1:
      return std::ldexp(signed_number(bytes), -20);
    case 2:
      return signed_number(bytes.substr(4, 2)) +
             std::ldexp(static_cast<double>(number(bytes.substr(0, 4))), -32);
    default:
      return std::bit_cast<double>(number(bytes));
  }
}

// The other direction, for simulated answers.

inline std::string bytes_of(std::uint64_t value, std::size_t count) {
  std::string bytes(count, '\0');
  for (std::size_t i = count; i-- > 0; value /= 256) bytes[i] = static_cast<char>(value % 256);
  return bytes;
}

inline std::string float_bytes(float value) {
  return bytes_of(std::bit_cast<std::uint32_t>(value), 4);
}

inline std::string item(unsigned id, std::string_view data) {
  return bytes_of(id, 2) + bytes_of(data.size(), 1) + std::string(data);
}

inline std::string message(unsigned id, std::string_view data = {}) {
  std::string bytes = "\xFF" + bytes_of(id, 1);
  bytes += data.size() < 255 ? bytes_of(data.size(), 1) : "\xFF" + bytes_of(data.size(), 2);
  bytes += data;
  return "\xFA" + bytes + bytes_of((256 - sum(bytes)) % 256, 1);
}

/// MTData2 as the driver configures it, without temperature.
inline std::string data_message(unsigned counter, float x, float y, float z, unsigned status = 0x3,
                                std::string_view more_items = {}) {
  return message(0x36, item(0x1020, bytes_of(counter, 2)) + item(0x1060, bytes_of(100UL * counter, 4)) +
                           item(0x4020, float_bytes(x) + float_bytes(y) + float_bytes(z)) +
                           item(0xE020, bytes_of(status, 4)) + std::string(more_items));
}

}  // namespace abcal::test::xbus_reference
