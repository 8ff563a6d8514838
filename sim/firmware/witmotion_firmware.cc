#include "sim/firmware/witmotion_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "sim/firmware/reply_queue.h"

namespace abcal::sim {
namespace {

// Registers and frames as in docs/protocols/witmotion.md.
constexpr std::uint8_t kSave = 0x00;
constexpr std::uint8_t kCalibrate = 0x01;
constexpr std::uint8_t kOutputMask = 0x02;
constexpr std::uint8_t kRate = 0x03;
constexpr std::uint8_t kBaud = 0x04;
constexpr std::uint8_t kAccelerationOffset = 0x05;
constexpr std::uint8_t kAccelerationRange = 0x21;
constexpr std::uint8_t kRead = 0x27;
constexpr std::uint8_t kVersion = 0x2E;
constexpr std::uint8_t kAcceleration = 0x34;
constexpr std::uint8_t kRateOfTurn = 0x37;
constexpr std::uint8_t kField = 0x3A;
constexpr std::uint8_t kAngles = 0x3D;
constexpr std::uint8_t kTemperature = 0x40;
constexpr std::uint8_t kUnlock = 0x69;
constexpr std::uint16_t kUnlockKey = 0xB588;

constexpr double kFullScale = 16.0;        // g
constexpr double kRateFullScale = 2000.0;  // deg/s
/// The unit of the magnetic field differs between models [unverified against a device].
constexpr double kFieldFullScaleGauss = 20.0;
constexpr double kCounts = 32768.0;

/// An unlocked sensor locks itself again [unverified against a device].
constexpr Clock::Duration kUnlockedFor = std::chrono::seconds(10);

/// Register 04. [unverified against a device] but for 2 and 6.
constexpr std::array<unsigned, 10> kBaudRates{0,     4800,   9600,   19200,  38400,
                                              57600, 115200, 230400, 460800, 921600};

constexpr std::uint16_t kOnce = 0x0C;

/// Milliseconds between outputs by the code in register 03; 0: none. 02, 04, 05 and 0D are [unverified
/// against a device].
std::optional<unsigned> period_ms(std::uint16_t code) {
  switch (code) {
    case 0x01:
      return 5000;
    case 0x02:
      return 2000;
    case 0x03:
      return 1000;
    case 0x04:
      return 500;
    case 0x05:
      return 200;
    case 0x06:
      return 100;
    case 0x07:
      return 50;
    case 0x08:
      return 20;
    case 0x09:
      return 10;
    case 0x0B:
      return 5;
    case kOnce:
    case 0x0D:
      return 0;
    default:
      return std::nullopt;
  }
}

std::int16_t to_counts(double value) {
  if (std::isnan(value)) return -32768;  // A conversion that failed; no frame can represent "not a number".
  return static_cast<std::int16_t>(std::clamp(std::round(value), -32768.0, 32767.0));
}

/// The first three words: parts of the full scale.
void put_vector(std::array<std::int16_t, 4>& words, const Eigen::Vector3d& parts) {
  for (std::size_t j = 0; j < 3; ++j) words[j] = to_counts(parts[static_cast<Eigen::Index>(j)] * kCounts);
}

std::string frame(std::uint8_t type, const std::array<std::int16_t, 4>& words) {
  std::string bytes{'\x55', static_cast<char>(type)};
  for (const std::int16_t word : words) {
    const auto bits = static_cast<std::uint16_t>(word);
    bytes.push_back(static_cast<char>(bits & 0xFFU));
    bytes.push_back(static_cast<char>(bits >> 8U));
  }
  unsigned sum = 0;
  for (const char c : bytes) sum += static_cast<unsigned char>(c);
  bytes.push_back(static_cast<char>(sum & 0xFFU));
  return bytes;
}

}  // namespace

class WitMotionFirmware::Device final : public Firmware {
 public:
  Device(std::shared_ptr<SimBench> bench, WitMotionSettings settings);

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override { return line_speed_; }

 private:
  using Registers = std::map<std::uint8_t, std::uint16_t>;

  void write(std::uint8_t reg, std::uint16_t value);
  void read(std::uint8_t first);
  std::int16_t value_of(std::uint8_t reg) const;
  Eigen::Vector3d corrected_g(const SimOutput& output) const;
  Eigen::Vector3d motion_parts(std::uint8_t reg, Clock::Instant t) const;
  Registers factory() const;
  unsigned period() const { return period_ms(registers_.at(kRate)).value_or(0); }
  void stream_from(Clock::Instant t);
  Clock::Instant sample_time() const;
  std::string frames(Clock::Instant t, std::uint64_t index, unsigned every_ms) const;

