#include "sim/firmware/xsens_mti_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/firmware/big_endian.h"
#include "sim/firmware/reply_queue.h"
#include "sim/firmware/sample_grid.h"

namespace abcal::sim {
namespace {

constexpr char kPreamble = '\xFA';
constexpr char kBus = '\xFF';
constexpr std::size_t kHeader = 4;
constexpr std::size_t kExtendedHeader = 6;
constexpr unsigned kExtended = 0xFF;  // A length of this: two bytes with the real one follow.
constexpr std::size_t kLongestData = 2048;
constexpr std::size_t kMostOutputs = 32;
constexpr std::size_t kProductCode = 20;
constexpr Clock::Duration kMessageTimeout = std::chrono::milliseconds(100);
constexpr Clock::Duration kWakeUpWait = std::chrono::milliseconds(500);

enum MessageId : unsigned {
  kSetNoRotation = 0x22,
  kRunSelfTest = 0x24,
  kReqEmts = 0x90,
  kResetOrientation = 0xA4,
  kAlignmentRotation = 0xEC,
  kReqDeviceId = 0x00,
  kInitBus = 0x02,
  kReqConfiguration = 0x0C,
  kGotoMeasurement = 0x10,
  kReqFirmware = 0x12,
  kBaudrate = 0x18,
  kReqProductCode = 0x1C,
  kReqHardware = 0x1E,
  kSyncSettings = 0x2C,
  kGotoConfig = 0x30,
  kMtData2 = 0x36,
  kWakeUp = 0x3E,
  kWakeUpAck = 0x3F,
  kReset = 0x40,
  kError = 0x42,
  kOptionFlags = 0x48,
  kReqFilterProfiles = 0x62,
  kFilterProfile = 0x64,
  kLocationId = 0x84,
  kOutputConfiguration = 0xC0,
};

enum ErrorCode : std::uint8_t { kInvalidMessage = 0x04, kInvalidBaudrate = 0x20, kInvalidParameter = 0x21 };

bool known_message(unsigned id);

/// Thrown by a message that is refused.
struct Refusal {
  ErrorCode code;
};

struct BaudCode {
  unsigned code;
  unsigned baud;
};
constexpr std::array kBaudCodes{BaudCode{0x80, 921600}, BaudCode{0x00, 460800}, BaudCode{0x01, 230400},
                                BaudCode{0x02, 115200}, BaudCode{0x04, 57600},  BaudCode{0x05, 38400},
                                BaudCode{0x07, 19200},  BaudCode{0x09, 9600}};

/// A message whose data are kept, and do nothing.
struct Kept {
  unsigned id;
  std::size_t size;
  std::string_view initial;  ///< In hexadecimal; zeros where it is shorter.
};
// Ids and sizes: docs/protocols/xbus.md.
constexpr auto kKept = std::to_array<Kept>({
    {0x04, 2, "0480"},  // period, in units of 1 / 115200 s: 100 Hz
    {0x60, 12, ""},     // UTC
    {0x6E, 24, ""},     // latitude, longitude, altitude
    {0x76, 2, ""},      // GNSS platform
    {0x86, 2, ""},      // external output mode
    {0x8E, 2, ""},      // text outputs
    {0xD0, 2, "0002"},  // output mode of old hosts
    {0xD2, 4, ""},      // output settings of old hosts
    {0xD4, 2, ""},      // output skip factor
    {0xDA, 2, "0001"},  // error mode
    {0xDC, 2, ""},      // transmit delay
});

const Kept* kept_message(unsigned id) {
  const auto found = std::find_if(kKept.begin(), kKept.end(), [id](const Kept& k) { return k.id == id; });
  return found == kKept.end() ? nullptr : &*found;
}

// The maker's software reads the eMTS data before it measures, but ignores its content [unverified against a
// device].
constexpr std::size_t kEmtsSize = 64;
constexpr std::size_t kQuaternionSize = 16;
constexpr unsigned kAlignmentFrames = 2;  // of the sensor, of the world
constexpr double kPressurePa = 101325.0;
constexpr std::size_t kGnssPvtSize = 94;

struct FilterProfile {
  std::uint8_t type;
  std::uint8_t version;
  std::string_view name;
};
constexpr std::array kFilterProfiles{FilterProfile{39, 1, "general"}, FilterProfile{40, 1, "high_mag_dep"},
                                     FilterProfile{41, 1, "dynamic"}};

// Data ids, the lowest four bits (format, frame) left out.
enum DataId : unsigned {
  kTemperature = 0x0810,
  kUtcTime = 0x1010,
  kPacketCounter = 0x1020,
  kSampleTimeFine = 0x1060,
  kQuaternion = 0x2010,
  kRotationMatrix = 0x2020,
  kEuler = 0x2030,
  kPressure = 0x3010,
  kAltitude = 0x5020,
  kLatLon = 0x5040,
  kGnssPvt = 0x7010,
  kRateOfTurnHr = 0x8040,
  kVelocity = 0xD010,
  kDeltaVelocity = 0x4010,
  kAcceleration = 0x4020,
  kFreeAcceleration = 0x4030,
  kAccelerationHr = 0x4040,
  kRateOfTurn = 0x8020,
  kDeltaQuaternion = 0x8030,
  kMagneticField = 0xC020,
  kStatusByte = 0xE010,
  kStatusWord = 0xE020,
};
constexpr std::array kWithRate{kTemperature,    kQuaternion,    kRotationMatrix, kEuler,
                               kPressure,       kDeltaVelocity, kAcceleration,   kFreeAcceleration,
                               kAccelerationHr, kRateOfTurn,    kRateOfTurnHr,   kDeltaQuaternion,
                               kMagneticField};
constexpr std::array kOfGnss{kAltitude, kLatLon, kGnssPvt, kVelocity};
constexpr std::array kInEveryPacket{kUtcTime, kPacketCounter, kSampleTimeFine, kStatusByte, kStatusWord};
constexpr unsigned kEveryPacket = 0xFFFF;

/// One line of the output configuration. `rate_hz` FFFF: in every packet.
struct Output {
  unsigned id;
  unsigned rate_hz;

