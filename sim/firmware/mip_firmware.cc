#include "sim/firmware/mip_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/firmware/big_endian.h"
#include "sim/firmware/reply_queue.h"
#include "sim/firmware/sample_grid.h"

namespace abcal::sim {
namespace {

// Descriptors and codes as in docs/protocols/mip.md.
constexpr std::uint8_t kSync1 = 0x75;
constexpr std::uint8_t kSync2 = 0x65;
constexpr std::size_t kHeader = 4;
constexpr std::size_t kChecksum = 2;

constexpr std::uint8_t kBaseSet = 0x01;
constexpr std::uint8_t k3dmSet = 0x0C;
constexpr std::uint8_t kSensorData = 0x80;
constexpr std::uint8_t kFilterData = 0x82;
constexpr std::uint8_t kAck = 0xF1;

enum AckCode : std::uint8_t { kOk = 0, kUnknown = 1, kBadChecksum = 2, kBadParameter = 3, kFailed = 4 };
enum Function : std::uint8_t { kWrite = 1, kRead = 2, kSave = 3, kLoad = 4, kReset = 5 };

constexpr std::uint8_t kAccelerometer = 0x04;
constexpr std::uint8_t kGyro = 0x05;
constexpr std::uint8_t kMagnetometer = 0x06;
constexpr std::uint8_t kDeltaTheta = 0x07;
constexpr std::uint8_t kDeltaVelocity = 0x08;
constexpr std::uint8_t kTemperature = 0x14;
constexpr std::uint8_t kOverRange = 0x18;
constexpr std::uint8_t kReferenceTime = 0xD5;
constexpr std::uint8_t kReferenceTimeDelta = 0xD6;
constexpr std::array kSensorFields{kAccelerometer, kGyro,          kMagnetometer,
                                   kDeltaTheta,    kDeltaVelocity, kTemperature,
                                   kOverRange,     kReferenceTime, kReferenceTimeDelta};

constexpr Clock::Duration kPacketTimeout = std::chrono::milliseconds(100);
constexpr std::array<unsigned, 7> kBaudRates{9600, 19200, 38400, 115200, 230400, 460800, 921600};

std::uint8_t byte(char c) {
  return static_cast<std::uint8_t>(c);
}
void put(std::string& out, std::uint8_t value) {
  out.push_back(static_cast<char>(value));
}

/// Fletcher: a += byte, b += a.
std::uint16_t checksum(std::string_view bytes) {
  unsigned a = 0;
  unsigned b = 0;
  for (const char c : bytes) {
    a = (a + byte(c)) & 0xFFU;
    b = (b + a) & 0xFFU;
  }
  return static_cast<std::uint16_t>((a << 8U) | b);
}

void put_field(std::string& payload, std::uint8_t descriptor, std::string_view data) {
  put(payload, static_cast<std::uint8_t>(data.size() + 2));
  put(payload, descriptor);
  payload += data;
}

std::string packet(std::uint8_t set, std::string_view payload) {
  std::string bytes;
  bytes.reserve(kHeader + payload.size() + kChecksum);
  put(bytes, kSync1);
  put(bytes, kSync2);
  put(bytes, set);
  put(bytes, static_cast<std::uint8_t>(payload.size()));
  bytes += payload;
  put_big_endian(bytes, checksum(bytes));
  return bytes;
}

/// Thrown by a command that is refused.
struct Refusal {
  AckCode code;
};

/// The data of one command field, read from the front.
class Arguments {
 public:
  explicit Arguments(std::string_view data) : data_(data) {}
  std::uint8_t u8() { return static_cast<std::uint8_t>(take(1)); }
  std::uint16_t u16() { return static_cast<std::uint16_t>(take(2)); }
  std::uint32_t u32() { return take(4); }
  std::size_t left() const { return data_.size(); }
  void done() const {
    if (!data_.empty()) throw Refusal{kBadParameter};
  }

