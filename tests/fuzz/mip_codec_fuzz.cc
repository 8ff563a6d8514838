// Fuzz target of the MIP codec: whatever the bytes and however they are split, the parser finds the packets
// that a slow reference decoder finds, at the same places, and counts the rest; and no decoder of a field
// reads beyond it.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// mip_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string_view>

#include "drivers/microstrain_mip/codec.h"
#include "tests/drivers/microstrain_mip/reference_decoder.h"

namespace {

namespace mip = abcal::mip;
namespace reference = abcal::test::mip_reference;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "MIP codec and reference decoder differ: %s\n", what);
  std::abort();
}

void decode_all(const mip::Packet& packet) {
  const auto fields = mip::split_fields(packet.payload);
  std::size_t bytes = 0;
  for (const mip::Field& field : fields.value_or(std::vector<mip::Field>())) {
    bytes += field.data.size() + 2;
    const std::string_view data = field.data;
    require(mip::decode_scaled_accelerometer(data).has_value() == (data.size() == 12),
            "scaled accelerometer");
    require(mip::decode_temperature(data).has_value() == (data.size() == 12), "temperature");
    require(mip::decode_gps_timestamp(data).has_value() == (data.size() == 12), "GPS timestamp");
    require(mip::decode_over_range(data).has_value() == (data.size() == 2), "over-range status");
    require(mip::decode_device_info(data).has_value() == (data.size() == 82), "device info");
    require(mip::decode_descriptors(data).has_value() == (data.size() % 2 == 0), "descriptors");
    require(mip::decode_acknowledgement(data).has_value() == (data.size() == 2), "acknowledgement");
    const auto time = mip::decode_reference_time(data);
    require(time.has_value() == (data.size() == 8), "length of the reference time");
    if (time) require(*time == reference::number(data), "reference time");
  }
  if (fields) require(bytes == packet.payload.size(), "fields do not fill the payload");
}

}  // namespace

// The first byte says how the rest is split.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::size_t piece = 1 + data[0] % 64;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  const reference::Decoded expected = reference::decode(bytes);

  mip::PacketParser parser;
  std::size_t found = 0;
  std::size_t used = 0;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto packet = parser.next()) {
      require(found < expected.packets.size(), "a packet too many");
      const reference::FoundPacket& other = expected.packets[found++];
      require(used + parser.skipped_bytes() == other.offset, "place");
      require(packet->descriptor_set == other.set, "descriptor set");
      require(packet->payload == other.payload, "payload");
      used += packet->payload.size() + mip::kPacketOverhead;
      decode_all(*packet);
    }
  }
  require(found == expected.packets.size(), "a packet missing");
  require(parser.bad_frames() == expected.bad_frames, "bad checksums");
  require(parser.skipped_bytes() == expected.skipped_bytes, "skipped bytes");
  require(parser.has_partial() == (expected.undecided_from < bytes.size()), "bytes held back");

  // The line falls silent: packets found behind a false beginning are whole, and nothing is given twice.
  while (const auto packet = parser.next_behind_partial()) {
    used += packet->payload.size() + mip::kPacketOverhead;
    decode_all(*packet);
  }
  require(used + parser.skipped_bytes() <= bytes.size(), "bytes given twice");
  return 0;
}
