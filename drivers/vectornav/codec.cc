#include "drivers/vectornav/codec.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "drivers/text/names.h"
#include "drivers/text/number.h"

namespace abcal::vectornav {
namespace {

constexpr char kTextStart = '$';
constexpr char kBinaryStart = '\xFA';
constexpr std::size_t kCrcBytes = 2;
// The longest text of the manual's registers is well below 256 characters.
constexpr std::size_t kLongestText = 512;

/// Bytes of each field by group and bit; 0: not known. Group lengths as in VectorNav's own library
/// (vnproglib 1.1, upack.c); GNSS fields 12 on differ between firmwares, so they are left out.
constexpr std::uint8_t kFieldBytes[kGroups][16] = {
    {8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8, 0},    // common
    {8, 8, 8, 2, 8, 8, 8, 4, 0, 0, 0, 0, 0, 0, 0, 0},             // time
    {2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40, 0, 0, 0},    // IMU
    {8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 0, 0, 0, 0},        // GNSS
    {2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24, 0, 0, 0, 0},  // attitude
    {2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64, 0, 0, 0},   // INS
};

unsigned byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<std::uint8_t>(bytes[index]);
}

template <typename Unsigned>
Unsigned little_endian(std::string_view bytes) {
  Unsigned value = 0;
  for (std::size_t i = sizeof(Unsigned); i-- > 0;)
    value = static_cast<Unsigned>((value << 8U) | static_cast<Unsigned>(byte_at(bytes, i)));
  return value;
}

double float_at(std::string_view bytes, std::size_t index) {
  return static_cast<double>(std::bit_cast<float>(little_endian<std::uint32_t>(bytes.substr(index, 4))));
}

Eigen::Vector3d vector_at(std::string_view bytes) {
  return {float_at(bytes, 0), float_at(bytes, 4), float_at(bytes, 8)};
}

/// Upper case only, as the device writes it: a changed case would be a damaged byte that passes.
bool is_hex(char c) {
  return (c >= '0' && c <= '9') || (c >= 'A' && c <= 'F');
}

std::string to_hex(unsigned value, std::size_t digits) {
  constexpr std::string_view kDigits = "0123456789ABCDEF";
  std::string text(digits, '0');
  for (std::size_t i = digits; i-- > 0; value >>= 4U) text[i] = kDigits[value & 15U];
  return text;
}

std::optional<double> number(std::string_view word) {
  return pieces::number<double>(pieces::without_plus(word));
}

/// "T" and digits, or "S" and hexadecimal digits.
bool is_appended(std::string_view word, char kind) {
  return word.size() > 1 && word.front() == kind &&
         word.find_first_not_of("0123456789ABCDEFabcdef", 1) == std::string_view::npos;
}

/// Bytes of the fields of a mask; nullopt if the length of one is unknown, or if it has no fields.
std::optional<std::size_t> bytes_of_fields(std::size_t group, unsigned mask) {
  if (mask == 0) return std::nullopt;
  std::size_t bytes = 0;
  for (std::size_t bit = 0; bit < 16; ++bit) {
    if (((mask >> bit) & 1U) == 0) continue;
    if (kFieldBytes[group][bit] == 0) return std::nullopt;
    bytes += kFieldBytes[group][bit];
  }
  return bytes;
}

/// Layout of a line of measurements: how many numbers it holds, and the positions of acceleration and
/// temperature.
struct LineLayout {
  std::string_view name;
  std::size_t numbers;
  std::size_t acceleration;
  std::optional<std::size_t> temperature;
};
constexpr LineLayout kLineLayouts[] = {
    {"VNACC", 3, 0, std::nullopt},   // acceleration
    {"VNIMU", 11, 3, 9},             // magnetic field, acceleration, rate, temperature, pressure
    {"VNYMR", 12, 6, std::nullopt},  // yaw pitch roll, magnetic field, acceleration, rate
    {"VNMAR", 9, 3, std::nullopt},   // magnetic field, acceleration, rate
    {"VNQMR", 13, 7, std::nullopt},  // quaternion, magnetic field, acceleration, rate
};

}  // namespace

std::uint8_t xor8(std::string_view text) {
  unsigned sum = 0;
  for (const char c : text) sum ^= static_cast<std::uint8_t>(c);
  return static_cast<std::uint8_t>(sum);
}

std::uint16_t crc16(std::string_view bytes) {
  unsigned crc = 0;
  for (const char c : bytes) {
    crc = ((crc >> 8U) | (crc << 8U)) & 0xFFFFU;
    crc ^= static_cast<std::uint8_t>(c);
    crc ^= (crc & 0xFFU) >> 4U;
    crc ^= (crc << 12U) & 0xFFFFU;
    crc ^= (crc & 0xFFU) << 5U;
  }
  return static_cast<std::uint16_t>(crc);
}