 private:
  std::uint32_t take(std::size_t count) {
    if (data_.size() < count) throw Refusal{kBadParameter};
    std::uint32_t value = 0;
    for (const char c : data_.substr(0, count)) value = (value << 8U) | byte(c);
    data_.remove_prefix(count);
    return value;
  }
  std::string_view data_;
};

struct Rate {
  std::uint8_t descriptor;
  std::uint16_t decimation;
};

/// What can be saved, loaded and reset.
struct Stored {
  std::vector<Rate> sensor_format;
  bool sensor_stream = true;
  std::uint32_t baud = 115200;
};

}  // namespace

class MipFirmware::Device {
 public:
  Device(std::shared_ptr<SimBench> bench, MipSettings settings);

  void receive(std::string_view bytes, Clock::Instant now);
  std::string transmit(Clock::Instant now);
  std::optional<Clock::Instant> next_due() const;

 private:
  struct Answer {
    std::uint8_t descriptor;
    std::string data;
  };

  void find_packets();
  void run_packet(std::uint8_t set, std::string_view payload, bool checksum_holds);
  std::optional<Answer> run_command(std::uint8_t set, std::uint8_t command, Arguments arguments);
  std::optional<Answer> run_base(std::uint8_t command, Arguments arguments);
  std::optional<Answer> run_3dm(std::uint8_t command, Arguments arguments);
  std::optional<Answer> message_format(bool modern, Arguments arguments);
  std::optional<Answer> stream_control(Arguments arguments);
  std::optional<Answer> baud_rate(bool modern, Arguments arguments);
  void device_settings(Arguments arguments);
  void poll(Arguments arguments);
  std::string device_info() const;
  std::string descriptors() const;
  std::string sensor_packet(const std::vector<std::uint8_t>& fields, std::uint64_t tick) const;
  Stored factory() const;

  bool streaming() const { return !idle_ && current_.sensor_stream && !current_.sensor_format.empty(); }
  void stream_from(Clock::Instant now);
  void advance_tick();