  unsigned kind() const { return id & 0xFFF0U; }
};

template <class List>
bool contains(const List& list, unsigned value) {
  return std::find(list.begin(), list.end(), value) != list.end();
}

unsigned byte(char c) {
  return static_cast<unsigned char>(c);
}
unsigned u16_at(std::string_view bytes, std::size_t at) {
  return byte(bytes[at]) << 8U | byte(bytes[at + 1]);
}
void put_u8(std::string& out, unsigned value) {
  out.push_back(static_cast<char>(value & 0xFFU));
}
void put_u16(std::string& out, unsigned value) {
  put_big_endian(out, static_cast<std::uint16_t>(value));
}

/// Sum of all bytes behind the preamble.
unsigned sum_of(std::string_view bytes) {
  unsigned sum = 0;
  for (const char c : bytes.substr(1)) sum += byte(c);
  return sum & 0xFFU;
}

std::string message(unsigned id, std::string_view data) {
  std::string bytes{kPreamble, kBus};
  put_u8(bytes, id);
  if (data.size() < kExtended) {
    put_u8(bytes, static_cast<unsigned>(data.size()));
  } else {
    put_u8(bytes, kExtended);
    put_u16(bytes, static_cast<unsigned>(data.size()));
  }
  bytes += data;
  put_u8(bytes, 0x100U - sum_of(bytes));
  return bytes;
}

/// value * 2^fraction_bits as a two's complement of `bits` bits, at its limits where it does not fit.
std::uint64_t fixed_point(double value, int bits, int fraction_bits) {
  const double scaled = std::round(std::ldexp(value, fraction_bits));
  const double limit = std::ldexp(1.0, bits - 1);
  // NaN has no fixed-point form: it shows as the lowest value [unverified against a device].
  const double held = scaled >= -limit ? std::min(scaled, limit - 1.0) : -limit;
  return static_cast<std::uint64_t>(static_cast<std::int64_t>(held));
}

/// Writes a value in the number format given by the lowest two bits of the id.
void put_real(std::string& out, unsigned id, double value) {
  switch (id & 3U) {
    case 0:
      put_big_endian_float(out, value);
      return;
    case 1:
      put_big_endian(out, static_cast<std::uint32_t>(fixed_point(value, 32, 20)));
      return;
    case 2: {  // The fraction goes first.
      const std::uint64_t fixed = fixed_point(value, 48, 32);
      put_big_endian(out, static_cast<std::uint32_t>(fixed));
      put_big_endian(out, static_cast<std::uint16_t>(fixed >> 32U));
      return;
    }
    default:
      put_big_endian(out, std::bit_cast<std::uint64_t>(value));
  }
}

bool known_message(unsigned id) {
  constexpr std::array kKnown{kReqDeviceId, kInitBus,           kReqConfiguration,  kReqFirmware,
                              kBaudrate,    kReqProductCode,    kReqHardware,       kSyncSettings,
                              kOptionFlags, kReqFilterProfiles, kFilterProfile,     kLocationId,
                              kRunSelfTest, kReqEmts,           kAlignmentRotation, kOutputConfiguration};
  return kept_message(id) != nullptr || std::find(kKnown.begin(), kKnown.end(), id) != kKnown.end();
}

std::string from_hex(std::string_view digits) {
  std::string bytes;
  for (std::size_t n = 0; n + 1 < digits.size(); n += 2) {
    unsigned value = 0;
    const auto [end, error] = std::from_chars(digits.data() + n, digits.data() + n + 2, value, 16);
    if (error != std::errc{} || end != digits.data() + n + 2) return {};
    put_u8(bytes, value);
  }
  return bytes;
}

}  // namespace

class XsensMtiFirmware::Device final : public Firmware {
 public:
  Device(std::shared_ptr<SimBench> bench, XsensMtiSettings settings, UnservedCommands& unserved);

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
  enum class State { kSwitchedOff, kWakingUp, kConfig, kMeasurement };

