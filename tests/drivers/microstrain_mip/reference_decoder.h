#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// MIP decoded the slow way, from docs/protocols/mip.md and without a line of the driver's codec: tests at
/// every byte of a whole recording whether a packet begins.
namespace abcal::test::mip_reference {

inline unsigned byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<unsigned char>(bytes[index]);
}

/// The checksum in closed form: a is the sum of the bytes, b the sum of the bytes weighted by their distance
/// from the end.
inline unsigned checksum(std::string_view bytes) {
  std::uint64_t a = 0;
  std::uint64_t b = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    a += byte_at(bytes, i);
    b += (bytes.size() - i) * byte_at(bytes, i);
  }
  return static_cast<unsigned>(a % 256 * 256 + b % 256);
}

struct FoundPacket {
  std::size_t offset = 0;
  unsigned set = 0;
  std::string payload;

  bool operator==(const FoundPacket&) const = default;
};

struct Decoded {
  std::vector<FoundPacket> packets;
  std::size_t bad_frames = 0;
  std::size_t skipped_bytes = 0;
  std::size_t undecided_from = 0;  ///< From here on a packet may begin that is not complete.
};

inline Decoded decode(std::string_view bytes) {
  Decoded decoded;
  std::size_t offset = 0;
  while (offset < bytes.size()) {
    const std::string_view rest = bytes.substr(offset);
    if (rest == "u" || rest == "ue" || (rest.size() == 3 && rest.starts_with("ue"))) break;
    if (rest.starts_with("ue")) {
      const std::size_t total = 6 + byte_at(rest, 3);
      if (rest.size() < total) break;
      if (checksum(rest.substr(0, total - 2)) == 256 * byte_at(rest, total - 2) + byte_at(rest, total - 1)) {
        decoded.packets.push_back({offset, byte_at(rest, 2), std::string(rest.substr(4, total - 6))});
        offset += total;
        continue;
      }
      ++decoded.bad_frames;
    }
    ++offset;
    ++decoded.skipped_bytes;
  }
  decoded.undecided_from = offset;
  return decoded;
}

inline std::uint64_t number(std::string_view bytes) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) value = value * 256 + byte_at(bytes, i);
  return value;
}

/// The data of the first field of this kind.
inline std::optional<std::string> field(const FoundPacket& packet, unsigned descriptor) {
  for (std::size_t i = 0; i + 1 < packet.payload.size();) {
    const std::size_t length = byte_at(packet.payload, i);
    if (length < 2 || i + length > packet.payload.size()) return std::nullopt;
    if (byte_at(packet.payload, i + 1) == descriptor) return packet.payload.substr(i + 2, length - 2);
    i += length;
  }
  return std::nullopt;
}

inline float float_at(std::string_view data, std::size_t index) {
  return std::bit_cast<float>(static_cast<std::uint32_t>(number(data.substr(index, 4))));
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

inline std::string packet(unsigned set, std::string_view payload) {
  std::string bytes = "ue" + bytes_of(set, 1) + bytes_of(payload.size(), 1) + std::string(payload);
  return bytes + bytes_of(checksum(bytes), 2);
}

inline std::string field_bytes(unsigned descriptor, std::string_view data) {
  return bytes_of(data.size() + 2, 1) + bytes_of(descriptor, 1) + std::string(data);
}

}  // namespace abcal::test::mip_reference
