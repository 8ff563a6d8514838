#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// VectorNav messages decoded the slow way, from docs/protocols/vectornav.md and without a line of the
/// driver's codec: tests at every byte of a whole recording whether a message begins.
namespace abcal::test::vectornav_reference {

inline unsigned byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<unsigned char>(bytes[index]);
}

/// CRC-16-CCITT bit by bit: polynomial 0x1021, most significant bit first, start 0.
inline unsigned crc(std::string_view bytes) {
  unsigned value = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    for (unsigned bit = 0x80; bit != 0; bit /= 2) {
      const bool top = (value & 0x8000U) != 0;
      value = (value * 2) & 0xFFFFU;
      if (top != ((byte_at(bytes, i) & bit) != 0)) value ^= 0x1021U;
    }
  }
  return value;
}

inline unsigned exclusive_or(std::string_view bytes) {
  unsigned value = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) value ^= byte_at(bytes, i);
  return value;
}

inline std::string hex(unsigned value, int digits) {
  char text[8];
  std::snprintf(text, sizeof text, "%0*X", digits, value);
  return text;
}

inline std::string text_message(const std::string& text, bool with_crc = false) {
  return "$" + text + "*" + (with_crc ? hex(crc(text), 4) : hex(exclusive_or(text), 2)) + "\r\n";
}

inline std::string little_endian(std::uint64_t value, std::size_t count) {
  std::string bytes;
  for (std::size_t i = 0; i < count; ++i, value /= 256) bytes += static_cast<char>(value % 256);
  return bytes;
}
inline std::string float_bytes(float value) {
  return little_endian(std::bit_cast<std::uint32_t>(value), 4);
}

/// FA, header and payload as given, CRC.
inline std::string binary_message(std::string_view header_and_payload) {
  const unsigned sum = crc(header_and_payload);
  return '\xFA' + std::string(header_and_payload) + static_cast<char>(sum / 256) +
         static_cast<char>(sum % 256);
}

/// Message with the driver's configuration: time since startup, acceleration; temperature.
inline std::string data_message(std::uint64_t time_ns, float x, float y, float z, float temperature = 25.0F) {
  return binary_message(std::string("\x05\x01\x01\x10\x00", 5) + little_endian(time_ns, 8) + float_bytes(x) +
                        float_bytes(y) + float_bytes(z) + float_bytes(temperature));
}

struct FoundMessage {
  std::size_t offset = 0;
  bool binary = false;
  std::string content;  ///< Text between '$' and '*', or all of a binary message.
};

struct Decoded {
  std::vector<FoundMessage> messages;
  std::size_t bad_frames = 0;
  std::size_t skipped_bytes = 0;
  std::size_t undecided_from = 0;  ///< From here on a message may begin that is not complete.
};

enum class Kind { kNone, kIncomplete, kWhole };
struct Frame {
  Kind kind = Kind::kNone;
  std::size_t size = 0;
  bool right = false;
};

inline Frame text_frame(std::string_view rest) {
  constexpr std::size_t kLongest = 512;
  std::size_t end = 1;
  for (; end < rest.size(); ++end)
    if (byte_at(rest, end) < 0x20 || byte_at(rest, end) > 0x7E || rest[end] == '$') break;
  if (end > kLongest) return {};
  if (end == rest.size() || rest.substr(end) == "\r") return {Kind::kIncomplete};
  const std::size_t line_end = rest[end] == '\n' ? 1 : 2;  // A line feed alone is taken as well.
  if (line_end == 2 && rest.substr(end, 2) != "\r\n") return {};
  for (const std::size_t digits : {std::size_t{2}, std::size_t{4}}) {
    if (end < digits + 2 || rest[end - digits - 1] != '*') continue;
    const std::string_view sum = rest.substr(end - digits, digits);
    if (sum.find_first_not_of("0123456789ABCDEF") != std::string_view::npos) continue;
    const std::string_view text = rest.substr(1, end - digits - 2);
    return {Kind::kWhole, end + line_end,
            sum == (digits == 2 ? hex(exclusive_or(text), 2) : hex(crc(text), 4))};
  }
  return {};
}

inline Frame binary_frame(std::string_view rest) {
  // Bytes of the fields of each group, in their order, as the maker's own library has them; 0: not known.
  static const std::vector<std::vector<unsigned>> kGroups{
      {8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8, 0},
      {8, 8, 8, 2, 8, 8, 8, 4, 0, 0, 0, 0, 0, 0, 0, 0},
      {2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40, 0, 0, 0},
      {8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 0, 0, 0, 0},
      {2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24, 0, 0, 0, 0},
      {2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64, 0, 0, 0}};
  if (rest.size() < 2) return {Kind::kIncomplete};
  if (byte_at(rest, 1) == 0 || byte_at(rest, 1) > 0x3F) return {};
  std::size_t header = 2;
  std::size_t size = 2;
  for (unsigned group = 0; group < 6; ++group) {
    if (byte_at(rest, 1) / (1U << group) % 2 == 0) continue;
    if (rest.size() < header + 2) return {Kind::kIncomplete};
    const unsigned mask = byte_at(rest, header) + 256 * byte_at(rest, header + 1);
    if (mask == 0) return {};
    header += 2;
    size += 2;
    for (unsigned bit = 0; bit < 16; ++bit) {
      if (mask / (1U << bit) % 2 == 0) continue;
      if (kGroups[group][bit] == 0) return {};
      size += kGroups[group][bit];
    }
  }
  size += 2;
  if (rest.size() < size) return {Kind::kIncomplete};
  return {Kind::kWhole, size,
          crc(rest.substr(1, size - 3)) == 256 * byte_at(rest, size - 2) + byte_at(rest, size - 1)};
}

inline Decoded decode(std::string_view bytes) {
  Decoded decoded;
  std::size_t offset = 0;
  while (offset < bytes.size()) {
    const std::string_view rest = bytes.substr(offset);
    Frame frame;
    if (rest.front() == '$') frame = text_frame(rest);
    if (rest.front() == '\xFA') frame = binary_frame(rest);
    if (frame.kind == Kind::kIncomplete) break;
    if (frame.kind == Kind::kWhole && frame.right) {
      const bool binary = rest.front() == '\xFA';
      const std::string_view whole = rest.substr(0, frame.size);
      decoded.messages.push_back(
          {offset, binary, std::string(binary ? whole : whole.substr(1, whole.rfind('*') - 1))});
      offset += frame.size;
      continue;
    }
    if (frame.kind == Kind::kWhole) ++decoded.bad_frames;
    ++offset;
    ++decoded.skipped_bytes;
  }
  decoded.undecided_from = offset;
  return decoded;
}

}  // namespace abcal::test::vectornav_reference
