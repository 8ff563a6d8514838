// Fuzz target of the APT codec: whatever the bytes, messages are found where a slow reference finds them, and
// every value is that of its bytes, read one by one.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/thorlabs_apt/codec.h"

namespace {

namespace apt = abcal::thorlabs_apt;
using Bytes = std::vector<unsigned>;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "APT codec and reference differ: %s\n", what);
  std::abort();
}

/// Whether a message to the host may begin at `at`, as far as there are bytes.
bool may_begin(const Bytes& bytes, std::size_t at) {
  const std::size_t left = bytes.size() - at;
  if (left > 4) {
    if (bytes[at + 4] != 0x01 && bytes[at + 4] != 0x81) return false;
    if (bytes[at + 4] == 0x81 && (bytes[at + 3] != 0 || bytes[at + 2] == 0)) return false;
  }
  if (left > 5) {
    const unsigned source = bytes[at + 5];
    if (source != 0x11 && source != 0x50 && (source < 0x21 || source > 0x2A)) return false;
  }
  return true;
}

std::int64_t signed_value(const Bytes& bytes, std::size_t at) {
  std::int64_t value = 0;
  for (std::size_t n = 0; n < 4; ++n) value += static_cast<std::int64_t>(bytes[at + n]) << (8 * n);
  return value >= 0x80000000LL ? value - 0x100000000LL : value;
}

void check_values(const Bytes& bytes, const apt::Message& message) {
  require(message.id == bytes[0] + 256 * bytes[1], "id");
  require(message.source == bytes[5], "source");
  require(message.data.size() == bytes.size() - 6, "size of the data");
  if (message.data.empty())
    require(message.parameters[0] == bytes[2] && message.parameters[1] == bytes[3], "parameters");
  const auto status = apt::parse_status(message);
  require(status.has_value() == ((message.id == 0x0481 || message.id == 0x0491) && bytes.size() == 20),
          "status");
  if (status) {
    require(status->position == signed_value(bytes, 8), "position");
    require(status->bits == static_cast<std::uint32_t>(signed_value(bytes, 16)), "status bits");
    const bool moving = (bytes[16] & 0xF0U) != 0 || (bytes[17] & 0x02U) != 0;
    require(status->moving() == moving && status->homed() == ((bytes[17] & 0x04U) != 0),
            "meaning of the bits");
  }
  const auto velocity = apt::parse_velocity(message);
  require(velocity.has_value() == (message.id == 0x0415 && bytes.size() == 20), "velocity");
  if (velocity)
    require(velocity->minimum == signed_value(bytes, 8) &&
                velocity->acceleration == signed_value(bytes, 12) &&
                velocity->maximum == signed_value(bytes, 16),
            "values of the velocity");
  if (const auto info = apt::parse_info(message)) {
    require(message.id == 0x0006 && bytes.size() == 90 && !info->model.empty(), "identity");
    require(info->serial_number == static_cast<std::uint32_t>(signed_value(bytes, 6)), "serial number");
    for (std::size_t n = 0; n < info->model.size(); ++n)
      require(bytes[10 + n] == static_cast<unsigned char>(info->model[n]), "model");
    apt::find_controller(info->model);
  }
  if (const auto stage = apt::parse_stage_name(message)) {
    require(message.id == 0x04F2 && bytes.size() == 80 && stage->size() <= 16, "stage");
    apt::counts_per_degree(*stage);
  }
  if (const auto refusal = apt::parse_refusal(message))
    require(message.id == 0x0080 || refusal->code == static_cast<int>(bytes[8] + 256 * bytes[9]), "refusal");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const Bytes all(data, data + size);
  for (std::size_t at = 0; at < size;) {
    std::size_t begin = at;
    while (begin < size && !may_begin(all, begin)) ++begin;
    std::size_t length = begin - at;
    if (begin == at) {
      length = 6;
      if (size - at >= 6 && all[at + 4] == 0x81) length += all[at + 2];
    }
    const std::string_view rest = text.substr(at);
    const auto verdict = apt::check_message(rest);
    if (length > rest.size()) {
      require(verdict.check == abcal::wire::FrameCheck::kNeedMore, "a message that is not whole");
      require(!apt::parse_message(rest), "a half message is read");
      return 0;
    }
    require(verdict.check == abcal::wire::FrameCheck::kComplete && verdict.length == length, "length");
    if (begin == at) {
      const auto message = apt::parse_message(rest.substr(0, length));
      require(message.has_value(), "a message that is not read");
      const auto first = all.begin() + static_cast<std::ptrdiff_t>(at);
      check_values(Bytes(first, first + static_cast<std::ptrdiff_t>(length)), *message);
    }
    at += length;
  }
  return 0;
}