  // Messages.
  void find_messages();
  void run(unsigned id, std::string_view data);
  std::string run_in_config(unsigned id, std::string_view data);
  std::string output_configuration(std::string_view data);
  std::string baudrate(std::string_view data);
  std::string filter_profile(std::string_view data);
  std::string option_flags(std::string_view data);
  std::string location_id(std::string_view data);
  std::string sync_settings(std::string_view data);
  std::string configuration() const;
  std::string keep(const Kept& kept, std::string_view data);
  std::string alignment_rotation(std::string_view data);
  bool has_gnss() const {
    return settings_.product_code.starts_with("MTi-G") || settings_.product_code.starts_with("MTi-68");
  }
  std::string firmware_revision() const;
  std::string filter_profiles() const;

  // States.
  void switch_on(Clock::Instant t);
  void update(Clock::Instant now);
  void begin_measurement(Clock::Instant t);
  void end_measurement(Clock::Instant t);

  // Data.
  bool streams() const { return streams_until_ > grid_.time(next_tick_); }
  unsigned decimation(const Output& output) const {
    return output.rate_hz == kEveryPacket ? 1U : settings_.base_rate_hz / output.rate_hz;
  }
  void advance_tick();
  std::string packet(std::uint64_t tick);
  std::string item(const Output& output, const SimOutput& sample, Clock::Instant t) const;
  static std::string motion_item(const Output& output, const BodyMotion& body);
  std::string utc_time(Clock::Instant t) const;

