#include "sim/firmware/mip_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
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
constexpr std::size_t kUsualPacket = 64;  // Room for the packet of a stream with four fields.

constexpr std::uint8_t kBaseSet = 0x01;
constexpr std::uint8_t k3dmSet = 0x0C;
constexpr std::uint8_t kFilterSet = 0x0D;
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
constexpr std::uint8_t kInternalTime = 0x0E;
constexpr std::uint8_t kGpsTime = 0x12;
constexpr std::uint8_t kTemperature = 0x14;
constexpr std::uint8_t kPressure = 0x17;
constexpr std::uint8_t kOverRange = 0x18;
constexpr std::uint8_t kFilterQuaternion = 0x03;
constexpr std::uint8_t kFilterEuler = 0x05;
constexpr std::uint8_t kFilterGyroBias = 0x06;
constexpr std::uint8_t kFilterAccelBias = 0x07;
constexpr std::uint8_t kAttitudeUncertainty = 0x0A;
constexpr std::uint8_t kGyroBiasUncertainty = 0x0B;
constexpr std::uint8_t kAccelBiasUncertainty = 0x0C;
constexpr std::uint8_t kLinearAcceleration = 0x0D;
constexpr std::uint8_t kAngularRate = 0x0E;
constexpr std::uint8_t kFilterStatus = 0x10;
constexpr std::uint8_t kFilterTime = 0x11;
constexpr std::uint8_t kQuaternionUncertainty = 0x12;
constexpr std::uint8_t kGravity = 0x13;
constexpr std::uint8_t kCompensatedAcceleration = 0x1C;
constexpr std::uint8_t kEventSource = 0xD0;
constexpr std::uint8_t kSharedGpsTime = 0xD3;
constexpr std::uint8_t kReferenceTime = 0xD5;
constexpr std::uint8_t kReferenceTimeDelta = 0xD6;
constexpr std::array kSensorFields{
    kAccelerometer, kGyro,          kMagnetometer,  kDeltaTheta,        kDeltaVelocity,
    kInternalTime,  kGpsTime,       kTemperature,   kPressure,          kOverRange,
    kEventSource,   kSharedGpsTime, kReferenceTime, kReferenceTimeDelta};
constexpr std::array kFilterFields{kFilterQuaternion,
                                   kFilterEuler,
                                   kFilterGyroBias,
                                   kFilterAccelBias,
                                   kAttitudeUncertainty,
                                   kGyroBiasUncertainty,
                                   kAccelBiasUncertainty,
                                   kQuaternionUncertainty,
                                   kAngularRate,
                                   kLinearAcceleration,
                                   kFilterStatus,
                                   kFilterTime,
                                   kGravity,
                                   kEventSource,
                                   kCompensatedAcceleration,
                                   kSharedGpsTime,
                                   kReferenceTime,
                                   kReferenceTimeDelta};

constexpr double kPressureMbar = 1013.25;
constexpr double kStandardGravity = 9.80665;  // m/s2
// From a reset of the filter until it has a solution [unverified against a device].
constexpr Clock::Duration kFilterStart = std::chrono::seconds(1);
enum FilterState : std::uint16_t { kFilterInitialises = 1, kFilterRuns = 2, kFilterRunsWithHeading = 3 };

/// Units that have a command.
enum class Family { kAll, kLegacy, kModern };

/// A setting that is kept and read back: function, key, value.
struct Kept {
  std::uint8_t set;
  std::uint8_t command;
  std::uint8_t reply;
  Family family;
  std::size_t key;                ///< Number of bytes after the function that select one.
  std::size_t size;               ///< Bytes of the value; 0: any.
  std::string_view initial = {};  ///< Initial value, extended with zeros.
};
constexpr std::uint8_t kAccelBias = 0x37;
constexpr std::uint8_t kGyroBias = 0x38;
constexpr std::string_view kIdentity{
    "\x3F\x80\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x3F\x80\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x3F\x80\0\0", 36};
