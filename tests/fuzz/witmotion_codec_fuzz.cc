// Fuzz target of the WitMotion codec: whatever the bytes and however they are split, the parser finds exactly
// the frames that the slow reference finds, and gives each the values that the reference reads.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// witmotion_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string_view>

#include "drivers/witmotion/codec.h"
#include "tests/drivers/witmotion/reference_decoder.h"

namespace {

namespace witmotion = abcal::witmotion;
namespace reference = abcal::test::witmotion_reference;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "WitMotion codec and reference differ: %s\n", what);
  std::abort();
}

void confirm_frame(const witmotion::Frame& frame, const reference::FoundFrame& expected) {
  require(frame.type == expected.type, "type");
  for (std::size_t i = 0; i < 4; ++i) require(frame.words[i] == (expected.words[i] + 65536) % 65536, "word");
  const auto acceleration = witmotion::decode_acceleration(frame);
  require(acceleration.has_value() == (expected.type == 0x51), "whether it is an acceleration");
  if (!acceleration) return;
  bool clipped = false;
  for (std::size_t i = 0; i < 3; ++i) {
    const int word = expected.words[i];
    require(acceleration->output_g(static_cast<Eigen::Index>(i)) == word * 16.0 / 32768.0, "acceleration");
    clipped = clipped || word == -32768 || word == 32767;
  }
  require(acceleration->clipped == clipped, "clipping");
  require(acceleration->temperature_degc == expected.words[3] / 100.0, "temperature");
}

}  // namespace

// The first byte says how the rest is split.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::size_t piece = 1 + data[0] % 32;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  const reference::Decoded expected = reference::decode(bytes);

  witmotion::FrameParser parser;
  std::size_t found = 0;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto frame = parser.next()) {
      require(found < expected.frames.size(), "a frame too many");
      require(found * witmotion::kFrameBytes + parser.skipped_bytes() == expected.frames[found].offset,
              "place");
      confirm_frame(*frame, expected.frames[found++]);
    }
  }
  require(found == expected.frames.size(), "a frame missing");
  require(parser.bad_frames() == expected.bad_frames, "bad frames");
  require(parser.skipped_bytes() == expected.skipped_bytes, "skipped bytes");
  require(parser.has_partial() == (expected.undecided_from < bytes.size()), "bytes held back");
  parser.lose_track();
  require(found * witmotion::kFrameBytes + parser.skipped_bytes() == bytes.size(),
          "bytes lost or given twice");
  return 0;
}
