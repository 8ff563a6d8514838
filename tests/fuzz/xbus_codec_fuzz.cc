// Fuzz target of the Xbus codec (Xsens): whatever the bytes and however they are split, the parser finds the
// messages that a slow reference decoder finds, at the same places, and counts the rest; and every value
// given is that of the reference.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// xbus_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string_view>

#include "drivers/xsens_mti/codec.h"
#include "tests/drivers/xsens_mti/reference_decoder.h"

namespace {

namespace xbus = abcal::xbus;
namespace reference = abcal::test::xbus_reference;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "Xbus codec and reference decoder differ: %s\n", what);
  std::abort();
}

bool same(double a, double b) {
  return a == b || (a != a && b != b);
}

void confirm_item(const xbus::Item& item) {
  constexpr std::size_t kBytes[] = {4, 4, 6, 8};
  const std::size_t size = kBytes[item.id % 4];
  const auto acceleration = xbus::decode_acceleration(item);
  require(acceleration.has_value() == (item.data.size() == 3 * size), "length of an acceleration");
  for (std::size_t i = 0; acceleration && i < 3; ++i)
    require(same((*acceleration)(static_cast<Eigen::Index>(i)),
                 reference::real(item.id, item.data.substr(i * size, size))),
            "acceleration");
  const auto temperature = xbus::decode_temperature(item);
  require(temperature.has_value() == (item.data.size() == size), "length of a temperature");
  if (temperature) require(same(*temperature, reference::real(item.id, item.data)), "temperature");
  const auto two = xbus::decode_u16(item.data);
  require(two.has_value() == (item.data.size() == 2), "length of a u16");
  if (two) require(*two == reference::number(item.data), "u16");
  const auto four = xbus::decode_u32(item.data);
  require(four.has_value() == (item.data.size() == 4), "length of a u32");
  if (four) require(*four == reference::number(item.data), "u32");
}

}  // namespace

// The first byte says how the rest is split.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::size_t piece = 1 + data[0] % 64;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  const reference::Decoded expected = reference::decode(bytes);

  xbus::MessageParser parser;
  std::size_t found = 0;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto message = parser.next()) {
      require(found < expected.messages.size(), "a message too many");
      const reference::FoundMessage& other = expected.messages[found++];
      require(message->id == other.id, "id");
      require(message->data == other.data, "data");
      if (message->id == xbus::kSetOutputConfiguration + 1)
        require(
            xbus::decode_output_configuration(message->data).has_value() == (message->data.size() % 4 == 0),
            "output configuration");
      if (message->id != xbus::kMtData2) continue;
      const auto items = xbus::split_items(message->data);
      require(items.has_value(), "items");
      for (const xbus::Item& item : *items) confirm_item(item);
    }
  }
  require(found == expected.messages.size(), "a message missing");
  require(parser.bad_frames() == expected.bad_frames, "bad messages");
  require(parser.skipped_bytes() == expected.skipped_bytes, "skipped bytes");
  require(parser.has_partial() == (expected.undecided_from < bytes.size()), "bytes held back");

  // The line falls silent: messages found behind a false beginning are whole, and nothing is given twice.
  std::size_t used = expected.undecided_from - expected.skipped_bytes;
  while (const auto message = parser.next_behind_partial()) used += message->data.size() + 5;  // At least.
  require(used + parser.skipped_bytes() <= bytes.size(), "bytes given twice");
  return 0;
}