// Layouts: docs/protocols/mip.md. The replies of the set 0D are [unverified against a device].
constexpr auto kKept = std::to_array<Kept>({
    {k3dmSet, 0x2B, 0xB5, Family::kModern, 1, 1},                    // event control
    {k3dmSet, 0x2E, 0xB8, Family::kModern, 1, 0},                    // event trigger
    {k3dmSet, 0x2F, 0xB9, Family::kModern, 1, 0},                    // event action
    {k3dmSet, 0x31, 0xB1, Family::kModern, 0, 12},                   // rotation to the vehicle: Euler angles
    {k3dmSet, 0x32, 0xB2, Family::kModern, 0, 16, "\x3F\x80"},       // ... quaternion
    {k3dmSet, 0x33, 0xB3, Family::kModern, 0, 36},                   // ... matrix
    {k3dmSet, kAccelBias, 0x9A, Family::kAll, 0, 12},                // accelerometer bias
    {k3dmSet, kGyroBias, 0x9B, Family::kAll, 0, 12},                 // gyro bias
    {k3dmSet, 0x3A, 0x9C, Family::kAll, 0, 12},                      // hard iron offset
    {k3dmSet, 0x3B, 0x9D, Family::kAll, 0, 36, kIdentity},           // soft iron matrix
    {k3dmSet, 0x3E, 0x9E, Family::kAll, 0, 1, "\x01"},               // coning and sculling
    {k3dmSet, 0x50, 0x8B, Family::kLegacy, 1, 5},                    // low-pass filter
    {k3dmSet, 0x51, 0x97, Family::kLegacy, 0, 10, "\x01\x01"},       // complementary filter
    {k3dmSet, 0x52, 0xD2, Family::kModern, 1, 1, "\x01"},            // range of a sensor
    {k3dmSet, 0x54, 0xD4, Family::kModern, 2, 6},                    // low-pass filter
    {kFilterSet, 0x11, 0x81, Family::kAll, 0, 12},                   // rotation to the vehicle
    {kFilterSet, 0x10, 0x80, Family::kLegacy, 0, 1, "\x01"},         // vehicle dynamics: portable
    {kFilterSet, 0x12, 0x82, Family::kLegacy, 0, 12},                // offset to the vehicle
    {kFilterSet, 0x14, 0x84, Family::kLegacy, 0, 2, "\xFF\xFF"},     // what is estimated
    {kFilterSet, 0x18, 0x87, Family::kLegacy, 0, 1, "\x01"},         // source of the heading
    {kFilterSet, 0x19, 0x88, Family::kLegacy, 0, 1, "\x01"},         // initialises on its own
    {kFilterSet, 0x1A, 0x89, Family::kLegacy, 0, 12},                // noise of the accelerometer
    {kFilterSet, 0x1B, 0x8A, Family::kLegacy, 0, 12},                // noise of the gyro
    {kFilterSet, 0x1D, 0x8C, Family::kLegacy, 0, 24},                // model of the gyro's bias
    {kFilterSet, 0x41, 0xB0, Family::kLegacy, 0, 2, {"\0\x03", 2}},  // measurements that are used
    {kFilterSet, 0x50, 0xD0, Family::kModern, 2, 1, "\x01"},         // an aiding measurement is used
});
constexpr unsigned kEvents = 12;

const Kept* kept_command(std::uint8_t set, std::uint8_t command) {
  const auto found = std::find_if(kKept.begin(), kKept.end(),
                                  [&](const Kept& k) { return k.set == set && k.command == command; });
  return found == kKept.end() ? nullptr : &*found;
}

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

std::string field_of(std::uint8_t descriptor, std::string_view data) {
  std::string field;
  put_field(field, descriptor, data);
  return field;
}

/// Appends a packet whose payload `put_payload` appends.
template <class PutPayload>
void put_packet(std::string& out, std::uint8_t set, const PutPayload& put_payload) {
  const std::size_t begin = out.size();
  out.append({static_cast<char>(kSync1), static_cast<char>(kSync2), static_cast<char>(set), '\0'});
  put_payload();
  out[begin + kHeader - 1] = static_cast<char>(out.size() - begin - kHeader);
  put_big_endian(out, checksum(std::string_view(out).substr(begin)));
}

std::string packet(std::uint8_t set, std::string_view payload) {
  std::string bytes;
  put_packet(bytes, set, [&] { bytes += payload; });
  return bytes;
}

/// Thrown by a command that is refused.
struct Refusal {
  AckCode code;
  std::optional<std::uint8_t> data_field = {};  ///< The field of a data set that the model does not have.
};

/// "0C,08 01 01 04 00 0A": set, command, arguments.
std::string in_hexadecimal(std::uint8_t set, std::uint8_t command, std::string_view data) {
  std::string text = fmt::format("{:02X},{:02X}", set, command);
  for (const char c : data) text += fmt::format(" {:02X}", byte(c));
  return text;
}

/// The data of one command field, read from the front.
class Arguments {
 public:
  explicit Arguments(std::string_view data) : data_(data) {}
  std::uint8_t u8() { return static_cast<std::uint8_t>(take(1)); }
  std::uint16_t u16() { return static_cast<std::uint16_t>(take(2)); }
  std::uint32_t u32() { return take(4); }
  std::string bytes(std::size_t count) {
    if (data_.size() < count) throw Refusal{kBadParameter};
    const std::string taken(data_.substr(0, count));
    data_.remove_prefix(count);
    return taken;
  }
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

/// Settings that can be saved, loaded and reset.
struct Stored {
  struct Stream {
    std::vector<Rate> format;
    bool on = true;
  };
  std::map<std::uint8_t, Stream> streams;  ///< By data set: 80 and 82.
  std::uint32_t baud = 115200;
  std::map<std::string, std::string> kept;  ///< Set, command and key -> value.
};

bool has_field(std::uint8_t set, std::uint8_t descriptor, bool magnetometer) {
  if (set == kFilterData)
    return std::find(kFilterFields.begin(), kFilterFields.end(), descriptor) != kFilterFields.end();
  if (descriptor == kMagnetometer && !magnetometer) return false;
  return std::find(kSensorFields.begin(), kSensorFields.end(), descriptor) != kSensorFields.end();
}

std::string kept_name(std::uint8_t set, std::uint8_t command, std::string_view key) {
  return std::string{static_cast<char>(set), static_cast<char>(command)} + std::string(key);
}

}  // namespace

