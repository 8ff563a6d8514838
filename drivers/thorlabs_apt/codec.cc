#include "drivers/thorlabs_apt/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace abcal::thorlabs_apt {
namespace {

constexpr std::size_t kHeader = 6;
constexpr std::size_t kMostData = 255;
constexpr std::uint8_t kHasData = 0x80;
constexpr std::size_t kInfoSize = 84;

std::uint8_t byte_at(std::string_view bytes, std::size_t at) {
  return static_cast<std::uint8_t>(bytes[at]);
}

std::uint32_t little_endian(std::string_view bytes, std::size_t at, std::size_t size) {
  std::uint32_t value = 0;
  for (std::size_t n = size; n > 0; --n) value = value << 8U | byte_at(bytes, at + n - 1);
  return value;
}

std::int32_t signed_at(std::string_view bytes, std::size_t at) {
  return static_cast<std::int32_t>(little_endian(bytes, at, 4));
}

void append(std::string& bytes, std::uint32_t value, std::size_t size) {
  for (std::size_t n = 0; n < size; ++n) bytes += static_cast<char>(value >> (8U * n) & 0xFFU);
}

/// Text of a fixed width, up to its first NUL; nullopt if a byte is not printable.
std::optional<std::string> text_at(std::string_view bytes, std::size_t at, std::size_t width) {
  std::string_view text = bytes.substr(at, width);
  text = text.substr(0, text.find('\0'));
  while (text.ends_with(' ')) text.remove_suffix(1);
  if (!std::all_of(text.begin(), text.end(), [](char c) { return c >= 0x20 && c < 0x7F; }))
    return std::nullopt;
  return std::string(text);
}

/// Whether as many bytes as there are, up to a header, can be the beginning of a message to the host.
bool can_begin(std::string_view bytes) {
  if (bytes.size() < 5) return true;
  const std::uint8_t destination = byte_at(bytes, 4);
  if (destination != kHost && destination != (kHost | kHasData)) return false;
  if (destination == (kHost | kHasData)) {
    const std::uint32_t size = little_endian(bytes, 2, 2);
    if (size == 0 || size > kMostData) return false;
  }
  if (bytes.size() < kHeader) return true;
  const std::uint8_t source = byte_at(bytes, 5);
  return source == kRack || source == kUnit || (source > 0x20 && source <= 0x2A);
}

}  // namespace

std::string short_message(std::uint16_t id, std::uint8_t first, std::uint8_t second,
                          std::uint8_t destination) {
  std::string bytes;
  append(bytes, id, 2);
  for (const std::uint8_t byte : {first, second, destination, kHost}) append(bytes, byte, 1);
  return bytes;
}

std::string long_message(std::uint16_t id, std::uint8_t destination, std::string_view data) {
  std::string bytes;
  append(bytes, id, 2);
  append(bytes, static_cast<std::uint32_t>(data.size()), 2);
  append(bytes, destination | kHasData, 1);
  append(bytes, kHost, 1);
  return bytes.append(data);
}

wire::FrameVerdict check_message(std::string_view bytes) {
  std::size_t begin = 0;
  while (begin < bytes.size() && !can_begin(bytes.substr(begin, kHeader))) ++begin;
  if (begin > 0) return {wire::FrameCheck::kComplete, begin};
  if (bytes.size() < kHeader) return {wire::FrameCheck::kNeedMore, 0};
  const bool has_data = (byte_at(bytes, 4) & kHasData) != 0;
  const std::size_t size = kHeader + (has_data ? little_endian(bytes, 2, 2) : 0U);
  if (bytes.size() < size) return {wire::FrameCheck::kNeedMore, 0};
  return {wire::FrameCheck::kComplete, size};
}

std::optional<Message> parse_message(std::string_view frame) {
  if (frame.size() < kHeader || !can_begin(frame.substr(0, kHeader))) return std::nullopt;
  const bool has_data = (byte_at(frame, 4) & kHasData) != 0;
  if (frame.size() != kHeader + (has_data ? little_endian(frame, 2, 2) : 0U)) return std::nullopt;
  Message message;
  message.id = static_cast<std::uint16_t>(little_endian(frame, 0, 2));
  message.source = byte_at(frame, 5);
  if (has_data) {
    message.data = frame.substr(kHeader);
  } else {
    message.parameters = {byte_at(frame, 2), byte_at(frame, 3)};
  }
  return message;
}

std::optional<HardwareInfo> parse_info(const Message& message) {
  if (message.id != kInfo || message.data.size() != kInfoSize) return std::nullopt;
  const auto model = text_at(message.data, 4, 8);
  if (!model || model->empty()) return std::nullopt;
  return HardwareInfo{little_endian(message.data, 0, 4), *model,
                      fmt::format("{}.{}.{}", byte_at(message.data, 16), byte_at(message.data, 15),
                                  byte_at(message.data, 14))};
}