  std::shared_ptr<SimBench> bench_;
  MipSettings settings_;
  SampleGrid grid_;
  Stored current_;
  Stored saved_;
  bool idle_;
  std::uint64_t next_tick_ = 0;  ///< The next at which a packet of the stream is due.
  mutable std::optional<std::pair<std::uint64_t, SimOutput>> last_output_;
  std::string input_;
  ReplyQueue replies_;
  std::vector<std::pair<std::uint8_t, std::string>> after_ack_;
  bool suppress_ack_ = false;  ///< Of the command in hand.
  Clock::Instant now_;
};

MipFirmware::Device::Device(std::shared_ptr<SimBench> bench, MipSettings settings)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      grid_(bench_->start(), std::max(1U, settings_.base_rate_hz)),
      idle_(!settings_.streaming_at_power_on),
      now_(bench_->start()) {
  if (settings_.base_rate_hz < 1 || settings_.base_rate_hz > 10000)
    throw std::invalid_argument(fmt::format(
        "simulated MIP device: base rate is {} Hz, required: 1 to 10000 Hz", settings_.base_rate_hz));
  for (const std::string& text : {settings_.model_name, settings_.model_number, settings_.serial_number,
                                  settings_.lot_number, settings_.options})
    if (text.size() > 16)
      throw std::invalid_argument(fmt::format(
          "simulated MIP device: \"{}\" has {} characters, required: at most 16", text, text.size()));
  current_ = saved_ = factory();
  stream_from(now_);
}

Stored MipFirmware::Device::factory() const {
  const auto decimation = static_cast<std::uint16_t>(std::max(1U, settings_.base_rate_hz / 100U));
  return {.sensor_format = {{kAccelerometer, decimation}, {kReferenceTime, decimation}},
          .sensor_stream = true,
          .baud = settings_.baud};
}

// Bytes.

void MipFirmware::Device::receive(std::string_view bytes, Clock::Instant now) {
  // A packet that does not end is given up, as the maker's own parser does [unverified against a device]: the
  // next one must not be swallowed by its length.
  if (now - now_ > kPacketTimeout) input_.clear();
  now_ = now;
  input_ += bytes;
  find_packets();
}

void MipFirmware::Device::find_packets() {
  std::size_t at = 0;
  while (at < input_.size()) {
    const std::string_view rest = std::string_view(input_).substr(at);
    if (byte(rest[0]) != kSync1 || (rest.size() > 1 && byte(rest[1]) != kSync2)) {
      ++at;
      continue;
    }
    if (rest.size() < kHeader) break;
    const std::size_t size = kHeader + byte(rest[3]) + kChecksum;
    if (rest.size() < size) break;
    const std::uint16_t found =
        static_cast<std::uint16_t>((byte(rest[size - 2]) << 8U) | byte(rest[size - 1]));
    const bool holds = found == checksum(rest.substr(0, size - kChecksum));
    const std::string payload(rest.substr(kHeader, size - kHeader - kChecksum));
    run_packet(byte(rest[2]), payload, holds);
    // A wrong checksum may be a wrong length: what follows the two sync bytes may hold a good packet.
    at += holds ? size : 2;
  }
  input_.erase(0, at);
}

void MipFirmware::Device::run_packet(std::uint8_t set, std::string_view payload, bool checksum_holds) {
  std::string reply;
  after_ack_.clear();
  while (payload.size() >= 2) {
    const std::size_t size = byte(payload[0]);
    if (size < 2 || size > payload.size()) break;
    const std::uint8_t command = byte(payload[1]);
    const std::string_view data = payload.substr(2, size - 2);
    payload.remove_prefix(size);
    AckCode code = kOk;
    std::optional<Answer> answer;
    suppress_ack_ = false;
    if (!checksum_holds) {
      code = kBadChecksum;
    } else {
      try {
        answer = run_command(set, command, Arguments(data));
      } catch (const Refusal& refusal) {
        code = refusal.code;
      }
    }
    if (!suppress_ack_)
      put_field(reply, kAck, std::string{static_cast<char>(command), static_cast<char>(code)});
    if (answer) put_field(reply, answer->descriptor, answer->data);
    if (!checksum_holds) break;
  }
  if (!reply.empty()) replies_.push(packet(set, reply), now_ + settings_.reply_delay);
  for (const auto& [data_set, fields] : after_ack_)
    replies_.push(packet(data_set, fields), now_ + settings_.reply_delay);
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::run_command(std::uint8_t set,
                                                                            std::uint8_t command,
                                                                            Arguments arguments) {
  switch (set) {
    case kBaseSet:
      return run_base(command, arguments);
    case k3dmSet:
      return run_3dm(command, arguments);
    default:
      throw Refusal{kUnknown};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::run_base(std::uint8_t command,
                                                                         Arguments arguments) {
  switch (command) {
    case 0x01:  // ping
      arguments.done();
      return std::nullopt;
    case 0x02:  // set idle
      arguments.done();
      idle_ = true;
      return std::nullopt;
    case 0x03:
      arguments.done();
      return Answer{0x81, device_info()};
    case 0x04:
      arguments.done();
      return Answer{0x82, descriptors()};
    case 0x06:  // resume
      arguments.done();
      idle_ = false;
      stream_from(now_);
      return std::nullopt;
    case 0x09:
      if (!settings_.modern_commands) throw Refusal{kUnknown};
      return baud_rate(true, arguments);
    case 0x7E:  // soft reset: as after power on, with what was saved
      arguments.done();
      current_ = saved_;
      idle_ = !settings_.streaming_at_power_on;
      stream_from(now_);
      return std::nullopt;
    default:
      throw Refusal{kUnknown};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::run_3dm(std::uint8_t command,
                                                                        Arguments arguments) {
  std::string data;
  switch (command) {
    case 0x06:  // base rate, legacy
      if (!settings_.legacy_commands) throw Refusal{kUnknown};
      arguments.done();
      put_big_endian(data, static_cast<std::uint16_t>(settings_.base_rate_hz));
      return Answer{0x83, data};
    case 0x08:
      if (!settings_.legacy_commands) throw Refusal{kUnknown};
      return message_format(false, arguments);
    case 0x0D:
      poll(arguments);
      return std::nullopt;
    case 0x0E: {  // base rate, modern
      if (!settings_.modern_commands) throw Refusal{kUnknown};
      const std::uint8_t set = arguments.u8();
      arguments.done();
      if (set != kSensorData) throw Refusal{kBadParameter};
      put(data, set);
      put_big_endian(data, static_cast<std::uint16_t>(settings_.base_rate_hz));
      return Answer{0x8E, data};
    }
    case 0x0F:
      if (!settings_.modern_commands) throw Refusal{kUnknown};
      return message_format(true, arguments);
    case 0x11:
      return stream_control(arguments);
    case 0x30:
      device_settings(arguments);
      return std::nullopt;
    case 0x40:
      return baud_rate(false, arguments);
    default:
      throw Refusal{kUnknown};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::message_format(bool modern,
                                                                               Arguments arguments) {
  const std::uint8_t function = arguments.u8();
  if (modern && arguments.u8() != kSensorData) throw Refusal{kBadParameter};
  switch (function) {
    case kWrite: {
      const std::uint8_t count = arguments.u8();
      std::vector<Rate> format;
      for (unsigned n = 0; n < count; ++n) {
        const std::uint8_t descriptor = arguments.u8();
        const std::uint16_t decimation = arguments.u16();
        const bool known =
            std::find(kSensorFields.begin(), kSensorFields.end(), descriptor) != kSensorFields.end();
        if (!known || decimation == 0) throw Refusal{kBadParameter};
        format.push_back({descriptor, decimation});
      }
      arguments.done();
      current_.sensor_format = std::move(format);
      stream_from(now_);
      return std::nullopt;
    }
    case kRead: {
      std::string data;
      if (modern) put(data, kSensorData);
      put(data, static_cast<std::uint8_t>(current_.sensor_format.size()));
      for (const Rate& rate : current_.sensor_format) {
        put(data, rate.descriptor);
        put_big_endian(data, rate.decimation);
      }
      return Answer{modern ? std::uint8_t{0x8F} : std::uint8_t{0x80}, data};
    }
    case kSave:
      saved_.sensor_format = current_.sensor_format;
      return std::nullopt;
    case kLoad:
      current_.sensor_format = saved_.sensor_format;
      stream_from(now_);
      return std::nullopt;
    case kReset:
      current_.sensor_format = factory().sensor_format;
      stream_from(now_);
      return std::nullopt;
    default:
      throw Refusal{kBadParameter};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::stream_control(Arguments arguments) {
  const std::uint8_t function = arguments.u8();
  const std::uint8_t set = arguments.u8();
  // 01, 02, 03 are the legacy names of the streams 80, 81, 82; 00 is all of them.
  const bool sensor = set == kSensorData || set == 0x01 || set == 0x00;
  if (!sensor && set != 0x03 && set != kFilterData) throw Refusal{kBadParameter};
  switch (function) {
    case kWrite: {
      const std::uint8_t enable = arguments.u8();
      arguments.done();
      if (enable > 1) throw Refusal{kBadParameter};
      if (!sensor) return std::nullopt;  // this device has nothing else to stream
      current_.sensor_stream = enable == 1;
      // Hosts that enable a stream after "set idle" and never send "resume" expect data [unverified against a
      // device].
      if (current_.sensor_stream) idle_ = false;
      stream_from(now_);
      return std::nullopt;
    }
    case kRead:
      return Answer{0x85,
                    {static_cast<char>(set), static_cast<char>(sensor && current_.sensor_stream ? 1 : 0)}};
    case kSave:
      saved_.sensor_stream = current_.sensor_stream;
      return std::nullopt;
    case kLoad:
      current_.sensor_stream = saved_.sensor_stream;
      stream_from(now_);
      return std::nullopt;
    case kReset:
      current_.sensor_stream = factory().sensor_stream;
      stream_from(now_);
      return std::nullopt;
    default:
      throw Refusal{kBadParameter};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::baud_rate(bool modern, Arguments arguments) {
  const std::uint8_t function = arguments.u8();
  const std::uint8_t port = modern ? arguments.u8() : std::uint8_t{1};
  switch (function) {
    case kWrite: {
      const std::uint32_t baud = arguments.u32();
      arguments.done();
      if (std::find(kBaudRates.begin(), kBaudRates.end(), baud) == kBaudRates.end())
        throw Refusal{kBadParameter};
      current_.baud = baud;  // a pseudo-terminal has no line rate: it is kept, and nothing changes
      return std::nullopt;
    }
    case kRead: {
      std::string data;
      if (modern) put(data, port);
      put_big_endian(data, current_.baud);
      return Answer{modern ? std::uint8_t{0x89} : std::uint8_t{0x87}, data};
    }
    case kSave:
      saved_.baud = current_.baud;
      return std::nullopt;
    case kLoad:
      current_.baud = saved_.baud;
      return std::nullopt;
    case kReset:
      current_.baud = factory().baud;
      return std::nullopt;
    default:
      throw Refusal{kBadParameter};
  }
}

void MipFirmware::Device::device_settings(Arguments arguments) {
  const std::uint8_t function = arguments.u8();
  arguments.done();
  switch (function) {
    case kSave:
      saved_ = current_;
      return;
    case kLoad:
      current_ = saved_;
      stream_from(now_);
      return;
    case kReset:
      current_ = factory();
      stream_from(now_);
      return;
    default:
      throw Refusal{kBadParameter};
  }
}

void MipFirmware::Device::poll(Arguments arguments) {
  // The maker's check file puts the two bytes the other way round than his command list: both are taken.
  std::uint8_t set = arguments.u8();
  std::uint8_t suppress_ack = arguments.u8();
  if (set <= 1 && suppress_ack == kSensorData) std::swap(set, suppress_ack);
  const std::uint8_t count = arguments.u8();
  if (set != kSensorData || suppress_ack > 1) throw Refusal{kBadParameter};
  // Two forms are in use: {descriptor} and {descriptor, u16 reserved}.
  const bool with_reserved = arguments.left() == std::size_t{3} * count;
  if (!with_reserved && arguments.left() != count) throw Refusal{kBadParameter};
  std::vector<std::uint8_t> fields;
  for (unsigned n = 0; n < count; ++n) {
    fields.push_back(arguments.u8());
    if (with_reserved) arguments.u16();
    if (std::find(kSensorFields.begin(), kSensorFields.end(), fields.back()) == kSensorFields.end())
      throw Refusal{kBadParameter};
  }
  if (fields.empty())
    for (const Rate& rate : current_.sensor_format) fields.push_back(rate.descriptor);
  const std::uint64_t next = grid_.first_after(now_);
  if (!bench_->fault_at(FaultKind::kNoOutput, now_))
    after_ack_.emplace_back(kSensorData, sensor_packet(fields, next > 0 ? next - 1 : 0));
  suppress_ack_ = suppress_ack == 1;
}

std::string MipFirmware::Device::device_info() const {
  std::string data;
  put_big_endian(data, static_cast<std::uint16_t>(settings_.firmware_version));
  for (std::string text : {settings_.model_name, settings_.model_number, settings_.serial_number,
                           settings_.lot_number, settings_.options}) {
    text.insert(0, 16 - text.size(), ' ');  // 16 characters, padded on the left [unverified against a device]
    data += text;
  }
  return data;
}

std::string MipFirmware::Device::descriptors() const {
  std::string data;
  const auto add = [&](std::uint8_t set, std::initializer_list<std::uint8_t> fields) {
    for (const std::uint8_t field : fields) {
      put(data, set);
      put(data, field);
    }
  };
  add(kBaseSet, {0x01, 0x02, 0x03, 0x04, 0x06});
  if (settings_.modern_commands) add(kBaseSet, {0x09});
  add(kBaseSet, {0x7E});
  if (settings_.legacy_commands) add(k3dmSet, {0x06, 0x08});
  add(k3dmSet, {0x0D});
  if (settings_.modern_commands) add(k3dmSet, {0x0E, 0x0F});
  add(k3dmSet, {0x11, 0x30, 0x40});
  for (const std::uint8_t field : kSensorFields) add(kSensorData, {field});
  return data;
}

// Samples.

void MipFirmware::Device::stream_from(Clock::Instant now) {
  if (!streaming()) return;
  next_tick_ = grid_.first_after(now);
  next_tick_ = next_tick_ > 0 ? next_tick_ - 1 : 0;
  advance_tick();
}

/// To the next tick at which a field is due: a multiple of its decimation.
void MipFirmware::Device::advance_tick() {
  std::uint64_t next = std::numeric_limits<std::uint64_t>::max();
  for (const Rate& rate : current_.sensor_format)
    next = std::min(next, (next_tick_ / rate.decimation + 1) * rate.decimation);
  next_tick_ = next;
}

std::string MipFirmware::Device::sensor_packet(const std::vector<std::uint8_t>& fields,
                                               std::uint64_t tick) const {
  const Clock::Instant t = grid_.time(tick);
  if (!last_output_ || last_output_->first != tick)
    last_output_.emplace(tick, bench_->output(t, tick, grid_.period()));
  const SimOutput& output = last_output_->second;
  std::string payload;
  std::string data;
  for (const std::uint8_t field : fields) {
    data.clear();
    switch (field) {
      case kAccelerometer:
        for (int j = 0; j < 3; ++j) put_big_endian_float(data, output.value[j]);
        break;
      case kDeltaVelocity:
        for (int j = 0; j < 3; ++j) put_big_endian_float(data, output.value[j] / settings_.base_rate_hz);
        break;
      case kGyro:
      case kMagnetometer:
      case kDeltaTheta:  // not simulated
        data.assign(12, '\0');
        break;
      case kTemperature:  // lowest, highest, mean
        for (int j = 0; j < 3; ++j) put_big_endian_float(data, output.temperature_degc);
        break;
      case kOverRange: {  // bits 0 to 2: accelerometer x, y, z
        unsigned bits = 0;
        for (std::size_t j = 0; j < 3; ++j)
          if (output.clipped[j]) bits |= 1U << j;
        put_big_endian(data, static_cast<std::uint16_t>(bits));
        break;
      }
      case kReferenceTime:
        put_big_endian(data, static_cast<std::uint64_t>((t - bench_->start()).count()));
        break;
      default: {  // kReferenceTimeDelta: since the packet before
        std::uint64_t before = 0;
        for (const Rate& rate : current_.sensor_format)
          if (tick > 0) before = std::max(before, (tick - 1) / rate.decimation * rate.decimation);
        put_big_endian(data, static_cast<std::uint64_t>((t - grid_.time(before)).count()));
      }
    }
    put_field(payload, field, data);
  }
  return payload;
}

std::string MipFirmware::Device::transmit(Clock::Instant now) {
  std::string out;
  std::vector<std::uint8_t> fields;
  while (streaming() && grid_.time(next_tick_) <= now) {
    const Clock::Instant t = grid_.time(next_tick_);
    out += replies_.take(t);
    if (!bench_->fault_at(FaultKind::kNoOutput, t)) {
      fields.clear();
      for (const Rate& rate : current_.sensor_format)
        if (next_tick_ % rate.decimation == 0) fields.push_back(rate.descriptor);
      out += packet(kSensorData, sensor_packet(fields, next_tick_));
    }
    advance_tick();
  }
  return out + replies_.take(now);
}

std::optional<Clock::Instant> MipFirmware::Device::next_due() const {
  std::optional<Clock::Instant> due = replies_.next_due();
  if (streaming()) due = due ? std::min(*due, grid_.time(next_tick_)) : grid_.time(next_tick_);
  return due;
}

MipFirmware::MipFirmware(std::shared_ptr<SimBench> bench, MipSettings settings)
    : device_(std::make_unique<Device>(std::move(bench), std::move(settings))) {}

MipFirmware::~MipFirmware() = default;

void MipFirmware::receive(std::string_view bytes, Clock::Instant now) {
  device_->receive(bytes, now);
}

std::string MipFirmware::transmit(Clock::Instant now) {
  return device_->transmit(now);
}

std::optional<Clock::Instant> MipFirmware::next_due() const {
  return device_->next_due();
}

}  // namespace abcal::sim