std::string make_message(std::string_view text, Checksum checksum) {
  const std::string digits = checksum == Checksum::kXor8 ? to_hex(xor8(text), 2) : to_hex(crc16(text), 4);
  std::string message(1, kTextStart);
  message.append(text).append("*").append(digits).append("\r\n");
  return message;
}

std::string binary_header(const std::array<std::uint16_t, kGroups>& fields) {
  unsigned groups = 0;
  std::string masks;
  for (std::size_t group = 0; group < kGroups; ++group) {
    if (fields[group] == 0) continue;
    groups |= 1U << group;
    masks.push_back(static_cast<char>(fields[group] & 0xFFU));
    masks.push_back(static_cast<char>(fields[group] >> 8U));
  }
  return std::string{kBinaryStart, static_cast<char>(groups)} + masks;
}

std::optional<std::size_t> binary_size(const std::array<std::uint16_t, kGroups>& fields) {
  std::size_t size = binary_header(fields).size() + kCrcBytes;
  for (std::size_t group = 0; group < kGroups; ++group) {
    if (fields[group] == 0) continue;
    const auto bytes = bytes_of_fields(group, fields[group]);
    if (!bytes) return std::nullopt;
    size += *bytes;
  }
  return size;
}

std::size_t wire_size(const Message& message) {
  if (const auto* text = std::get_if<TextMessage>(&message)) {
    const std::size_t frame = text->carriage_return ? 4 : 3;  // '$', '*', CR, LF.
    return text->text.size() + frame + (text->checksum == Checksum::kXor8 ? 2 : 4);
  }
  const auto& binary = std::get<BinaryMessage>(message);
  return binary_header(binary.fields).size() + binary.payload.size() + kCrcBytes;
}

void MessageParser::feed(std::string_view bytes) {
  buffer_.erase(0, begin_);
  begin_ = 0;
  buffer_ += bytes;
}

MessageParser::Look MessageParser::look_at(std::size_t position) const {
  const std::string_view here = std::string_view(buffer_).substr(position);
  switch (here.front()) {
    case kTextStart:
      return look_at_text(here);
    case kBinaryStart:
      return look_at_binary(here);
    default:
      return {};
  }
}

MessageParser::Look MessageParser::look_at_text(std::string_view here) const {
  std::size_t end = 1;
  while (end < here.size() && here[end] >= ' ' && here[end] <= '~' && here[end] != kTextStart) ++end;
  if (end > kLongestText) return {};
  if (end == here.size()) return {Found::kNeedsMore, 0};
  std::size_t line_feed = end;
  if (here[end] == '\r' && ++line_feed == here.size()) return {Found::kNeedsMore, 0};
  if (here[line_feed] != '\n') return {};
  const std::size_t star = here.substr(0, end).rfind('*');
  if (star == std::string_view::npos) return {};
  const std::string_view text = here.substr(1, star - 1);
  const std::string_view digits = here.substr(star + 1, end - star - 1);
  if ((digits.size() != 2 && digits.size() != 4) || !std::all_of(digits.begin(), digits.end(), is_hex))
    return {};
  const bool right = digits == (digits.size() == 2 ? to_hex(xor8(text), 2) : to_hex(crc16(text), 4));
  return {right ? Found::kMessage : Found::kBadChecksum, line_feed + 1};
}

MessageParser::Look MessageParser::look_at_binary(std::string_view here) const {
  const std::size_t known = std::min(here.size(), only_header_.size());
  if (here.substr(0, known) != std::string_view(only_header_).substr(0, known)) return {};
  if (here.size() < 2) return {Found::kNeedsMore, 0};
  const unsigned groups = byte_at(here, 1);
  if (groups == 0 || groups >= (1U << kGroups)) return {};
  std::size_t header = 2;
  std::size_t payload = 0;
  for (std::size_t group = 0; group < kGroups; ++group) {
    if (((groups >> group) & 1U) == 0) continue;
    if (here.size() < header + 2) return {Found::kNeedsMore, 0};
    const auto bytes = bytes_of_fields(group, little_endian<std::uint16_t>(here.substr(header, 2)));
    if (!bytes) return {};
    payload += *bytes;
    header += 2;
  }
  const std::size_t size = header + payload + kCrcBytes;
  if (here.size() < size) return {Found::kNeedsMore, 0};
  return {crc16(here.substr(1, size - 1)) == 0 ? Found::kMessage : Found::kBadChecksum, size};
}

Message MessageParser::extract(std::size_t position, std::size_t size) {
  const std::string_view here = std::string_view(buffer_).substr(position, size);
  begin_ = position + size;
  if (here.front() == kTextStart) {
    const std::size_t star = here.rfind('*');
    const bool carriage_return = here[here.size() - 2] == '\r';
    const std::size_t digits = here.size() - star - (carriage_return ? 3 : 2);
    return TextMessage{here.substr(1, star - 1), digits == 2 ? Checksum::kXor8 : Checksum::kCrc16,
                       carriage_return};
  }
  BinaryMessage message;
  std::size_t at = 2;
  for (std::size_t group = 0; group < kGroups; ++group) {
    if (((byte_at(here, 1) >> group) & 1U) == 0) continue;
    message.fields[group] = little_endian<std::uint16_t>(here.substr(at, 2));
    at += 2;
  }
  message.payload = here.substr(at, size - at - kCrcBytes);
  return message;
}