  std::shared_ptr<SimBench> bench_;
  WitMotionSettings settings_;
  Registers registers_;
  Registers saved_;
  std::uint64_t next_sample_ = 0;  ///< In periods, from the start of the world's time.
  Clock::Instant unlocked_until_;
  unsigned line_speed_;
  std::string input_;
  ReplyQueue replies_;
  Clock::Instant now_;
};

WitMotionFirmware::Device::Device(std::shared_ptr<SimBench> bench, WitMotionSettings settings)
    : bench_(std::move(bench)),
      settings_(settings),
      unlocked_until_(bench_->start()),
      line_speed_(settings_.baud),
      now_(bench_->start()) {
  if (std::find(kBaudRates.begin() + 1, kBaudRates.end(), settings_.baud) == kBaudRates.end())
    throw std::invalid_argument(
        fmt::format("simulated WitMotion sensor: it has no baud rate {}", settings_.baud));
  if (settings_.rate_code > 0xFF || !period_ms(static_cast<std::uint16_t>(settings_.rate_code)))
    throw std::invalid_argument(
        fmt::format("simulated WitMotion sensor: it has no rate code {:#04x}", settings_.rate_code));
  registers_ = saved_ = factory();
  stream_from(now_);
}

WitMotionFirmware::Device::Registers WitMotionFirmware::Device::factory() const {
  const auto baud = std::find(kBaudRates.begin() + 1, kBaudRates.end(), settings_.baud) - kBaudRates.begin();
  return {{kOutputMask, static_cast<std::uint16_t>(settings_.output_mask)},
          {kRate, static_cast<std::uint16_t>(settings_.rate_code)},
          {kBaud, static_cast<std::uint16_t>(baud)},
          {kAccelerationRange, 3},
          {kVersion, static_cast<std::uint16_t>(settings_.version)}};
}

// Commands: FF AA, register, value low, value high.

void WitMotionFirmware::Device::receive(std::string_view bytes, Clock::Instant now) {
  now_ = now;
  input_ += bytes;
  std::size_t at = 0;
  while (at < input_.size()) {
    const std::string_view rest = std::string_view(input_).substr(at);
    if (rest[0] != '\xFF' || (rest.size() > 1 && rest[1] != '\xAA')) {
      ++at;
      continue;
    }
    if (rest.size() < 5) break;
    const auto byte = [&](std::size_t n) { return static_cast<unsigned char>(rest[n]); };
    write(byte(2), static_cast<std::uint16_t>(byte(3) | (byte(4) << 8U)));
    at += 5;
  }
  input_.erase(0, at);
}

/// Sends no answer, whether it accepts the value or not: a host reads the register to verify.
void WitMotionFirmware::Device::write(std::uint8_t reg, std::uint16_t value) {
  if (reg == kRead) {
    if (value <= 0xFF) read(static_cast<std::uint8_t>(value));
    return;
  }
  if (reg == kUnlock) {
    if (value == kUnlockKey) unlocked_until_ = now_ + kUnlockedFor;
    return;
  }
  if (settings_.needs_unlock && now_ >= unlocked_until_) return;
  switch (reg) {
    case kSave:
      if (value == 0) saved_ = registers_;
      if (value == 1) registers_ = saved_ = factory();
      if (value == 0xFF) registers_ = saved_;  // restart [unverified against a device]
      line_speed_ = kBaudRates[registers_.at(kBaud)];
      stream_from(now_);
      return;
    case kCalibrate:
      return;  // The world's errors are to be measured, so they are not calibrated away.
    case kOutputMask:
      registers_[reg] = value;
      return;
    case kRate:
      if (!period_ms(value)) return;
      registers_[reg] = value;
      stream_from(now_);
      if (value == kOnce && !bench_->fault_at(FaultKind::kNoOutput, now_))
        replies_.push(frames(now_, 0, 1), now_ + settings_.reply_delay);
      return;
    case kBaud:
      // At once [unverified against a device].
      if (value < 1 || value >= kBaudRates.size()) return;
      registers_[reg] = value;
      line_speed_ = kBaudRates[value];
      return;
    case kVersion:
      return;
    default:
      if (reg < kAcceleration || reg > kTemperature) registers_[reg] = value;
  }
}

void WitMotionFirmware::Device::power(bool on, Clock::Instant now) {
  now_ = now;
  input_.clear();
  replies_.clear();
  unlocked_until_ = now;
  if (!on) return;
  registers_ = saved_;
  line_speed_ = kBaudRates[registers_.at(kBaud)];
  stream_from(now);
}

void WitMotionFirmware::Device::read(std::uint8_t first) {
  std::array<std::int16_t, 4> words{};
  for (unsigned n = 0; n < 4; ++n) words[n] = value_of(static_cast<std::uint8_t>(first + n));
  replies_.push(frame(0x5F, words), now_ + settings_.reply_delay);
}

/// Less the offsets of registers 05 to 07, 0.0001 g each.
Eigen::Vector3d WitMotionFirmware::Device::corrected_g(const SimOutput& output) const {
  Eigen::Vector3d value = output.value;
  for (std::uint8_t j = 0; j < 3; ++j) {
    const auto found = registers_.find(static_cast<std::uint8_t>(kAccelerationOffset + j));
    if (found != registers_.end()) value[j] -= static_cast<std::int16_t>(found->second) / 10000.0;
  }
  return value;
}

std::int16_t WitMotionFirmware::Device::value_of(std::uint8_t reg) const {
  if (reg >= kAcceleration && reg < kAcceleration + 3) {
    const SimOutput output = bench_->output(now_, 0, std::chrono::milliseconds(1));
    return to_counts(corrected_g(output)[reg - kAcceleration] / kFullScale * kCounts);
  }
  if (reg >= kRateOfTurn && reg < kTemperature) {
    std::array<std::int16_t, 4> words{};
    put_vector(words, motion_parts(reg, now_));
    return words[(reg - kRateOfTurn) % 3U];
  }
  if (reg == kTemperature) return to_counts(bench_->temperature_degc(now_) * 100.0);
  const auto found = registers_.find(reg);
  return found == registers_.end() ? std::int16_t{0} : static_cast<std::int16_t>(found->second);
}

/// Rate of turn, field or roll, pitch, yaw, by their registers; as parts of the full scale.
Eigen::Vector3d WitMotionFirmware::Device::motion_parts(std::uint8_t reg, Clock::Instant t) const {
  const BodyMotion body = bench_->body_motion(t);
  if (reg < kField) return body.rate_B_radps * (180.0 / std::numbers::pi) / kRateFullScale;
  if (reg < kAngles) return body.field_B_gauss / kFieldFullScaleGauss;
  return roll_pitch_yaw_of(body.to_enu()) / std::numbers::pi;
}

// Output.

Clock::Instant WitMotionFirmware::Device::sample_time() const {
  return bench_->start() + std::chrono::milliseconds(static_cast<std::int64_t>(next_sample_ * period()));
}

void WitMotionFirmware::Device::stream_from(Clock::Instant t) {
  if (period() == 0) return;
  const auto since = t < bench_->start() ? 0 : (t - bench_->start()).count();
  next_sample_ = static_cast<std::uint64_t>(since) / (period() * 1'000'000ULL) + 1;
}

std::string WitMotionFirmware::Device::frames(Clock::Instant t, std::uint64_t index,
                                              unsigned every_ms) const {
  const SimOutput output = bench_->output(t, index, std::chrono::milliseconds(every_ms));
  const Eigen::Vector3d acceleration_g = corrected_g(output);
  const unsigned mask = registers_.at(kOutputMask);
  const std::int16_t temperature = to_counts(output.temperature_degc * 100.0);
  std::string out;
  // From time (50) to quaternion (59), one bit of the mask each.
  for (unsigned bit = 0; bit < 10; ++bit) {
    if ((mask >> bit & 1U) == 0) continue;
    std::array<std::int16_t, 4> words{};
    switch (bit) {
      case 0: {
        const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(t - bench_->start()).count();
        words = {0x0100, static_cast<std::int16_t>(1 + 256 * (ms / 3'600'000 % 24)),
                 static_cast<std::int16_t>(ms / 60'000 % 60 + 256 * (ms / 1000 % 60)),
                 static_cast<std::int16_t>(ms % 1000)};
        break;
      }
      case 1:
        for (std::size_t j = 0; j < 3; ++j)
          words[j] = to_counts(acceleration_g[static_cast<Eigen::Index>(j)] / kFullScale * kCounts);
        words[3] = temperature;
        break;
      case 2:
        put_vector(words, motion_parts(kRateOfTurn, t));
        words[3] = temperature;
        break;
      case 3:  // roll, pitch, yaw
        put_vector(words, motion_parts(kAngles, t));
        words[3] = static_cast<std::int16_t>(registers_.at(kVersion));
        break;
      case 4:
        put_vector(words, motion_parts(kField, t));
        words[3] = temperature;
        break;
      case 9: {
        const Eigen::Quaterniond q = quaternion_of(bench_->body_motion(t).to_enu());
        words = {to_counts(q.w() * kCounts), to_counts(q.x() * kCounts), to_counts(q.y() * kCounts),
                 to_counts(q.z() * kCounts)};
        break;
      }
      default:
        break;
    }
    out += frame(static_cast<std::uint8_t>(0x50 + bit), words);
  }
  return out;
}

std::string WitMotionFirmware::Device::transmit(Clock::Instant now) {
  std::string out;
  while (period() > 0 && sample_time() <= now) {
    const Clock::Instant t = sample_time();
    out += replies_.take(t);
    if (!bench_->fault_at(FaultKind::kNoOutput, t)) out += frames(t, next_sample_, period());
    ++next_sample_;
  }
  return out + replies_.take(now);
}

std::optional<Clock::Instant> WitMotionFirmware::Device::next_due() const {
  std::optional<Clock::Instant> due = replies_.next_due();
  if (period() > 0) due = due ? std::min(*due, sample_time()) : sample_time();
  return due;
}

WitMotionFirmware::WitMotionFirmware(std::shared_ptr<SimBench> bench, WitMotionSettings settings) {
  encase(std::make_unique<Device>(std::move(bench), settings));
}

}  // namespace abcal::sim