bool Status::moving() const {
  constexpr std::uint32_t kMoves = 0x2F0;  // turning, jogging, homing
  return (bits & kMoves) != 0;
}

bool Status::homed() const {
  return (bits >> 10U & 1U) != 0;
}

std::string_view Status::fault() const {
  constexpr std::array<std::pair<unsigned, std::string_view>, 8> kFaults{
      {{14, "motion error: it does not follow"},
       {15, "error of the controller"},
       {16, "interlock open"},
       {17, "motor or driver too hot"},
       {18, "supply voltage out of range"},
       {19, "commutation error"},
       {25, "encoder fault"},
       {26, "motor current too high"}}};
  for (const auto& [bit, text] : kFaults)
    if ((bits >> bit & 1U) != 0) return text;
  return {};
}

std::optional<Status> parse_status(const Message& message) {
  constexpr std::size_t kStatusSize = 14;
  if ((message.id != kStatus && message.id != kServoStatus) || message.data.size() != kStatusSize)
    return std::nullopt;
  return Status{signed_at(message.data, 2), little_endian(message.data, 10, 4)};
}

std::optional<Velocity> parse_velocity(const Message& message) {
  constexpr std::size_t kVelocitySize = 14;
  if (message.id != kVelocity || message.data.size() != kVelocitySize) return std::nullopt;
  return Velocity{signed_at(message.data, 2), signed_at(message.data, 6), signed_at(message.data, 10)};
}

std::string set_velocity(std::uint8_t destination, std::uint8_t channel, const Velocity& velocity) {
  std::string data;
  append(data, channel, 2);
  for (const std::int32_t value : {velocity.minimum, velocity.acceleration, velocity.maximum})
    append(data, static_cast<std::uint32_t>(value), 4);
  return long_message(kSetVelocity, destination, data);
}

std::string move_absolute(std::uint8_t destination, std::uint8_t channel, std::int32_t position) {
  std::string data;
  append(data, channel, 2);
  append(data, static_cast<std::uint32_t>(position), 4);
  return long_message(kMoveAbsolute, destination, data);
}

std::optional<std::string> parse_stage_name(const Message& message) {
  constexpr std::size_t kParametersSize = 74;
  if (message.id != kStageParameters || message.data.size() != kParametersSize) return std::nullopt;
  return text_at(message.data, 6, 16);
}

std::optional<Refusal> parse_refusal(const Message& message) {
  if (message.id == kResponse && message.data.empty()) return Refusal{0, "the controller reports an error"};
  constexpr std::size_t kRichSize = 68;
  if (message.id != kRichResponse || message.data.size() != kRichSize) return std::nullopt;
  return Refusal{static_cast<int>(little_endian(message.data, 2, 2)),
                 text_at(message.data, 4, 64).value_or("its words cannot be read")};
}

namespace {

// Counts per degree, as Thorlabs states them for each stage (docs/protocols/thorlabs_apt.md).
constexpr std::array<std::pair<std::string_view, double>, 6> kStages{{{"DDR100", 3276800.0 / 360.0},
                                                                      {"DDR25", 1440000.0 / 360.0},
                                                                      {"DDR05", 2000000.0 / 360.0},
                                                                      {"HDR50", 75091.0 / 0.99997},
                                                                      {"K10CR1", 409600.0 / 3.0},
                                                                      {"PRM1-Z8", 1919.6418578623391}}};

}  // namespace

std::optional<double> counts_per_degree(std::string_view stage) {
  // "DDR100/M" is its metric variant.
  stage = stage.substr(0, stage.find('/'));
  for (const auto& [name, counts] : kStages)
    if (name == stage) return counts;
  return std::nullopt;
}

std::string known_stages() {
  std::string names;
  for (const auto& [name, counts] : kStages) names += (names.empty() ? "" : ", ") + std::string(name);
  return names;
}

std::optional<Controller> find_controller(std::string_view model) {
  constexpr double kVelocityUnit = 65536.0;
  constexpr double kBrushlessCycle = 102.4e-6;  // s
  constexpr double kBrushedCycle = 2048.0 / 6e6;
  constexpr double kStepperVelocity = 53.68;
  const auto is_one_of = [model](std::initializer_list<std::string_view> beginnings) {
    return std::any_of(beginnings.begin(), beginnings.end(),
                       [model](std::string_view each) { return model.starts_with(each); });
  };
  if (is_one_of({"BBD", "KBD", "TBD"})) return Controller{true, kBrushlessCycle * kVelocityUnit};
  if (is_one_of({"KDC", "TDC"})) return Controller{true, kBrushedCycle * kVelocityUnit};
  if (is_one_of({"K10CR", "BSC20", "SSC20", "KST", "TST101"})) return Controller{false, kStepperVelocity};
  return std::nullopt;
}

}  // namespace abcal::thorlabs_apt