class MipFirmware::Device final : public Firmware {
 public:
  Device(std::shared_ptr<SimBench> bench, MipSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  void power(bool on, Clock::Instant now) override;
  void session_starts() override {
    input_.clear();
    replies_.clear();
  }
  std::optional<unsigned> line_speed() const override { return line_speed_; }
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;

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
  std::optional<Answer> run_filter(std::uint8_t command, Arguments arguments);
  std::optional<Answer> keep(const Kept& kept, Arguments arguments);
  bool has(Family family) const {
    return family == Family::kAll ||
           (family == Family::kLegacy ? settings_.legacy_commands : settings_.modern_commands);
  }
  void require(Family family) const {
    if (!has(family)) throw Refusal{kUnknown};
  }
  bool has_magnetometer() const { return settings_.magnetometer; }
  Answer event_support(Arguments arguments) const;
  static Answer event_status(bool of_triggers, Arguments arguments);
  std::optional<Answer> message_format(bool modern, std::uint8_t legacy_set, Arguments arguments);
  Eigen::Vector3d bias_of(std::uint8_t command) const;
  Eigen::Vector3d accelerometer_bias() const { return bias_of(kAccelBias); }
  Eigen::Vector3d gyro_bias() const { return bias_of(kGyroBias); }
  std::optional<Answer> stream_control(Arguments arguments);
  std::optional<Answer> baud_rate(bool modern, Arguments arguments);
  void device_settings(Arguments arguments);
  Answer device_status(Arguments arguments) const;
  void poll(Arguments arguments, std::optional<std::uint8_t> legacy_set);
  std::string device_info() const;
  std::string descriptors() const;
  const SimOutput& output_at(std::uint64_t tick) const;
  void put_fields(std::string& payload, std::uint8_t set, const std::vector<std::uint8_t>& fields,
                  std::uint64_t tick) const;
  void put_sensor_data(std::string& out, std::uint8_t field, std::uint64_t tick) const;
  void put_filter_data(std::string& out, std::uint8_t field, std::uint64_t tick) const;
  void put_shared_data(std::string& out, std::uint8_t set, std::uint8_t field, std::uint64_t tick) const;
  Stored factory() const;

  bool streaming() const {
    return !idle_ && std::any_of(current_.streams.begin(), current_.streams.end(), [](const auto& stream) {
      return stream.second.on && !stream.second.format.empty();
    });
  }
  void stream_from(Clock::Instant now);
  void advance_tick();

  std::shared_ptr<SimBench> bench_;
  MipSettings settings_;
  UnservedCommands& unserved_;
  SampleGrid grid_;
  Stored current_;
  Stored saved_;
  bool idle_;
  std::uint64_t next_tick_ = 0;  ///< The next at which a packet of the stream is due.
  Clock::Instant next_time_;     ///< Time of that tick.
  std::vector<std::uint8_t> due_fields_;
  mutable std::optional<std::pair<std::uint64_t, SimOutput>> last_output_;
  std::string input_;
  ReplyQueue replies_;
  std::vector<std::pair<std::uint8_t, std::string>> after_ack_;
  bool suppress_ack_ = false;  ///< Suppresses the acknowledgement of the command in hand.
  Clock::Duration takes_ = Clock::Duration::zero();  ///< The present command, before it is answered.
  unsigned line_speed_;
  Clock::Instant filter_since_;  ///< Its last reset.
  Clock::Instant powered_since_;
  Clock::Instant now_;
};

MipFirmware::Device::Device(std::shared_ptr<SimBench> bench, MipSettings settings, UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      grid_(bench_->start(), std::max(1U, settings_.base_rate_hz)),
      idle_(!settings_.streaming_at_power_on),
      next_time_(grid_.time(0)),
      line_speed_(settings_.baud),
      filter_since_(bench_->start()),
      powered_since_(bench_->start()),
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
  return {.streams = {{kSensorData, {{{kAccelerometer, decimation}, {kReferenceTime, decimation}}, true}},
                      {kFilterData, {{}, true}}},
          .baud = settings_.baud,
          .kept = {}};
}

void MipFirmware::Device::power(bool on, Clock::Instant now) {
  now_ = now;
  session_starts();
  idle_ = true;
  if (!on) return;
  current_ = saved_;
  line_speed_ = current_.baud;
  filter_since_ = powered_since_ = now;
  idle_ = !settings_.streaming_at_power_on;
  stream_from(now);
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
    // A wrong checksum may be caused by a wrong length: a good packet may begin behind the two sync bytes.
    at += holds ? size : 2;
  }
  input_.erase(0, at);
}

