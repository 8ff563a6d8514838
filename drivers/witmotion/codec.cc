#include "drivers/witmotion/codec.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace abcal::witmotion {
namespace {

constexpr char kStart = '\x55';

/// Register 03. Code 0A, 125 readings per second, exists on one model only; slower ones are not useful here.
struct Rate {
  double rate_hz;
  std::uint16_t code;
};
constexpr std::array<Rate, 8> kRates{{{1.0, 0x03},
                                      {2.0, 0x04},
                                      {5.0, 0x05},
                                      {10.0, 0x06},
                                      {20.0, 0x07},
                                      {50.0, 0x08},
                                      {100.0, 0x09},
                                      {200.0, 0x0B}}};
/// Register 04: the code is the place in the list, from 1 on.
constexpr std::array<double, 10> kBaudRates{0.0,     4800.0,   9600.0,   19200.0,  38400.0,
                                            57600.0, 115200.0, 230400.0, 460800.0, 921600.0};
/// Register 21 [unverified against a device].
constexpr std::array<double, 4> kRangesG{2.0, 4.0, 8.0, 16.0};

unsigned byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<std::uint8_t>(bytes[index]);
}

bool may_be_type(unsigned byte) {
  return byte >= 0x50 && byte <= 0x5F;
}

bool sum_is_right(std::string_view frame) {
  unsigned sum = 0;
  for (std::size_t i = 0; i + 1 < kFrameBytes; ++i) sum += byte_at(frame, i);
  return (sum & 0xFFU) == byte_at(frame, kFrameBytes - 1);
}

Frame decode(std::string_view bytes) {
  Frame frame;
  frame.type = static_cast<std::uint8_t>(byte_at(bytes, 1));
  for (std::size_t i = 0; i < frame.words.size(); ++i)
    frame.words[i] =
        static_cast<std::uint16_t>(byte_at(bytes, 2 + 2 * i) | (byte_at(bytes, 3 + 2 * i) << 8U));
  return frame;
}

}  // namespace

std::string write_register(Register where, std::uint16_t value) {
  return {'\xFF', '\xAA', static_cast<char>(where), static_cast<char>(value & 0xFFU),
          static_cast<char>(value >> 8U)};
}

std::string read_registers(Register first) {
  return write_register(kRead, first);
}

void FrameParser::feed(std::string_view bytes) {
  buffer_.erase(0, begin_);
  begin_ = 0;
  buffer_ += bytes;
}

std::optional<Frame> FrameParser::next() {
  for (; begin_ < buffer_.size(); ++begin_, ++skipped_bytes_) {
    const std::string_view here = std::string_view(buffer_).substr(begin_);
    if (here[0] != kStart) continue;
    if (here.size() > 1 && !may_be_type(byte_at(here, 1))) continue;
    if (here.size() < kFrameBytes) return std::nullopt;
    if (!sum_is_right(here)) {
      ++bad_frames_;
      continue;
    }
    begin_ += kFrameBytes;
    return decode(here);
  }
  return std::nullopt;
}

void FrameParser::lose_track() {
  skipped_bytes_ += buffer_.size() - begin_;
  begin_ = buffer_.size();
}

std::optional<Acceleration> decode_acceleration(const Frame& frame) {
  if (frame.type != kAcceleration) return std::nullopt;
  using Limits = std::numeric_limits<std::int16_t>;
  Acceleration acceleration;
  for (std::size_t i = 0; i < 3; ++i) {
    const auto word = std::bit_cast<std::int16_t>(frame.words[i]);
    acceleration.output_g(static_cast<Eigen::Index>(i)) = word * kStepG;
    acceleration.clipped = acceleration.clipped || word == Limits::min() || word == Limits::max();
  }
  acceleration.temperature_degc = std::bit_cast<std::int16_t>(frame.words[3]) / 100.0;
  return acceleration;
}

std::optional<std::uint16_t> rate_code(double rate_hz) {
  const auto* const found = std::find_if(kRates.begin(), kRates.end(),
                                         [rate_hz](const Rate& rate) { return rate.rate_hz == rate_hz; });
  if (found == kRates.end()) return std::nullopt;
  return found->code;
}

double nearest_rate_hz(double rate_hz) {
  return std::min_element(kRates.begin(), kRates.end(),
                          [rate_hz](const Rate& a, const Rate& b) {
                            return std::abs(a.rate_hz - rate_hz) < std::abs(b.rate_hz - rate_hz);
                          })
      ->rate_hz;
}

std::optional<double> baud_rate(std::uint16_t code) {
  if (code == 0 || code >= kBaudRates.size()) return std::nullopt;
  return kBaudRates[code];
}

std::optional<double> range_g(std::uint16_t code) {
  if (code >= kRangesG.size()) return std::nullopt;
  return kRangesG[code];
}

}  // namespace abcal::witmotion
