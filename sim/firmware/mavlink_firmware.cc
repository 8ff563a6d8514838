#include "sim/firmware/mavlink_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

namespace abcal::sim {
namespace {

constexpr Clock::Duration kHeartbeatPeriod = std::chrono::seconds(1);
constexpr unsigned kOurSystem = 1;
constexpr unsigned kOurComponent = 1;
constexpr double kGravity = 9.80665;
constexpr std::int64_t kShortestIntervalMicroseconds = 1000;
constexpr unsigned kPx4 = 12;
constexpr std::size_t kParameterNameBytes = 16;

// Numbers of messages, and the byte that each puts into its checksum.
constexpr unsigned kHeartbeatMessage = 0;
constexpr unsigned kParamReadMessage = 20;
constexpr unsigned kParamListMessage = 21;
constexpr unsigned kParamValueMessage = 22;
constexpr unsigned kParamSetMessage = 23;
constexpr unsigned kScaledImuMessage = 26;
constexpr unsigned kCommandLongMessage = 76;
constexpr unsigned kCommandAckMessage = 77;
constexpr unsigned kHighresImuMessage = 105;
constexpr unsigned kVersionMessage = 148;
constexpr unsigned kIntervalMessage = 244;
unsigned seed_of(unsigned message) {
  switch (message) {
    case kHeartbeatMessage:
      return 50;
    case kParamReadMessage:
      return 214;
    case kParamListMessage:
      return 159;
    case kIntervalMessage:
      return 95;
    case kParamValueMessage:
      return 220;
    case kParamSetMessage:
      return 168;
    case kScaledImuMessage:
      return 170;
    case kCommandLongMessage:
      return 152;
    case kCommandAckMessage:
      return 143;
    case kHighresImuMessage:
      return 93;
    default:
      return 178;
  }
}

/// CRC-16 with the polynomial 1021 read backwards, bit by bit.
unsigned crc_of(std::string_view bytes, unsigned seed) {
  unsigned crc = 0xFFFF;
  const auto shift_in = [&crc](unsigned byte) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0 ? crc >> 1U ^ 0x8408U : crc >> 1U;
  };
  for (const char c : bytes) shift_in(static_cast<unsigned char>(c));
  shift_in(seed);
  return crc;
}

void put(std::string& bytes, std::uint64_t value, int size) {
  for (; size > 0; --size, value >>= 8U) bytes.push_back(static_cast<char>(value & 0xFFU));
}
void put_float(std::string& bytes, double value) {
  put(bytes, std::bit_cast<std::uint32_t>(static_cast<float>(value)), 4);
}
unsigned u8(std::string_view bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes.at(at));
}
float float_at(std::string_view bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t n = 4; n > 0; --n) value = value << 8U | u8(bytes, at + n - 1);
  return std::bit_cast<float>(value);
}

}  // namespace