  std::shared_ptr<SimBench> bench_;
  XsensMtiSettings settings_;
  UnservedCommands& unserved_;
  std::string device_id_;
  unsigned line_speed_;
  SampleGrid grid_;
  State state_ = State::kSwitchedOff;
  Clock::Instant switched_on_;
  Clock::Instant changes_state_;  ///< When it is switched off or waking up: when that ends.
  std::vector<Output> outputs_;
  unsigned profile_;  ///< Index of kFilterProfiles.
  std::uint32_t option_flags_ = 0;
  unsigned location_id_ = 0;
  std::string sync_settings_;
  std::map<unsigned, std::string> kept_;
  std::array<std::string, kAlignmentFrames> alignment_;  ///< Quaternions.
  Clock::Instant streams_until_ = Clock::Instant::min();
  std::uint64_t next_tick_ = 0;
  unsigned packet_counter_ = 0;
  std::string input_;
  ReplyQueue replies_;
  Clock::Instant now_;
};

XsensMtiFirmware::Device::Device(std::shared_ptr<SimBench> bench, XsensMtiSettings settings,
                                 UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      device_id_(from_hex(settings_.device_id)),
      line_speed_(settings_.baud),
      grid_(bench_->start(), std::max(1U, settings_.base_rate_hz)),
      switched_on_(bench_->start()),
      changes_state_(bench_->start()),
      outputs_{{kPacketCounter, kEveryPacket},
               {kSampleTimeFine, kEveryPacket},
               {kAcceleration, settings_.base_rate_hz},
               {kStatusWord, kEveryPacket}},
      profile_(0),
      now_(bench_->start()) {
  const auto refuse = [](std::string_view what, const auto& found, std::string_view required) {
    throw std::invalid_argument(
        fmt::format("simulated MTi: {} is \"{}\", required: {}", what, found, required));
  };
  const std::size_t digits = settings_.device_id.size();
  if ((digits != 8 && digits != 16) || device_id_.size() != digits / 2)
    refuse("device id", settings_.device_id, "8 or 16 hexadecimal digits");
  if (settings_.product_code.size() > kProductCode)
    refuse("product code", settings_.product_code, "at most 20 characters");
  if (settings_.base_rate_hz < 1 || settings_.base_rate_hz > 10000)
    refuse("base rate", settings_.base_rate_hz, "1 to 10000 Hz");
  if (std::none_of(kBaudCodes.begin(), kBaudCodes.end(),
                   [&](const BaudCode& known) { return known.baud == settings_.baud; }))
    refuse("baud rate", settings_.baud, "one of the maker's, 9600 to 921600");
  for (std::string& quaternion : alignment_)
    for (const double part : {1.0, 0.0, 0.0, 0.0}) put_big_endian_float(quaternion, part);
  if (settings_.just_switched_on) {
    switch_on(now_);
  } else {
    begin_measurement(now_);
  }
}

// Messages.

void XsensMtiFirmware::Device::receive(std::string_view bytes, Clock::Instant now) {
  // A message that does not end is given up [unverified against a device]: the next one must not be swallowed
  // by its length.
  if (now - now_ > kMessageTimeout) input_.clear();
  update(now);
  now_ = now;
  if (state_ == State::kSwitchedOff) return input_.clear();
  input_ += bytes;
  find_messages();
}

void XsensMtiFirmware::Device::find_messages() {
  std::size_t at = 0;
  while (at < input_.size()) {
    const std::string_view rest = std::string_view(input_).substr(at);
    if (rest[0] != kPreamble || (rest.size() > 1 && rest[1] != kBus)) {
      ++at;
      continue;
    }
    if (rest.size() < kHeader) break;
    const bool extended = byte(rest[3]) == kExtended;
    const std::size_t header = extended ? kExtendedHeader : kHeader;
    if (rest.size() < header) break;
    const std::size_t length = extended ? u16_at(rest, kHeader) : byte(rest[3]);
    const std::size_t size = header + length + 1;
    if (length > kLongestData) {
      ++at;
      continue;
    }
    if (rest.size() < size) break;
    if (sum_of(rest.substr(0, size)) != 0) {  // Ignored; a good message may begin behind the preamble.
      ++at;
      continue;
    }
    const std::string data(rest.substr(header, length));
    run(byte(rest[2]), data);
    at += size;
  }
  input_.erase(0, at);
}

void XsensMtiFirmware::Device::run(unsigned id, std::string_view data) {
  std::string answer;
  unsigned answer_id = id + 1;
  const Clock::Instant answered = now_ + settings_.reply_delay;
  try {
    switch (id) {
      case kWakeUpAck:
        if (state_ == State::kWakingUp) state_ = State::kConfig;
        return;
      case kGotoConfig:
        if (!data.empty()) throw Refusal{kInvalidParameter};
        end_measurement(answered);
        state_ = State::kConfig;
        break;
      case kReset:
        if (!data.empty()) throw Refusal{kInvalidParameter};
        end_measurement(answered);
        state_ = State::kSwitchedOff;
        changes_state_ = answered + settings_.reset_time;
        break;
      case kGotoMeasurement:
        if (!data.empty()) throw Refusal{kInvalidParameter};
        if (state_ != State::kMeasurement) begin_measurement(answered);
        break;
      case kSetNoRotation:  // For a number of seconds; hosts send it while it measures.
      case kResetOrientation:
        if (data.size() != 2) throw Refusal{kInvalidParameter};
        break;
      default:
        if (!known_message(id))
          unserved_.note(fmt::format("message {:02X}", id), "not emulated: error 04", message(id, data));
        // Not valid in the other states [M: answers with an error instead of ignoring it].
        if (state_ != State::kConfig) throw Refusal{kInvalidMessage};
        answer = run_in_config(id, data);
    }
  } catch (const Refusal& refusal) {
    answer_id = kError;
    answer.assign(1, static_cast<char>(refusal.code));
  }
  replies_.push(message(answer_id, answer), answered);
}

std::string XsensMtiFirmware::Device::run_in_config(unsigned id, std::string_view data) {
  if (const Kept* kept = kept_message(id)) return keep(*kept, data);
  switch (id) {
    case kAlignmentRotation:
      return alignment_rotation(data);
    case kReqEmts:
      if (data.size() > 2) throw Refusal{kInvalidParameter};
      return std::string(kEmtsSize, '\0');
    case kOutputConfiguration:
      return output_configuration(data);
    case kBaudrate:
      return baudrate(data);
    case kFilterProfile:
      return filter_profile(data);
    case kOptionFlags:
      return option_flags(data);
    case kLocationId:
      return location_id(data);
    case kSyncSettings:
      return sync_settings(data);
    case kReqDeviceId:
    case kInitBus:
    case kReqProductCode:
    case kReqHardware:
    case kReqFirmware:
    case kReqConfiguration:
    case kReqFilterProfiles:
    case kRunSelfTest:
      break;
    default:
      throw Refusal{kInvalidMessage};
  }
  // These can only be queried. The maker's library queries the configuration with the data of the request
  // before it, and takes a refusal for a device that cannot be used.
  if (!data.empty() && id != kReqConfiguration) throw Refusal{kInvalidParameter};
  std::string answer;
  switch (id) {
    case kReqProductCode:
      answer = settings_.product_code;
      answer.resize(kProductCode, ' ');
      return answer;
    case kReqHardware:
      put_u16(answer, settings_.hardware_version);
      return answer;
    case kReqFirmware:
      return firmware_revision();
    case kReqConfiguration:
      return configuration();
    case kReqFilterProfiles:
      return filter_profiles();
    case kRunSelfTest:
      put_u16(answer, 0x01FF);  // All nine sensors pass.
      return answer;
    default:
      return device_id_;
  }
}

/// No data: a query. Otherwise sets the configuration and replies with the one that results.
std::string XsensMtiFirmware::Device::output_configuration(std::string_view data) {
  if (data.size() % 4 != 0 || data.size() > 4 * kMostOutputs) throw Refusal{kInvalidParameter};
  std::vector<Output> wanted;
  for (std::size_t at = 0; at < data.size(); at += 4) {
    Output output{u16_at(data, at), u16_at(data, at + 2)};
    const bool in_every_packet = contains(kInEveryPacket, output.kind());
    const unsigned format_and_frame = output.id & 0xFU;
    const bool with_rate =
        contains(kWithRate, output.kind()) || (has_gnss() && contains(kOfGnss, output.kind()));
    const bool known = in_every_packet ? format_and_frame == 0 : with_rate && format_and_frame < 0xC;
    if (!known) throw Refusal{kInvalidParameter};
    if (in_every_packet) {
      output.rate_hz = kEveryPacket;
    } else if (output.rate_hz == 0 || output.rate_hz >= settings_.base_rate_hz) {
      output.rate_hz = settings_.base_rate_hz;  // FFFF: as fast as it can.
    } else {
      // The next lower rate that is a whole fraction [M: which one].
      while (settings_.base_rate_hz % output.rate_hz != 0) --output.rate_hz;
    }
    wanted.push_back(output);
  }
  if (!wanted.empty()) outputs_ = std::move(wanted);
  std::string answer;
  for (const Output& output : outputs_) {
    put_u16(answer, output.id);
    put_u16(answer, output.rate_hz);
  }
  return answer;
}

std::string XsensMtiFirmware::Device::baudrate(std::string_view data) {
  if (data.size() > 1) throw Refusal{kInvalidParameter};
  const auto known = std::find_if(kBaudCodes.begin(), kBaudCodes.end(), [&](const BaudCode& each) {
    return data.empty() ? each.baud == settings_.baud : each.code == byte(data[0]);
  });
  if (known == kBaudCodes.end()) throw Refusal{kInvalidBaudrate};
  if (!data.empty()) {
    // Takes effect at the next reset [unverified against a device].
    settings_.baud = known->baud;
    return {};
  }
  return std::string(1, static_cast<char>(known->code));
}

std::string XsensMtiFirmware::Device::filter_profile(std::string_view data) {
  std::string answer;
  if (data.empty()) {
    put_u8(answer, kFilterProfiles[profile_].version);
    put_u8(answer, kFilterProfiles[profile_].type);
    return answer;
  }
  if (data.size() != 2) throw Refusal{kInvalidParameter};
  const auto found = std::find_if(kFilterProfiles.begin(), kFilterProfiles.end(),
                                  [&](const FilterProfile& p) { return p.type == u16_at(data, 0); });
  if (found == kFilterProfiles.end()) throw Refusal{kInvalidParameter};
  profile_ = static_cast<unsigned>(found - kFilterProfiles.begin());
  return answer;
}

std::string XsensMtiFirmware::Device::keep(const Kept& kept, std::string_view data) {
  if (data.empty()) {
    const auto found = kept_.find(kept.id);
    if (found != kept_.end()) return found->second;
    std::string initial = from_hex(kept.initial);
    initial.resize(kept.size, '\0');
    return initial;
  }
  if (data.size() != kept.size) throw Refusal{kInvalidParameter};
  kept_[kept.id] = data;
  return {};
}

/// Rotation of the sensor or of the world, by the first byte; that byte alone is a query.
std::string XsensMtiFirmware::Device::alignment_rotation(std::string_view data) {
  if (data.empty() || byte(data[0]) >= kAlignmentFrames) throw Refusal{kInvalidParameter};
  std::string& quaternion = alignment_[byte(data[0])];
  if (data.size() == 1) return std::string(data) + quaternion;
  if (data.size() != 1 + kQuaternionSize) throw Refusal{kInvalidParameter};
  quaternion = data.substr(1);
  return {};
}

/// Flags to set, then flags to clear [unverified against a device].
std::string XsensMtiFirmware::Device::option_flags(std::string_view data) {
  std::string answer;
  if (data.empty()) {
    put_big_endian(answer, option_flags_);
    return answer;
  }
  if (data.size() != 8) throw Refusal{kInvalidParameter};
  const auto u32_at = [&](std::size_t at) { return u16_at(data, at) << 16U | u16_at(data, at + 2); };
  option_flags_ = (option_flags_ | u32_at(0)) & ~u32_at(4);
  return answer;
}

std::string XsensMtiFirmware::Device::location_id(std::string_view data) {
  std::string answer;
  if (data.empty()) {
    put_u16(answer, location_id_);
    return answer;
  }
  if (data.size() != 2) throw Refusal{kInvalidParameter};
  location_id_ = u16_at(data, 0);
  return answer;
}

/// Entries of 12 bytes; they are stored without effect.
std::string XsensMtiFirmware::Device::sync_settings(std::string_view data) {
  if (data.empty()) return sync_settings_;
  if (data.size() % 12 != 0) throw Refusal{kInvalidParameter};
  sync_settings_ = data;
  return {};
}

std::string XsensMtiFirmware::Device::firmware_revision() const {
  std::string answer;
  for (const unsigned part : settings_.firmware_version) put_u8(answer, part);
  put_big_endian(answer, std::uint32_t{settings_.firmware_build});
  put_big_endian(answer, std::uint32_t{0});  // Number in the maker's archive.
  return answer;
}

std::string XsensMtiFirmware::Device::configuration() const {
  const std::string id = device_id_.substr(device_id_.size() - 4);
  const bool long_id = device_id_.size() > 4;
  std::string block = id;
  if (long_id) {
    block += device_id_.substr(0, 4);
  } else {
    put_u16(block, 1152);  // Period, in units of 1 / 115200 s: 100 Hz.
    put_u16(block, 0);
  }
  block.append(8, '\0');
  block += "20000101";
  block += "00000000";
  std::string code = long_id ? settings_.product_code : std::string();
  code.resize(64, '\0');
  block += code;
  put_u16(block, 1);  // Devices.
  block += id;
  block.append(8, '\0');
  put_u16(block, kFilterProfiles[profile_].type);
  for (const unsigned part : settings_.firmware_version) put_u8(block, part);
  block += 'U';  // The profile is the user's choice [unverified against a device].
  put_u8(block, kFilterProfiles[profile_].version);
  put_u8(block, 0);
  return block;
}

std::string XsensMtiFirmware::Device::filter_profiles() const {
  constexpr std::size_t kName = 20;
  std::string list;
  for (const FilterProfile& profile : kFilterProfiles) {
    put_u8(list, profile.type);
    put_u8(list, profile.version);
    std::string name(profile.name);
    name.resize(kName, ' ');
    list += name;
  }
  return list;
}

// States.

void XsensMtiFirmware::Device::switch_on(Clock::Instant t) {
  state_ = State::kWakingUp;
  line_speed_ = settings_.baud;
  switched_on_ = t;
  changes_state_ = t + kWakeUpWait;
  replies_.push(message(kWakeUp, {}), t);
}

/// Its output configuration is kept without power.
void XsensMtiFirmware::Device::power(bool on, Clock::Instant now) {
  now_ = now;
  end_measurement(now);
  session_starts();
  state_ = State::kSwitchedOff;
  changes_state_ = Clock::Instant::max();
  if (on) switch_on(now);
}

/// Applies the changes of state that are due by `now`.
void XsensMtiFirmware::Device::update(Clock::Instant now) {
  if (state_ == State::kSwitchedOff && changes_state_ <= now) switch_on(changes_state_);
  if (state_ == State::kWakingUp && changes_state_ <= now) begin_measurement(changes_state_);
}

void XsensMtiFirmware::Device::begin_measurement(Clock::Instant t) {
  state_ = State::kMeasurement;
  packet_counter_ = 0;
  streams_until_ = Clock::Instant::max();
  const std::uint64_t first = grid_.first_after(t);
  next_tick_ = first > 0 ? first - 1 : 0;
  advance_tick();
}

/// Samples taken before the answer are still output.
void XsensMtiFirmware::Device::end_measurement(Clock::Instant t) {
  streams_until_ = std::min(streams_until_, t);
}

// Data.

/// To the next tick at which something is due that has a rate; if nothing has, to the next one.
void XsensMtiFirmware::Device::advance_tick() {
  std::uint64_t next = std::numeric_limits<std::uint64_t>::max();
  for (const Output& output : outputs_) {
    if (output.rate_hz == kEveryPacket) continue;
    next = std::min(next, (next_tick_ / decimation(output) + 1) * decimation(output));
  }
  next_tick_ = next == std::numeric_limits<std::uint64_t>::max() ? next_tick_ + 1 : next;
}

std::string XsensMtiFirmware::Device::packet(std::uint64_t tick) {
  const Clock::Instant t = grid_.time(tick);
  const SimOutput sample = bench_->output(t, tick, grid_.period());
  std::string data;
  for (const Output& output : outputs_) {
    if (tick % decimation(output) != 0) continue;
    const std::string value = item(output, sample, t);
    put_u16(data, output.id);
    put_u8(data, static_cast<unsigned>(value.size()));
    data += value;
  }
  packet_counter_ = (packet_counter_ + 1) & 0xFFFFU;
  return message(kMtData2, data);
}

std::string XsensMtiFirmware::Device::item(const Output& output, const SimOutput& sample,
                                           Clock::Instant t) const {
  std::string data;
  const auto put_reals = [&](std::initializer_list<double> values) {
    for (const double value : values) put_real(data, output.id, value);
  };
  const Eigen::Vector3d& a = sample.value;
  switch (output.kind()) {
    case kTemperature:
      put_reals({sample.temperature_degc});
      break;
    case kUtcTime:
      return utc_time(t);
    case kPacketCounter:
      put_u16(data, packet_counter_);
      break;
    case kSampleTimeFine:  // 0.1 ms
      put_big_endian(data, static_cast<std::uint32_t>((t - switched_on_) / std::chrono::microseconds(100)));
      break;
    case kAcceleration:
    case kAccelerationHr:
      put_reals({a[0], a[1], a[2]});
      break;
    case kDeltaVelocity: {
      const double period_s = 1.0 / output.rate_hz;
      put_reals({a[0] * period_s, a[1] * period_s, a[2] * period_s});
      break;
    }
    case kPressure:
      put_big_endian(data, static_cast<std::uint32_t>(kPressurePa));
      break;
    case kAltitude:
      put_reals({0.0});
      break;
    case kLatLon:
      put_reals({0.0, 0.0});
      break;
    case kGnssPvt:
      return std::string(kGnssPvtSize, '\0');  // No fix.
    case kQuaternion:
    case kRotationMatrix:
    case kEuler:
    case kDeltaQuaternion:
    case kRateOfTurn:
    case kRateOfTurnHr:
    case kMagneticField:
      return motion_item(output, bench_->body_motion(t));
    case kStatusByte:
      put_u8(data, 0x03);  // Self-test passed, filter valid.
      break;
    case kStatusWord: {
      std::uint32_t word = 0x03;
      for (unsigned j = 0; j < 3; ++j)
        if (sample.clipped[j]) word |= 0x100U << j | 0x8'0000U;
      put_big_endian(data, word);
      break;
    }
    default:  // Velocity; free acceleration: the axes of the stage meet in the accelerometer.
      put_reals({0.0, 0.0, 0.0});
  }
  return data;
}

/// Data of its other sensors and its filter.
std::string XsensMtiFirmware::Device::motion_item(const Output& output, const BodyMotion& body) {
  std::string data;
  const auto put_vector = [&](const Eigen::Vector3d& v) {
    for (const double value : v) put_real(data, output.id, value);
  };
  const auto put_quaternion = [&](const Eigen::Quaterniond& q) {
    for (const double value : {q.w(), q.x(), q.y(), q.z()}) put_real(data, output.id, value);
  };
  const unsigned frame = output.id & 0xCU;
  const Eigen::Matrix3d R_FB = frame == 0x4 ? body.to_ned() : frame == 0x8 ? body.to_nwu() : body.to_enu();
  switch (output.kind()) {
    case kQuaternion:
      put_quaternion(quaternion_of(R_FB));
      break;
    case kRotationMatrix:  // Column by column [unverified against a device].
      for (Eigen::Index column = 0; column < 3; ++column) put_vector(R_FB.col(column));
      break;
    case kEuler:  // Roll, pitch, yaw in degrees.
      put_vector(roll_pitch_yaw_of(R_FB) * (180.0 / std::numbers::pi));
      break;
    case kDeltaQuaternion: {  // Over the period of this output.
      const double angle = body.rate_B_radps.norm() / output.rate_hz;
      const Eigen::Vector3d axis = angle > 0.0 ? body.rate_B_radps.normalized() : Eigen::Vector3d::UnitX();
      put_quaternion(Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis)));
      break;
    }
    case kMagneticField:  // Scaled to norm 1.
      put_vector(body.field_B_gauss.normalized());
      break;
    default:
      put_vector(body.rate_B_radps);
  }
  return data;
}

