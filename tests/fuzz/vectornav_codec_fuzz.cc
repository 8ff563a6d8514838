// Fuzz target of the VectorNav codec: whatever the bytes and however they are split, the parser finds the
// messages that a slow reference decoder finds, at the same places, and counts the rest; and no decoder reads
// beyond its data.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// vectornav_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string_view>

#include "drivers/vectornav/codec.h"
#include "tests/drivers/vectornav/reference_decoder.h"

namespace {

namespace vectornav = abcal::vectornav;
namespace reference = abcal::test::vectornav_reference;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "VectorNav codec and reference decoder differ: %s\n", what);
  std::abort();
}

float float_at(std::string_view bytes, std::size_t at) {
  std::uint32_t bits = 0;
  for (std::size_t i = 4; i-- > 0;) bits = bits * 256 + reference::byte_at(bytes, at + i);
  return std::bit_cast<float>(bits);
}

bool same(double a, float b) {
  return a == static_cast<double>(b) || (a != a && b != b);
}

/// Checks the output that the driver sets: header 6, time 8, acceleration 12, temperature 4, CRC 2.
void confirm_reading(const vectornav::BinaryMessage& message, std::string_view whole) {
  if (!whole.starts_with(std::string_view("\xFA\x05\x01\x01\x10\x00", 6))) return;
  const auto measurement = vectornav::decode_binary_measurement(message);
  require(measurement && measurement->time_startup_ns && measurement->temperature_degc,
          "a reading is missing");
  for (std::size_t i = 0; i < 3; ++i)
    require(same(measurement->acceleration_mps2(static_cast<Eigen::Index>(i)), float_at(whole, 14 + 4 * i)),
            "acceleration");
  require(same(*measurement->temperature_degc, float_at(whole, 26)), "temperature");
  std::uint64_t time = 0;
  for (std::size_t i = 8; i-- > 0;) time = time * 256 + reference::byte_at(whole, 6 + i);
  require(*measurement->time_startup_ns == time, "time");
}

/// The numbers of a line as the C library reads them, where it has the right number of them.
void confirm_line(std::string_view text) {
  const auto measurement = vectornav::decode_text_measurement(text);
  if (!measurement) return;
  const std::size_t skipped = text.starts_with("VNACC")   ? 0
                              : text.starts_with("VNYMR") ? 6
                              : text.starts_with("VNQMR") ? 7
                                                          : 3;
  const std::string line(text);
  const char* at = line.c_str();
  for (std::size_t i = 0; i <= skipped; ++i) at = std::strchr(at, ',') + 1;
  for (int i = 0; i < 3; ++i) {
    const double expected = std::strtod(at, nullptr);
    const double found = measurement->acceleration_mps2(i);
    require(found == expected || (found != found && expected != expected), "a number of a line");
    const char* comma = std::strchr(at, ',');
    if (comma == nullptr) break;
    at = comma + 1;
  }
}

/// '$', the text, '*', the checksum and the end of the line.
std::size_t size_on_the_wire(const vectornav::TextMessage& message) {
  const std::size_t digits = message.checksum == vectornav::Checksum::kXor8 ? 2 : 4;
  return message.text.size() + digits + (message.carriage_return ? 4 : 3);
}

}  // namespace

// The first byte says how the rest is split.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::size_t piece = 1 + data[0] % 64;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  const reference::Decoded expected = reference::decode(bytes);

  vectornav::MessageParser parser;
  std::size_t found = 0;
  std::size_t used = 0;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto message = parser.next()) {
      require(found < expected.messages.size(), "a message too many");
      const reference::FoundMessage& other = expected.messages[found++];
      require(used + parser.skipped_bytes() == other.offset, "place");
      if (const auto* text = std::get_if<vectornav::TextMessage>(&*message)) {
        require(!other.binary && text->text == other.content, "text");
        used += size_on_the_wire(*text);
        confirm_line(text->text);
      } else {
        const auto& binary = std::get<vectornav::BinaryMessage>(*message);
        require(other.binary, "kind");
        require(other.content.ends_with(std::string(binary.payload) +
                                        other.content.substr(other.content.size() - 2)),
                "payload");
        require(vectornav::binary_size(binary.fields) == other.content.size(), "size");
        used += other.content.size();
        confirm_reading(binary, other.content);
        std::size_t of_fields = 0;
        for (unsigned group = 0; group < vectornav::kGroups; ++group) {
          for (unsigned bit = 0; bit < 16; ++bit) {
            const auto field = vectornav::field(binary, static_cast<vectornav::Group>(group),
                                                static_cast<std::uint8_t>(bit));
            if (field) of_fields += field->size();
          }
        }
        require(of_fields == binary.payload.size(), "fields do not fill the payload");
      }
    }
  }
  require(found == expected.messages.size(), "a message missing");
  require(parser.bad_frames() == expected.bad_frames, "bad checksums");
  require(parser.skipped_bytes() == expected.skipped_bytes, "skipped bytes");
  require(parser.has_partial() == (expected.undecided_from < bytes.size()), "bytes held back");

  // The line falls silent: messages found behind a false beginning are whole, and nothing is given twice.
  std::size_t whole = used;
  while (const auto message = parser.next_behind_partial()) {
    const auto* text = std::get_if<vectornav::TextMessage>(&*message);
    if (text == nullptr) {
      whole += *vectornav::binary_size(std::get<vectornav::BinaryMessage>(*message).fields);
    } else {
      whole += size_on_the_wire(*text);
    }
  }
  require(whole + parser.skipped_bytes() <= bytes.size(), "bytes given twice");
  // Any text at all may be shown to the decoder of lines.
  confirm_line(bytes);
  return 0;
}
