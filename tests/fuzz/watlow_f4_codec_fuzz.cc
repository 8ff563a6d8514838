// Fuzz target of the Modbus codec of the Watlow chambers: whatever the bytes, a frame is given exactly where
// a slow reference (the sum as the standard defines it) finds one, with the same contents.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include "drivers/watlow_f4/codec.h"

namespace {

namespace watlow = abcal::watlow_f4;
using Bytes = std::vector<unsigned>;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "Modbus codec and reference differ: %s\n", what);
  std::abort();
}

/// The remainder of a division of polynomials, bit by bit, lowest bit first.
unsigned reference_sum(const Bytes& bytes) {
  unsigned rest = 0xFFFF;
  for (const unsigned byte : bytes) {
    for (unsigned bit = 0; bit < 8; ++bit) {
      const bool apply = ((rest ^ byte >> bit) & 1U) != 0U;
      rest >>= 1U;
      if (apply) rest ^= 0xA001U;
    }
  }
  return rest;
}

/// Length of a reply from its function code on; nothing: none, or not all there.
std::optional<std::size_t> reference_length(const Bytes& pdu) {
  if (pdu.empty()) return std::nullopt;
  const unsigned function = pdu[0] % 128;
  if (function != 3 && function != 4 && function != 6 && function != 8 && function != 16) return std::nullopt;
  std::size_t length = 5;
  if (pdu[0] >= 128) {
    length = 2;
  } else if (function < 5) {
    if (pdu.size() < 2 || pdu[1] == 0 || pdu[1] % 2 == 1 || pdu[1] > 251) return std::nullopt;
    length = pdu[1] + 2;
  }
  return pdu.size() < length ? std::nullopt : std::optional(length);
}

std::optional<std::size_t> reference_frame(watlow::Framing framing, const Bytes& bytes) {
  const bool tcp = framing == watlow::Framing::kTcp;
  const std::size_t head = tcp ? 7 : 1;
  if (bytes.size() <= head) return std::nullopt;
  const auto length = reference_length({bytes.begin() + static_cast<std::ptrdiff_t>(head), bytes.end()});
  if (!length) return std::nullopt;
  if (tcp) {
    if (bytes[2] != 0 || bytes[3] != 0 || bytes[4] * 256 + bytes[5] != *length + 1) return std::nullopt;
    return head + *length;
  }
  const std::size_t end = head + *length;
  if (bytes.size() < end + 2) return std::nullopt;
  const unsigned sum = reference_sum({bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(end)});
  if (bytes[end] + 256 * bytes[end + 1] != sum) return std::nullopt;
  return end + 2;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  for (const watlow::Framing framing : {watlow::Framing::kRtu, watlow::Framing::kTcp}) {
    for (std::size_t at = 0; at < size && at < 64; ++at) {
      const std::string rest = text.substr(at);
      const auto expected = reference_frame(framing, {data + at, data + size});
      const auto verdict = watlow::check_reply(framing, rest);
      require((verdict.check == abcal::wire::FrameCheck::kComplete) == expected.has_value(),
              "whether it is one");
      if (!expected) continue;
      require(verdict.length == *expected, "length");
      const auto reply = watlow::parse_reply(framing, rest.substr(0, *expected));
      const std::size_t head = framing == watlow::Framing::kTcp ? 7 : 1;
      const unsigned code = static_cast<unsigned char>(rest[head]);
      const bool nothing_wrong = code >= 128 && rest[head + 1] == 0;
      require(reply.has_value() != nothing_wrong, "whether it has a meaning");
      if (!reply) continue;
      require(reply->function == static_cast<int>(code % 128), "function");
      require((reply->exception != 0) == (code >= 128), "exception");
      for (std::size_t n = 0; n < reply->registers.size(); ++n)
        require(reply->registers[n] == static_cast<unsigned char>(rest[head + 2 + 2 * n]) * 256 +
                                           static_cast<unsigned char>(rest[head + 3 + 2 * n]),
                "register");
      for (const std::uint16_t each : reply->registers) {
        if (const auto value = watlow::decimal_of(each, 1))
          require(std::lround(*value * 10.0) == static_cast<std::int16_t>(each), "decimal");
      }
    }
  }
  return 0;
}