class MavlinkFirmware::Device final : public Firmware {
 public:
  Device(std::shared_ptr<SimBench> bench, MavlinkSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void session_starts() override {
    received_.clear();
    replies_.clear();
  }

 private:
  struct Stream {
    unsigned message;
    std::int64_t interval_us = 0;  ///< 0: not sent.
    std::int64_t default_us = 0;
    std::uint64_t next = 0;  ///< In intervals since `from`.
    Clock::Instant from{};

    Clock::Instant due() const {
      return from + std::chrono::microseconds(static_cast<std::int64_t>(next) * interval_us);
    }
  };

  void take_frames();
  void take_command(std::string_view payload);
  void take_parameter(std::string_view payload, bool set);
  void list_parameters(std::string_view payload);
  void send_parameter(std::size_t index);
  unsigned tell_interval(double message);
  Eigen::Vector3d corrected(const Eigen::Vector3d& raw_mps2) const;
  unsigned set_interval(double message, double interval_us);
  unsigned request(double message);
  void acknowledge(unsigned command, unsigned result);
  std::string frame(unsigned message, std::string payload);
  std::string heartbeat();
  std::string version();
  std::string imu(const Stream& stream, Clock::Instant t);
  std::uint64_t time_us(Clock::Instant t) const {
    return static_cast<std::uint64_t>(
               std::chrono::duration_cast<std::chrono::microseconds>(t - bench_->start()).count()) +
           1'000'000U;
  }

  std::shared_ptr<SimBench> bench_;
  MavlinkSettings settings_;
  UnservedCommands& unserved_;
  std::array<Stream, 2> streams_{Stream{kHighresImuMessage}, Stream{kScaledImuMessage}};
  struct Parameter {
    std::string name;
    float value = 0.0F;
    bool whole = false;  ///< A whole number; else a float.
  };
  std::vector<Parameter> parameters_;  ///< The first six: offset and scale of x, y, z.
  Clock::Instant heartbeat_due_;
  std::uint64_t samples_ = 0;
  unsigned sequence_ = 0;
  std::string received_;
  std::string frame_in_hand_;
  ReplyQueue replies_;
  Clock::Instant now_;
};

MavlinkFirmware::Device::Device(std::shared_ptr<SimBench> bench, MavlinkSettings settings,
                                UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      heartbeat_due_(bench_->start()),
      now_(bench_->start()) {
  if (settings_.version != 1 && settings_.version != 2)
    throw std::invalid_argument(
        fmt::format("simulated MAVLink device: version {}, required: 1 or 2", settings_.version));
  constexpr std::int64_t kAtPowerOnMicroseconds = 20'000;
  if (settings_.streams_at_power_on && settings_.has_highres)
    streams_[0].default_us = streams_[0].interval_us = kAtPowerOnMicroseconds;
  streams_[0].from = streams_[1].from = now_;
  if (!settings_.has_parameters) return;
  const bool px4 = settings_.autopilot == kPx4;
  for (const std::string axis : {"X", "Y", "Z"}) {
    parameters_.push_back({px4 ? "CAL_ACC0_" + axis + "OFF" : "INS_ACCOFFS_" + axis});
    parameters_.push_back({px4 ? "CAL_ACC0_" + axis + "SCALE" : "INS_ACCSCAL_" + axis, 1.0F});
  }
  if (px4) {
    parameters_.push_back({"CAL_ACC0_ID", 1310988.0F, true});
    parameters_.push_back({"CAL_ACC0_ROT", -1.0F, true});
    parameters_.push_back({"SENS_BOARD_ROT", 0.0F, true});
  } else {
    parameters_.push_back({"AHRS_ORIENTATION", 0.0F, true});
  }
}

/// All of them, one after the other.
void MavlinkFirmware::Device::list_parameters(std::string_view payload) {
  if (const unsigned system = u8(payload, 0); system != 0 && system != kOurSystem) return;
  if (parameters_.empty()) unserved_.note("list of parameters", "it has none: no answer", frame_in_hand_);
  for (std::size_t n = 0; n < parameters_.size(); ++n) send_parameter(n);
}

void MavlinkFirmware::Device::send_parameter(std::size_t index) {
  const Parameter& parameter = parameters_.at(index);
  std::string answer;
  // PX4 keeps a whole number in the bytes of the float, ArduPilot converts it.
  if (parameter.whole && settings_.autopilot == kPx4)
    put(answer, static_cast<std::uint32_t>(static_cast<std::int32_t>(parameter.value)), 4);
  else
    put_float(answer, static_cast<double>(parameter.value));
  put(answer, parameters_.size(), 2);
  put(answer, index, 2);
  std::string name = parameter.name;
  name.resize(kParameterNameBytes, '\0');
  answer += name;
  put(answer, parameter.whole ? 6 : 9, 1);
  replies_.push(frame(kParamValueMessage, answer), now_ + settings_.reply_delay);
}

/// Reads one, by its name or its index, or sets one; one that it does not have goes unanswered.
void MavlinkFirmware::Device::take_parameter(std::string_view payload, bool set) {
  const unsigned system = u8(payload, set ? 4 : 2);
  if (system != 0 && system != kOurSystem) return;
  std::string name(payload.substr(set ? 6 : 4, kParameterNameBytes));
  name.resize(std::min(name.find('\0'), name.size()));
  // An index that is not negative counts, and not the name.
  const unsigned asked = set ? 0xFFFFU : u8(payload, 0) + 256U * u8(payload, 1);
  const bool by_index = asked < 0x8000U;
  const auto found = by_index ? parameters_.begin() + std::min<std::ptrdiff_t>(asked, std::ssize(parameters_))
                              : std::find_if(parameters_.begin(), parameters_.end(),
                                             [&](const Parameter& each) { return each.name == name; });
  if (found == parameters_.end()) {
    unserved_.note("parameter " + (by_index ? fmt::format("{}", asked) : name), "not emulated: no answer",
                   frame_in_hand_);
    return;
  }
  if (set && !found->whole) found->value = float_at(payload, 0);
  send_parameter(static_cast<std::size_t>(std::distance(parameters_.begin(), found)));
}

/// Applies the corrections of its autopilot.
Eigen::Vector3d MavlinkFirmware::Device::corrected(const Eigen::Vector3d& raw_mps2) const {
  if (parameters_.empty()) return raw_mps2;
  Eigen::Vector3d value;
  for (std::size_t j = 0; j < 3; ++j) {
    const auto axis = static_cast<Eigen::Index>(j);
    value[axis] = (raw_mps2[axis] - static_cast<double>(parameters_[2 * j].value)) *
                  static_cast<double>(parameters_[2 * j + 1].value);
  }
  return value;
}

std::string MavlinkFirmware::Device::frame(unsigned message, std::string payload) {
  std::string bytes;
  if (settings_.version == 1) {
    put(bytes, 0xFE, 1);
    put(bytes, payload.size(), 1);
  } else {
    // Version 2 leaves zeros at the end away, but for one byte.
    payload.resize(std::max<std::size_t>(payload.find_last_not_of('\0') + 1, 1));
    put(bytes, 0xFD, 1);
    put(bytes, payload.size(), 1);
    put(bytes, 0, 2);
  }
  put(bytes, sequence_++ & 0xFFU, 1);
  put(bytes, kOurSystem, 1);
  put(bytes, kOurComponent, 1);
  put(bytes, message, settings_.version == 1 ? 1 : 3);
  bytes += payload;
  put(bytes, crc_of(std::string_view(bytes).substr(1), seed_of(message)), 2);
  return bytes;
}

// Receiving.

void MavlinkFirmware::Device::receive(std::string_view bytes, Clock::Instant now) {
  now_ = std::max(now_, now);
  received_ += bytes;
  take_frames();
}

void MavlinkFirmware::Device::take_frames() {
  std::size_t at = 0;
  while (at < received_.size()) {
    const std::string_view rest = std::string_view(received_).substr(at);
    const unsigned magic = u8(rest, 0);
    const std::size_t header = magic == 0xFE ? 6 : 10;
    if (magic != 0xFE && magic != 0xFD) {
      ++at;
      continue;
    }
    if (rest.size() < header) break;
    const std::size_t length = u8(rest, 1);
    const bool signature = magic == 0xFD && (u8(rest, 2) & 1U) != 0;
    const std::size_t size = header + length + 2 + (signature ? 13 : 0);
    if (rest.size() < size) break;
    const unsigned message =
        magic == 0xFE ? u8(rest, 5) : u8(rest, 7) + 256U * u8(rest, 8) + 65536U * u8(rest, 9);
    const std::size_t end = header + length;
    const bool sound =
        crc_of(rest.substr(1, end - 1), seed_of(message)) == u8(rest, end) + 256U * u8(rest, end + 1);
    const bool understood = message == kCommandLongMessage || message == kHeartbeatMessage ||
                            message == kParamReadMessage || message == kParamSetMessage ||
                            message == kParamListMessage;
    if (!sound || !understood) {
      ++at;
      continue;
    }
    frame_in_hand_ = rest.substr(0, size);
    if (message == kParamReadMessage || message == kParamSetMessage) {
      std::string payload(rest.substr(header, length));
      payload.resize(23, '\0');
      take_parameter(payload, message == kParamSetMessage);
    }
    if (message == kParamListMessage) {
      std::string payload(rest.substr(header, length));
      payload.resize(2, '\0');
      list_parameters(payload);
    }
    if (message == kCommandLongMessage) {
      std::string payload(rest.substr(header, length));
      payload.resize(33, '\0');
      take_command(payload);
    }
    at += size;
  }
  received_.erase(0, at);
}

void MavlinkFirmware::Device::take_command(std::string_view payload) {
  const unsigned command = u8(payload, 28) + 256U * u8(payload, 29);
  const unsigned system = u8(payload, 30);
  const unsigned component = u8(payload, 31);
  if ((system != 0 && system != kOurSystem) || (component != 0 && component != kOurComponent)) return;
  constexpr unsigned kGetMessageInterval = 510;
  constexpr unsigned kSetMessageInterval = 511;
  constexpr unsigned kRequestMessage = 512;
  constexpr unsigned kNotSupported = 3;
  const auto first = static_cast<double>(float_at(payload, 0));
  const auto second = static_cast<double>(float_at(payload, 4));
  if (command == kGetMessageInterval) return acknowledge(command, tell_interval(first));
  if (command == kSetMessageInterval) return acknowledge(command, set_interval(first, second));
  if (command == kRequestMessage) return acknowledge(command, request(first));
  unserved_.note(fmt::format("command {}", command), "not emulated: not supported", frame_in_hand_);
  acknowledge(command, kNotSupported);
}

unsigned MavlinkFirmware::Device::set_interval(double message, double interval_us) {
  constexpr unsigned kDenied = 2;
  constexpr unsigned kFailed = 4;
  for (Stream& stream : streams_) {
    if (message != stream.message || (stream.message == kHighresImuMessage && !settings_.has_highres))
      continue;
    if (!(interval_us >= -1.0 && interval_us <= 1e9)) return kDenied;
    const auto wanted = static_cast<std::int64_t>(std::llround(interval_us));
    if (wanted > 0 && wanted < kShortestIntervalMicroseconds) return kDenied;
    stream.interval_us = wanted < 0 ? 0 : (wanted == 0 ? stream.default_us : wanted);
    stream.from = now_;
    stream.next = 1;
    return 0;
  }
  unserved_.note(fmt::format("interval of message {}", message), "not emulated: failed", frame_in_hand_);
  return kFailed;
}

/// In microseconds; -1: not sent, 0: there is no such message.
unsigned MavlinkFirmware::Device::tell_interval(double message) {
  std::int64_t interval_us = 0;
  if (message == kHeartbeatMessage)
    interval_us = std::chrono::duration_cast<std::chrono::microseconds>(kHeartbeatPeriod).count();
  for (const Stream& stream : streams_)
    if (message == stream.message && (stream.message != kHighresImuMessage || settings_.has_highres))
      interval_us = stream.interval_us == 0 ? -1 : stream.interval_us;
  if (interval_us == 0)
    unserved_.note(fmt::format("interval of message {}", message), "not emulated: 0", frame_in_hand_);
  std::string payload;
  put(payload, static_cast<std::uint32_t>(static_cast<std::int32_t>(interval_us)), 4);
  put(payload, static_cast<std::uint64_t>(message), 2);
  replies_.push(frame(kIntervalMessage, payload), now_ + settings_.reply_delay);
  return 0;
}

unsigned MavlinkFirmware::Device::request(double message) {
  constexpr unsigned kFailed = 4;
  if (message != kVersionMessage) {
    unserved_.note(fmt::format("request of message {}", message), "not emulated: failed", frame_in_hand_);
    return kFailed;
  }
  replies_.push(version(), now_ + settings_.reply_delay);
  return 0;
}

void MavlinkFirmware::Device::acknowledge(unsigned command, unsigned result) {
  std::string payload;
  put(payload, command, 2);
  put(payload, result, 1);
  replies_.push(frame(kCommandAckMessage, payload), now_ + settings_.reply_delay);
}

// Sending.

std::string MavlinkFirmware::Device::heartbeat() {
  std::string payload;
  put(payload, 0, 4);
  put(payload, 2, 1);  // a quadrotor
  put(payload, settings_.autopilot, 1);
  put(payload, settings_.armed ? 0x80 : 0, 1);
  put(payload, 3, 1);  // standby
  put(payload, 3, 1);
  return frame(kHeartbeatMessage, payload);
}

std::string MavlinkFirmware::Device::version() {
  std::string payload;
  put(payload, 0, 8);
  put(payload, std::strtoull(settings_.serial_number.c_str(), nullptr, 16), 8);
  put(payload, 0x010E0300, 4);  // 1.14.3
  payload.resize(60, '\0');
  return frame(kVersionMessage, payload);
}

std::string MavlinkFirmware::Device::imu(const Stream& stream, Clock::Instant t) {
  const SimOutput output = bench_->output(t, samples_++, std::chrono::microseconds(stream.interval_us));
  const Eigen::Vector3d acceleration_mps2 = corrected(output.value);
  std::string payload;
  if (stream.message == kHighresImuMessage) {
    put(payload, time_us(t), 8);
    for (int j = 0; j < 3; ++j) put_float(payload, acceleration_mps2[j]);
    for (int n = 0; n < 6; ++n) put_float(payload, 0.0);
    for (int n = 0; n < 3; ++n) put_float(payload, 0.0);
    put_float(payload, output.temperature_degc);
    put(payload, 0x1007, 2);  // acceleration and temperature
    return frame(stream.message, payload);
  }
  put(payload, time_us(t) / 1000, 4);
  for (int j = 0; j < 3; ++j) {
    const double milli_g =
        std::isfinite(acceleration_mps2[j]) ? acceleration_mps2[j] / kGravity * 1000.0 : -32768.0;
    put(payload,
        static_cast<std::uint16_t>(
            static_cast<std::int16_t>(std::clamp(std::round(milli_g), -32768.0, 32767.0))),
        2);
  }
  put(payload, 0, 8);
  put(payload, 0, 4);
  if (settings_.version == 2)
    put(payload,
        static_cast<std::uint16_t>(static_cast<std::int16_t>(std::lround(100.0 * output.temperature_degc))),
        2);
  return frame(stream.message, payload);
}

std::string MavlinkFirmware::Device::transmit(Clock::Instant now) {
  std::string out;
  // In order of time, so that the numbers of the messages are those of a real sender.
  for (;;) {
    const auto due = next_due();
    if (!due || *due > now) break;
    now_ = std::max(now_, *due);
    if (replies_.next_due() == due) {
      out += replies_.take(*due);
      continue;
    }
    if (heartbeat_due_ == *due) {
      heartbeat_due_ += kHeartbeatPeriod;
      out += heartbeat();
      continue;
    }
    for (Stream& stream : streams_) {
      if (stream.interval_us == 0 || stream.due() != *due) continue;
      ++stream.next;
      if (!bench_->fault_at(FaultKind::kNoOutput, *due)) out += imu(stream, *due);
      break;
    }
  }
  now_ = std::max(now_, now);
  return out;
}

std::optional<Clock::Instant> MavlinkFirmware::Device::next_due() const {
  Clock::Instant due = heartbeat_due_;
  if (const auto reply = replies_.next_due()) due = std::min(due, *reply);
  for (const Stream& stream : streams_)
    if (stream.interval_us != 0) due = std::min(due, stream.due());
  return due;
}

MavlinkFirmware::MavlinkFirmware(std::shared_ptr<SimBench> bench, MavlinkSettings settings) {
  encase(std::make_unique<Device>(std::move(bench), std::move(settings), unserved()));
}
void MavlinkFirmware::restart(std::shared_ptr<SimBench> bench, MavlinkSettings settings) {
  encase(std::make_unique<Device>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