std::optional<Message> MessageParser::next() {
  for (; begin_ < buffer_.size(); ++begin_, ++skipped_bytes_) {
    const Look look = look_at(begin_);
    switch (look.found) {
      case Found::kMessage:
        return extract(begin_, look.size);
      case Found::kNeedsMore:
        return std::nullopt;
      case Found::kBadChecksum:
        ++bad_frames_;
        break;
      case Found::kNothingHere:
        break;
    }
  }
  return std::nullopt;
}

std::optional<Message> MessageParser::next_behind_partial() {
  for (std::size_t position = begin_; position < buffer_.size(); ++position) {
    const Look look = look_at(position);
    if (look.found != Found::kMessage) continue;
    skipped_bytes_ += position - begin_;
    return extract(position, look.size);
  }
  return std::nullopt;
}

std::vector<std::string_view> split_words(std::string_view text) {
  std::vector<std::string_view> words;
  for (;;) {
    const std::size_t comma = text.find(',');
    words.push_back(text.substr(0, comma));
    if (comma == std::string_view::npos) return words;
    text.remove_prefix(comma + 1);
  }
}

std::optional<std::string_view> field(const BinaryMessage& message, Group group, std::uint8_t bit) {
  if (bit > 15 || ((message.fields[group] >> bit) & 1U) == 0) return std::nullopt;
  std::size_t at = 0;
  for (std::size_t g = 0; g <= group; ++g) {
    const std::size_t last = g == group ? bit : 16U;
    for (std::size_t b = 0; b < last; ++b)
      if (((message.fields[g] >> b) & 1U) != 0) at += kFieldBytes[g][b];
  }
  const std::size_t size = kFieldBytes[group][bit];
  if (size == 0 || at + size > message.payload.size()) return std::nullopt;
  return message.payload.substr(at, size);
}

std::optional<Measurement> decode_text_measurement(std::string_view text) {
  std::vector<std::string_view> words = split_words(text);
  const auto* const layout = std::find_if(std::begin(kLineLayouts), std::end(kLineLayouts),
                                          [&](const LineLayout& each) { return each.name == words.front(); });
  if (layout == std::end(kLineLayouts)) return std::nullopt;
  if (is_appended(words.back(), 'S')) words.pop_back();
  if (is_appended(words.back(), 'T')) words.pop_back();
  if (words.size() != layout->numbers + 1) return std::nullopt;
  std::vector<double> numbers;
  for (std::size_t i = 1; i < words.size(); ++i) {
    const auto value = number(words[i]);
    if (!value) return std::nullopt;
    numbers.push_back(*value);
  }
  Measurement measurement;
  for (std::size_t i = 0; i < 3; ++i)
    measurement.acceleration_mps2(static_cast<Eigen::Index>(i)) = numbers[layout->acceleration + i];
  if (layout->temperature) measurement.temperature_degc = numbers[*layout->temperature];
  return measurement;
}

std::optional<Measurement> decode_binary_measurement(const BinaryMessage& message) {
  auto acceleration = field(message, kCommon, kAcceleration);
  if (!acceleration) acceleration = field(message, kImu, kImuAcceleration);
  if (!acceleration) return std::nullopt;
  Measurement measurement;
  measurement.acceleration_mps2 = vector_at(*acceleration);
  if (const auto time = field(message, kCommon, kTimeStartup))
    measurement.time_startup_ns = little_endian<std::uint64_t>(*time);
  if (const auto temperature = field(message, kImu, kTemperature)) {
    measurement.temperature_degc = float_at(*temperature, 0);
  } else if (const auto several = field(message, kCommon, kMagneticTemperaturePressure)) {
    measurement.temperature_degc = float_at(*several, 12);  // Behind the magnetic field.
  }
  return measurement;
}

constexpr auto kErrors = names<unsigned>({{0x01, "hard fault"},
                                          {0x02, "serial buffer overflow"},
                                          {0x03, "wrong checksum"},
                                          {0x04, "invalid command"},
                                          {0x05, "too few parameters"},
                                          {0x06, "too many parameters"},
                                          {0x07, "invalid parameter"},
                                          {0x08, "invalid register"},
                                          {0x09, "access not authorised"},
                                          {0x0A, "watchdog reset"},
                                          {0x0B, "output buffer overflow"},
                                          {0x0C, "the baud rate is insufficient for this output"},
                                          {0xFF, "error buffer overflow"}});

std::string_view error_in_words(unsigned code) {
  return kErrors.of(code, "no meaning known");
}

}  // namespace abcal::vectornav
