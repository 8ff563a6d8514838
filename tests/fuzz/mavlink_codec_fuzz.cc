// Fuzz target of the MAVLink codec: whatever the bytes, and however they are split, frames are found where a
// slow reference finds them, with the checksum computed bit by bit, and every value is that of its bytes.

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/mavlink/codec.h"

namespace {

namespace mav = abcal::mavlink;
using Bytes = std::vector<unsigned>;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "MAVLink codec and reference differ: %s\n", what);
  std::abort();
}

struct Kind {
  unsigned seed, base, full;
};
const std::map<unsigned, Kind>& kinds() {
  static const std::map<unsigned, Kind> all{{0, {50, 9, 9}},     {1, {124, 31, 43}},  {2, {137, 12, 12}},
                                            {20, {214, 20, 20}}, {22, {220, 25, 25}}, {23, {168, 23, 23}},
                                            {26, {170, 22, 24}}, {27, {144, 26, 29}}, {30, {39, 28, 28}},
                                            {76, {152, 33, 33}}, {77, {143, 3, 10}},  {105, {93, 62, 63}},
                                            {116, {76, 22, 24}}, {129, {46, 22, 24}}, {148, {178, 60, 78}}};
  return all;
}

/// CRC-16 with the polynomial 1021, reflected.
unsigned slow_crc(const Bytes& bytes, std::size_t first, std::size_t end, unsigned seed) {
  unsigned crc = 0xFFFF;
  for (std::size_t n = first; n <= end; ++n) {
    crc ^= n == end ? seed : bytes[n];
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0 ? (crc >> 1U) ^ 0x8408U : crc >> 1U;
  }
  return crc;
}

struct Found {
  std::size_t at, size;
  unsigned id;
  bool known;
};

/// Frames in the bytes from the front, up to a frame that is not whole.
std::vector<Found> slow_frames(const Bytes& bytes) {
  std::vector<Found> found;
  bool due = false;
  for (std::size_t at = 0; at < bytes.size();) {
    const bool two = bytes[at] == 0xFD;
    if (!two && bytes[at] != 0xFE) {
      due = false;
      ++at;
      continue;
    }
    const std::size_t header = two ? 10 : 6;
    if (at + header > bytes.size()) break;
    const unsigned id = two ? bytes[at + 7] + 256 * bytes[at + 8] + 65536 * bytes[at + 9] : bytes[at + 5];
    const std::size_t length = bytes[at + 1];
    const std::size_t size = header + length + 2 + (two && bytes[at + 2] % 2 == 1 ? 13 : 0);
    const auto kind = kinds().find(id);
    const bool readable = kind != kinds().end() && (!two || bytes[at + 2] < 2);
    const bool too_long_or_short =
        readable && !two && (length < kind->second.base || length > kind->second.full);
    if ((!readable && !due) || too_long_or_short) {
      due = false;
      ++at;
      continue;
    }
    if (at + size > bytes.size()) break;
    if (readable) {
      const std::size_t end = at + header + length;
      const bool sound = slow_crc(bytes, at + 1, end, kind->second.seed) == bytes[end] + 256 * bytes[end + 1];
      if (!sound) {
        due = false;
        ++at;
        continue;
      }
    }
    found.push_back({at, size, id, readable});
    at += size;
    due = true;
  }
  return found;
}

std::int64_t word(const std::string& payload, std::size_t at) {
  const int value =
      static_cast<unsigned char>(payload[at]) + 256 * static_cast<unsigned char>(payload[at + 1]);
  return value >= 32768 ? value - 65536 : value;
}

float slow_float(const std::string& payload, std::size_t at) {
  std::uint32_t bits = 0;
  for (std::size_t n = 4; n > 0; --n) bits = bits * 256U + static_cast<unsigned char>(payload[at + n - 1]);
  return std::bit_cast<float>(bits);
}

bool same(double a, double b) {
  return a == b || (std::isnan(a) && std::isnan(b));
}

void check_values(const mav::Frame& frame) {
  const auto acceleration = mav::decode_acceleration(frame);
  if (!frame.known) {
    require(!acceleration && !mav::decode_heartbeat(frame) && !mav::decode_version(frame) &&
                !mav::decode_acknowledgement(frame),
            "values of a frame that was not examined");
    return;
  }
  require(frame.payload.size() >= kinds().at(frame.id).full, "a payload that is not filled up");
  if (acceleration) {
    require(frame.id == 105 || frame.id == 26, "acceleration of another message");
    for (std::size_t j = 0; j < 3; ++j) {
      const double is = acceleration->output_mps2[static_cast<int>(j)];
      const double should = frame.id == 105
                                ? static_cast<double>(slow_float(frame.payload, 8 + 4 * j))
                                : static_cast<double>(word(frame.payload, 4 + 2 * j)) * 9.80665 / 1000.0;
      require(same(is, should), "acceleration");
    }
  }
  require(mav::decode_heartbeat(frame).has_value() == (frame.id == 0), "heartbeat");
  const auto parameter = mav::decode_parameter(frame, mav::kArduPilot);
  require(parameter.has_value() == (frame.id == 22), "parameter");
  if (parameter) {
    require(same(parameter->value, static_cast<double>(slow_float(frame.payload, 0))),
            "value of a parameter");
    require(parameter->name.size() <= 16 && frame.payload.substr(8).starts_with(parameter->name), "name");
  }
  if (const auto said = mav::decode_acknowledgement(frame)) {
    require(frame.id == 77 && (word(frame.payload, 0) & 0xFFFF) == said->command, "acknowledgement");
    require(!mav::result_in_words(said->result).empty(), "words of a result");
  }
  if (const auto version = mav::decode_version(frame))
    require(frame.id == 148 && version->serial_number.size() <= 36, "version");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const std::vector<Found> expected = slow_frames(Bytes(data, data + size));
  // The length of the first piece depends on the input, too.
  const std::size_t cut = size == 0 ? 0 : data[size - 1] % size;
  mav::FrameParser parser;
  std::size_t count = 0;
  std::size_t used = 0;
  for (const std::string_view piece : {text.substr(0, cut), text.substr(cut)}) {
    parser.feed(piece);
    while (const auto frame = parser.next()) {
      require(count < expected.size(), "one frame too many");
      const Found& one = expected[count++];
      require(frame->id == one.id && frame->size == one.size && frame->known == one.known, "frame");
      used += frame->size;
      check_values(*frame);
    }
  }
  require(count == expected.size(), "a frame is missing");
  while (const auto frame = parser.next_behind_partial()) {
    used += frame->size;
    check_values(*frame);
  }
  require(!parser.has_partial() && used + parser.skipped_bytes() == size, "bytes are counted");
  return 0;
}