void MipFirmware::Device::run_packet(std::uint8_t set, std::string_view payload, bool checksum_holds) {
  std::string reply;
  after_ack_.clear();
  takes_ = Clock::Duration::zero();
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
        const std::string bytes = packet(set, field_of(command, data));
        if (code == kUnknown) {
          unserved_.note(in_hexadecimal(set, command, ""), "not emulated: NACK 01", bytes);
        } else if (refusal.data_field) {
          unserved_.note(in_hexadecimal(set, command, data),
                         fmt::format("no data field {:02X}: NACK 03", *refusal.data_field), bytes);
        }
      }
    }
    if (!suppress_ack_)
      put_field(reply, kAck, std::string{static_cast<char>(command), static_cast<char>(code)});
    if (answer) put_field(reply, answer->descriptor, answer->data);
    if (!checksum_holds) break;
  }
  if (!reply.empty()) replies_.push(packet(set, reply), now_ + settings_.reply_delay + takes_);
  for (const auto& [data_set, fields] : after_ack_)
    replies_.push(packet(data_set, fields), now_ + settings_.reply_delay + takes_);
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::run_command(std::uint8_t set,
                                                                            std::uint8_t command,
                                                                            Arguments arguments) {
  if (const Kept* kept = kept_command(set, command)) {
    require(kept->family);
    return keep(*kept, arguments);
  }
  switch (set) {
    case kFilterSet:
      return run_filter(command, arguments);
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
    case 0x05: {  // built-in test: nothing is wrong
      arguments.done();
      std::string data;
      put_big_endian(data, std::uint32_t{0});
      return Answer{0x83, data};
    }
    case 0x07:  // the rest of the descriptors: the list fits in one packet
      arguments.done();
      return Answer{0x86, {}};
    case 0x08:  // continuous built-in test
      arguments.done();
      return Answer{0x88, std::string(16, '\0')};
    case 0x06:  // resume
      arguments.done();
      idle_ = false;
      stream_from(now_);
      return std::nullopt;
    case 0x09:
      if (!settings_.modern_commands) throw Refusal{kUnknown};
      return baud_rate(true, arguments);
    case 0x7E:  // soft reset: the state after power on, with the saved settings
      arguments.done();
      current_ = saved_;
      filter_since_ = now_;
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
    case 0x01:  // poll of the sensors, of the filter
    case 0x03:
      poll(arguments, command == 0x01 ? kSensorData : kFilterData);
      return std::nullopt;
    // The 7 series knows the older names of format and base rate too [unverified against a device].
    case 0x06:  // base rate, legacy
      arguments.done();
      put_big_endian(data, static_cast<std::uint16_t>(settings_.base_rate_hz));
      return Answer{0x83, data};
    case 0x08:
      return message_format(false, kSensorData, arguments);
    case 0x0A:
      return message_format(false, kFilterData, arguments);
    case 0x0B:  // base rate of the filter, legacy
      arguments.done();
      put_big_endian(data, static_cast<std::uint16_t>(settings_.base_rate_hz));
      return Answer{0x8A, data};
    case 0x0D:
      poll(arguments, std::nullopt);
      return std::nullopt;
    case 0x0E: {  // base rate, modern
      if (!settings_.modern_commands) throw Refusal{kUnknown};
      const std::uint8_t set = arguments.u8();
      arguments.done();
      if (set != kSensorData && set != kFilterData) throw Refusal{kBadParameter};
      put(data, set);
      put_big_endian(data, static_cast<std::uint16_t>(settings_.base_rate_hz));
      return Answer{0x8E, data};
    }
    case 0x0F:
      if (!settings_.modern_commands) throw Refusal{kUnknown};
      return message_format(true, 0, arguments);
    case 0x2A:
      require(Family::kModern);
      return event_support(arguments);
    case 0x2C:
    case 0x2D:
      require(Family::kModern);
      return event_status(command == 0x2C, arguments);
    case 0x39: {  // capture of the gyro bias: lasts for the commanded time
      takes_ = std::chrono::milliseconds(arguments.u16());
      arguments.done();
      current_.kept[kept_name(k3dmSet, 0x38, "")] = std::string(12, '\0');
      return Answer{0x9B, std::string(12, '\0')};
    }
    case 0x11:
      return stream_control(arguments);
    case 0x30:
      device_settings(arguments);
      return std::nullopt;
    case 0x40:
      return baud_rate(false, arguments);
    case 0x64:
      require(Family::kLegacy);
      return device_status(arguments);
    default:
      throw Refusal{kUnknown};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::run_filter(std::uint8_t command,
                                                                           Arguments arguments) {
  switch (command) {
    case 0x01:  // reset
      arguments.done();
      filter_since_ = now_;
      return std::nullopt;
    case 0x02:  // initial attitude
      arguments.bytes(12);
      arguments.done();
      return std::nullopt;
    case 0x03:  // initial heading
      arguments.bytes(4);
      arguments.done();
      return std::nullopt;
    default:
      throw Refusal{kUnknown};
  }
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::keep(const Kept& kept, Arguments arguments) {
  const std::uint8_t function = arguments.u8();
  const std::string key = arguments.bytes(kept.key);
  const std::string name = kept_name(kept.set, kept.command, key);
  const auto copy = [&](const Stored& from, Stored& to) {
    const auto found = from.kept.find(name);
    if (found == from.kept.end()) {
      to.kept.erase(name);
    } else {
      to.kept[name] = found->second;
    }
  };
  const bool of_an_event = kept.set == k3dmSet && (kept.command == 0x2E || kept.command == 0x2F);
  switch (function) {
    case kWrite: {
      const std::size_t size = kept.size == 0 ? arguments.left() : kept.size;
      const std::string value = arguments.bytes(size);
      arguments.done();
      if (kept.set == k3dmSet && (kept.command == kAccelBias || kept.command == kGyroBias)) {
        Arguments numbers(value);
        for (int j = 0; j < 3; ++j)
          if (!std::isfinite(std::bit_cast<float>(numbers.u32()))) throw Refusal{kBadParameter};
      }
      current_.kept[name] = value;
      if (of_an_event)
        unserved_.note(fmt::format("{:02X},{:02X}", kept.set, kept.command),
                       "kept; events are not carried out");
      return std::nullopt;
    }
    case kRead: {
      arguments.done();
      const auto found = current_.kept.find(name);
      if (found != current_.kept.end()) return Answer{kept.reply, key + found->second};
      std::string initial(kept.initial);
      initial.resize(kept.size, '\0');
      return Answer{kept.reply, key + initial};
    }
    case kSave:
      copy(current_, saved_);
      return std::nullopt;
    case kLoad:
      copy(saved_, current_);
      return std::nullopt;
    case kReset:
      current_.kept.erase(name);
      return std::nullopt;
    default:
      throw Refusal{kBadParameter};
  }
}

/// Supported triggers (1) or actions (2): kinds and their numbers [unverified against a device].
MipFirmware::Device::Answer MipFirmware::Device::event_support(Arguments arguments) const {
  const std::uint8_t query = arguments.u8();
  arguments.done();
  if (query != 1 && query != 2) throw Refusal{kBadParameter};
  std::string data{static_cast<char>(query), static_cast<char>(kEvents)};
  const std::string kinds =
      query == 1 ? std::string("\x03\x01\x04\x02\x0C\x03\x0C", 7) : std::string("\x02\x01\x04\x02\x0C", 5);
  return {0xB4, data + kinds};
}

/// Kind and state of each requested event; none has happened.
MipFirmware::Device::Answer MipFirmware::Device::event_status(bool of_triggers, Arguments arguments) {
  const std::uint8_t count = arguments.u8();
  arguments.bytes(count);
  arguments.done();
  if (count > kEvents) throw Refusal{kBadParameter};
  return {static_cast<std::uint8_t>(of_triggers ? 0xB6 : 0xB7),
          std::string(1, static_cast<char>(count)) + std::string(std::size_t{2} * count, '\0')};
}

std::optional<MipFirmware::Device::Answer> MipFirmware::Device::message_format(bool modern,
                                                                               std::uint8_t legacy_set,
                                                                               Arguments arguments) {
  const std::uint8_t function = arguments.u8();
  const std::uint8_t set = modern ? arguments.u8() : legacy_set;
  if (set != kSensorData && set != kFilterData) throw Refusal{kBadParameter};
  std::vector<Rate>& format = current_.streams[set].format;
  switch (function) {
    case kWrite: {
      const std::uint8_t count = arguments.u8();
      std::vector<Rate> wanted;
      for (unsigned n = 0; n < count; ++n) {
        const std::uint8_t descriptor = arguments.u8();
        const std::uint16_t decimation = arguments.u16();
        if (!has_field(set, descriptor, has_magnetometer())) throw Refusal{kBadParameter, descriptor};
        if (decimation == 0) throw Refusal{kBadParameter};
        wanted.push_back({descriptor, decimation});
      }
      arguments.done();
      format = std::move(wanted);
      stream_from(now_);
      return std::nullopt;
    }
    case kRead: {
      std::string data;
      if (modern) put(data, set);
      put(data, static_cast<std::uint8_t>(format.size()));
      for (const Rate& rate : format) {
        put(data, rate.descriptor);
        put_big_endian(data, rate.decimation);
      }
      const std::uint8_t legacy_reply = set == kSensorData ? 0x80 : 0x82;
      return Answer{modern ? std::uint8_t{0x8F} : legacy_reply, data};
    }
    case kSave:
      saved_.streams[set].format = format;
      return std::nullopt;
    case kLoad:
      format = saved_.streams[set].format;
      stream_from(now_);
      return std::nullopt;
    case kReset:
      format = factory().streams[set].format;
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
  std::vector<std::uint8_t> wanted;
  if (set == kSensorData || set == 0x01 || set == 0x00) wanted.push_back(kSensorData);
  if (set == kFilterData || set == 0x03 || set == 0x00) wanted.push_back(kFilterData);
  if (wanted.empty()) throw Refusal{kBadParameter};
  const auto switch_all = [&](auto on_of) {
    for (const std::uint8_t each : wanted) current_.streams[each].on = on_of(each);
    stream_from(now_);
  };
  switch (function) {
    case kWrite: {
      const std::uint8_t enable = arguments.u8();
      arguments.done();
      if (enable > 1) throw Refusal{kBadParameter};
      // Hosts that enable a stream after "set idle" and never send "resume" expect data [unverified against a
      // device].
      if (enable == 1) idle_ = false;
      switch_all([&](std::uint8_t) { return enable == 1; });
      return std::nullopt;
    }
    case kRead:
      return Answer{0x85,
                    {static_cast<char>(set), static_cast<char>(current_.streams[wanted.front()].on ? 1 : 0)}};
    case kSave:
      for (const std::uint8_t each : wanted) saved_.streams[each].on = current_.streams[each].on;
      return std::nullopt;
    case kLoad:
      switch_all([&](std::uint8_t each) { return saved_.streams[each].on; });
      return std::nullopt;
    case kReset:
      switch_all([&](std::uint8_t each) { return factory().streams[each].on; });
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
      current_.baud = baud;
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

/// State and counters of the streams, none of which has lost anything [unverified against a device].
MipFirmware::Device::Answer MipFirmware::Device::device_status(Arguments arguments) const {
  constexpr std::uint8_t kBasic = 1;
  constexpr std::uint8_t kDiagnostic = 2;
  constexpr std::size_t kPulses = 2;      // Pulses of a satellite receiver: number and time.
  constexpr std::size_t kCounters = 13;   // Packets, bytes and overruns of each port.
  std::string data = arguments.bytes(2);  // The model that the host has named.
  const std::uint8_t selector = arguments.u8();
  arguments.done();
  if (selector != kBasic && selector != kDiagnostic) throw Refusal{kBadParameter};
  put(data, selector);
  put_big_endian(data, std::uint32_t{0});  // no fault
  put_big_endian(data,
                 static_cast<std::uint32_t>(
                     std::chrono::duration_cast<std::chrono::milliseconds>(now_ - powered_since_).count()));
  if (selector == kDiagnostic) {
    data.append(4 * kPulses, '\0');
    for (const std::uint8_t set : {kSensorData, kFilterData})
      put(data, current_.streams.at(set).on ? std::uint8_t{1} : std::uint8_t{0});
    data.append(4 * kCounters, '\0');
  }
  return {0x90, data};
}

/// @param legacy_set  the data set that the command itself names; absent: the command states it
void MipFirmware::Device::poll(Arguments arguments, std::optional<std::uint8_t> legacy_set) {
  // The maker's check file puts the two bytes the other way round than his command list: both are taken.
  std::uint8_t set = legacy_set ? *legacy_set : arguments.u8();
  std::uint8_t suppress_ack = arguments.u8();
  if (set <= 1 && (suppress_ack == kSensorData || suppress_ack == kFilterData)) std::swap(set, suppress_ack);
  const std::uint8_t count = arguments.u8();
  if ((set != kSensorData && set != kFilterData) || suppress_ack > 1) throw Refusal{kBadParameter};
  // Two forms are in use: {descriptor} and {descriptor, u16 reserved}.
  const bool with_reserved = arguments.left() == std::size_t{3} * count;
  if (!with_reserved && arguments.left() != count) throw Refusal{kBadParameter};
  std::vector<std::uint8_t> fields;
  for (unsigned n = 0; n < count; ++n) {
    fields.push_back(arguments.u8());
    if (with_reserved) arguments.u16();
    if (!has_field(set, fields.back(), has_magnetometer())) throw Refusal{kBadParameter, fields.back()};
  }
  if (fields.empty())
    for (const Rate& rate : current_.streams[set].format) fields.push_back(rate.descriptor);
  const std::uint64_t next = grid_.first_after(now_);
  if (!bench_->fault_at(FaultKind::kNoOutput, now_))
    put_fields(after_ack_.emplace_back(set, "").second, set, fields, next > 0 ? next - 1 : 0);
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
  add(kBaseSet, {0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08});
  if (settings_.modern_commands) add(kBaseSet, {0x09});
  add(kBaseSet, {0x7E});
  add(k3dmSet, {0x01, 0x03, 0x06, 0x08, 0x0A, 0x0B, 0x0D});
  if (settings_.modern_commands) add(k3dmSet, {0x0E, 0x0F, 0x2A, 0x2C, 0x2D});
  add(k3dmSet, {0x11, 0x30, 0x39, 0x40});
  for (const Kept& kept : kKept)
    if (has(kept.family)) add(kept.set, {kept.command});
  if (settings_.legacy_commands) add(k3dmSet, {0x64});
  add(kFilterSet, {0x01, 0x02, 0x03});
  for (const std::uint8_t field : kSensorFields)
    if (has_field(kSensorData, field, has_magnetometer())) add(kSensorData, {field});
  for (const std::uint8_t field : kFilterFields) add(kFilterData, {field});
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
  for (const auto& [set, stream] : current_.streams) {
    if (!stream.on) continue;
    for (const Rate& rate : stream.format)
      next = std::min(next, (next_tick_ / rate.decimation + 1) * rate.decimation);
  }
  next_tick_ = next;
  next_time_ = grid_.time(next);
}

const SimOutput& MipFirmware::Device::output_at(std::uint64_t tick) const {
  if (!last_output_ || last_output_->first != tick)
    last_output_.emplace(tick, bench_->output(grid_.time(tick), tick, grid_.period()));
  return last_output_->second;
}

Eigen::Vector3d MipFirmware::Device::bias_of(std::uint8_t command) const {
  Eigen::Vector3d bias = Eigen::Vector3d::Zero();
  const auto found = current_.kept.find(kept_name(k3dmSet, command, ""));
  if (found == current_.kept.end()) return bias;
  Arguments numbers(found->second);
  for (int j = 0; j < 3; ++j) bias[j] = static_cast<double>(std::bit_cast<float>(numbers.u32()));
  return bias;
}

void MipFirmware::Device::put_fields(std::string& payload, std::uint8_t set,
                                     const std::vector<std::uint8_t>& fields, std::uint64_t tick) const {
  for (const std::uint8_t field : fields) {
    const std::size_t begin = payload.size();
    payload.append({'\0', static_cast<char>(field)});
    if (field >= kEventSource) {
      put_shared_data(payload, set, field, tick);
    } else if (set == kFilterData) {
      put_filter_data(payload, field, tick);
    } else {
      put_sensor_data(payload, field, tick);
    }
    payload[begin] = static_cast<char>(payload.size() - begin);
  }
}

/// Data that any data set may contain.
void MipFirmware::Device::put_shared_data(std::string& out, std::uint8_t set, std::uint8_t field,
                                          std::uint64_t tick) const {
  const Clock::Instant t = grid_.time(tick);
  switch (field) {
    case kEventSource:
      put(out, 0);  // 0: the stream itself is the source.
      return;
    case kReferenceTime:
      put_big_endian(out, static_cast<std::uint64_t>((t - powered_since_).count()));
      return;
    case kReferenceTimeDelta: {  // Since the packet before.
      std::uint64_t before = 0;
      for (const Rate& rate : current_.streams.at(set).format)
        if (tick > 0) before = std::max(before, (tick - 1) / rate.decimation * rate.decimation);
      put_big_endian(out, static_cast<std::uint64_t>((t - grid_.time(before)).count()));
      return;
    }
    default:  // GPS time: not valid
      out.append(12, '\0');
  }
}

void MipFirmware::Device::put_sensor_data(std::string& out, std::uint8_t field, std::uint64_t tick) const {
  const SimOutput& output = output_at(tick);
  const auto put_vector = [&](const Eigen::Vector3d& vector) {
    for (int j = 0; j < 3; ++j) put_big_endian_float(out, vector[j]);
  };
  switch (field) {
    case kAccelerometer:
      put_vector(output.value - accelerometer_bias());
      break;
    case kDeltaVelocity:
      put_vector((output.value - accelerometer_bias()) / settings_.base_rate_hz);
      break;
    case kInternalTime:  // ticks of the base rate
      put_big_endian(out,
                     static_cast<std::uint32_t>(
                         tick - (powered_since_ > bench_->start() ? grid_.first_after(powered_since_) : 0)));
      break;
    case kTemperature:  // lowest, highest, mean
      put_vector(Eigen::Vector3d::Constant(output.temperature_degc));
      break;
    case kPressure:
      put_big_endian_float(out, kPressureMbar);
      break;
    case kOverRange: {  // bits 0 to 2: accelerometer x, y, z
      unsigned bits = 0;
      for (std::size_t j = 0; j < 3; ++j)
        if (output.clipped[j]) bits |= 1U << j;
      put_big_endian(out, static_cast<std::uint16_t>(bits));
      break;
    }
    case kGyro:
    case kDeltaTheta: {
      const Eigen::Vector3d rate = bench_->body_motion(grid_.time(tick)).rate_B_radps - gyro_bias();
      const double over_s = field == kGyro ? 1.0 : 1.0 / settings_.base_rate_hz;
      put_vector(rate * over_s);
      break;
    }
    case kMagnetometer:
      put_vector(bench_->body_motion(grid_.time(tick)).field_B_gauss);
      break;
    default:  // GPS time: not valid
      out.append(12, '\0');
  }
}

/// Numbers, then whether they are valid.
void MipFirmware::Device::put_filter_data(std::string& out, std::uint8_t field, std::uint64_t tick) const {
  const Clock::Instant t = grid_.time(tick);
  const bool running = t - filter_since_ >= kFilterStart;
  const Eigen::Vector3d acceleration = output_at(tick).value - accelerometer_bias();
  const auto put_valid = [&] { put_big_endian(out, static_cast<std::uint16_t>(running ? 1 : 0)); };
  switch (field) {
    case kFilterStatus: {
      const bool heading = has_magnetometer() && settings_.modern_commands && !settings_.legacy_commands;
      const FilterState runs = heading ? kFilterRunsWithHeading : kFilterRuns;
      put_big_endian(out, static_cast<std::uint16_t>(running ? runs : kFilterInitialises));
      put_big_endian(out, std::uint16_t{1});  // dynamics: portable
      put_big_endian(out, std::uint16_t{0});
      return;
    }
    case kFilterTime:  // seconds of the week, week
      put_big_endian(out, std::bit_cast<std::uint64_t>(to_seconds(t - bench_->start())));
      put_big_endian(out, std::uint16_t{0});
      break;
    case kFilterQuaternion: {  // w, x, y, z; of the body in north, east, down
      const Eigen::Quaterniond q = quaternion_of(bench_->body_motion(t).to_ned());
      for (const double part : {q.w(), q.x(), q.y(), q.z()}) put_big_endian_float(out, part);
      break;
    }
    case kFilterEuler: {  // roll, pitch, yaw
      const Eigen::Vector3d angles = roll_pitch_yaw_of(bench_->body_motion(t).to_ned());
      for (int j = 0; j < 3; ++j) put_big_endian_float(out, angles[j]);
      break;
    }
    case kAngularRate: {
      const Eigen::Vector3d rate = bench_->body_motion(t).rate_B_radps - gyro_bias();
      for (int j = 0; j < 3; ++j) put_big_endian_float(out, rate[j]);
      break;
    }
    case kCompensatedAcceleration:
      // In m/s2, as the filter has it; from g.
      for (int j = 0; j < 3; ++j) put_big_endian_float(out, acceleration[j] * kStandardGravity);
      break;
    case kGravity: {  // downwards
      const Eigen::Vector3d gravity = -kStandardGravity * bench_->body_motion(t).R_LB.row(2).transpose();
      for (int j = 0; j < 3; ++j) put_big_endian_float(out, gravity[j]);
      break;
    }
    case kQuaternionUncertainty:
      out.append(16, '\0');
      break;
    default:  // uncertainties, as these outputs have no errors; biases that it has found; linear
              // acceleration: the axes of the stage meet in the accelerometer
      out.append(12, '\0');
  }
  put_valid();
}

std::string MipFirmware::Device::transmit(Clock::Instant now) {
  std::string out;
  out.reserve(kUsualPacket);
  while (streaming() && next_time_ <= now) {
    const Clock::Instant t = next_time_;
    out += replies_.take(t);
    if (!bench_->fault_at(FaultKind::kNoOutput, t)) {
      for (const auto& [set, stream] : current_.streams) {
        due_fields_.clear();
        for (const Rate& rate : stream.format)
          if (stream.on && next_tick_ % rate.decimation == 0) due_fields_.push_back(rate.descriptor);
        if (due_fields_.empty()) continue;
        put_packet(out, set, [&, set = set] { put_fields(out, set, due_fields_, next_tick_); });
      }
    }
    advance_tick();
  }
  out += replies_.take(now);
  // The answer to a change of the baud rate goes at the old one.
  if (!replies_.next_due()) line_speed_ = current_.baud;
  return out;
}

std::optional<Clock::Instant> MipFirmware::Device::next_due() const {
  std::optional<Clock::Instant> due = replies_.next_due();
  if (streaming()) due = due ? std::min(*due, next_time_) : next_time_;
  return due;
}

MipFirmware::MipFirmware(std::shared_ptr<SimBench> bench, MipSettings settings) {
  encase(std::make_unique<Device>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