/// It has no receiver of its own: counted from 1 January 2000, flags 0 (not valid).
std::string XsensMtiFirmware::Device::utc_time(Clock::Instant t) const {
  using namespace std::chrono;
  const auto since = sys_days{January / 1 / 2000} + (t - bench_->start());
  const auto day = floor<days>(since);
  const year_month_day date(day);
  const hh_mm_ss time(since - day);
  std::string data;
  put_big_endian(data, static_cast<std::uint32_t>(duration_cast<nanoseconds>(time.subseconds()).count()));
  put_u16(data, static_cast<unsigned>(static_cast<int>(date.year())));
  put_u8(data, static_cast<unsigned>(date.month()));
  put_u8(data, static_cast<unsigned>(date.day()));
  put_u8(data, static_cast<unsigned>(time.hours().count()));
  put_u8(data, static_cast<unsigned>(time.minutes().count()));
  put_u8(data, static_cast<unsigned>(time.seconds().count()));
  put_u8(data, 0);
  return data;
}

std::string XsensMtiFirmware::Device::transmit(Clock::Instant now) {
  update(now);
  std::string out;
  while (streams() && grid_.time(next_tick_) <= now) {
    const Clock::Instant t = grid_.time(next_tick_);
    out += replies_.take(t);
    if (!bench_->fault_at(FaultKind::kNoOutput, t)) out += packet(next_tick_);
    advance_tick();
  }
  return out + replies_.take(now);
}

std::optional<Clock::Instant> XsensMtiFirmware::Device::next_due() const {
  std::optional<Clock::Instant> due = replies_.next_due();
  const auto consider = [&](Clock::Instant t) { due = due ? std::min(*due, t) : t; };
  if (streams()) consider(grid_.time(next_tick_));
  if (state_ == State::kSwitchedOff || state_ == State::kWakingUp) consider(changes_state_);
  return due;
}

XsensMtiFirmware::XsensMtiFirmware(std::shared_ptr<SimBench> bench, XsensMtiSettings settings) {
  encase(std::make_unique<Device>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
