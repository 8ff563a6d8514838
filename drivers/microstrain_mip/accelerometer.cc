#include "drivers/microstrain_mip/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::seconds;

// The timeout rule of MicroStrain's mip_sdk: one packet of the largest size at the baud rate, times 1.5, and
// 2 s for the device to answer.
constexpr double kPacketTimeFactor = 1.5;
constexpr seconds kAnswerTime{2};
constexpr double kDefaultBytesPerSecond =
    11520.0;  // 115200 baud, the setting a device leaves the factory with.

const std::string kBias = "accelerometer bias (0C,37)";
constexpr double kBiasStep = 1.2e-7;  // g, of a float near 1

std::string bias_text(const Eigen::Vector3d& bias_g) {
  return fmt::format("{:.9g}, {:.9g}, {:.9g} g", bias_g.x(), bias_g.y(), bias_g.z());
}

constexpr seconds kTemperatureHold{10};
constexpr double kRateTolerance = 0.01;

constexpr std::uint8_t kPing = 0x01;
constexpr std::uint8_t kSetIdle = 0x02;
constexpr std::uint8_t kDeviceInfo = 0x03;
constexpr std::uint8_t kDescriptors = 0x04;
constexpr std::uint8_t kResume = 0x06;
constexpr std::uint8_t kExtendedDescriptors = 0x07;
constexpr std::uint8_t kLegacyBaseRate = 0x06;
constexpr std::uint8_t kLegacyFormat = 0x08;
constexpr std::uint8_t kBaseRate = 0x0E;
constexpr std::uint8_t kFormat = 0x0F;
constexpr std::uint8_t kStreamControl = 0x11;
constexpr std::uint8_t kAccelerometerBias = 0x37;
constexpr std::uint8_t kWriteFunction = 0x01;
constexpr std::uint8_t kReadFunction = 0x02;
constexpr std::uint8_t kSaveFunction = 0x03;
constexpr std::uint8_t kSharedSet = 0xFF;  // How newer devices list the fields that all data sets share.

/// "5g, 300d/s" -> 5. [unverified against a device]: seen as the options text of several models, not promised
/// by a manual.
std::optional<double> full_scale_in(std::string_view options) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(options.data(), options.data() + options.size(), value);
  if (error != std::errc{} || !(value > 0.0)) return std::nullopt;
  std::string_view rest = options.substr(static_cast<std::size_t>(end - options.data()));
  while (rest.starts_with(' ')) rest.remove_prefix(1);
  if (!rest.starts_with('g') && !rest.starts_with('G')) return std::nullopt;
  rest.remove_prefix(1);
  if (!rest.empty() && rest.front() != ',' && rest.front() != ' ' && rest.front() != '/') return std::nullopt;
  return value;
}

/// The decimation whose rate is nearest to the wanted one.
std::uint16_t nearest_decimation(double base_rate_hz, double wanted_hz) {
  const double lower = std::clamp(std::floor(base_rate_hz / wanted_hz), 1.0, 65535.0);
  const double upper = std::min(lower + 1.0, 65535.0);
  const bool take_lower =
      std::abs(base_rate_hz / lower - wanted_hz) <= std::abs(base_rate_hz / upper - wanted_hz);
  return static_cast<std::uint16_t>(take_lower ? lower : upper);
}

std::size_t data_bytes(std::uint8_t field) {
  switch (field) {
    case mip::kReferenceTime:
      return 8;
    case mip::kOverRange:
      return 2;
    default:
      return 12;  // 04, 12, 14
  }
}

using Exchange = wire::PacketExchange<mip::PacketParser>;

/// The acknowledgement names the command by its descriptor; after it follows the reply field, if it has one.
struct Request {
  std::uint8_t set = 0;
  std::uint8_t descriptor = 0;
  std::string data;
  std::string_view name;  ///< For messages: "device info".
  std::optional<std::uint8_t> reply_field;

  std::string shown() const { return fmt::format("\"{}\" ({:02X},{:02X})", name, set, descriptor); }
};

/// An answer without the reply field that it must have.
constexpr unsigned kWithoutReplyField = 0x100;

std::optional<wire::PacketAnswer> match_answer(const mip::Packet& packet, const Request& request) {
  if (packet.descriptor_set != request.set) return std::nullopt;
  const auto fields = mip::split_fields(packet.payload);
  if (!fields) return std::nullopt;
  bool acknowledged = false;
  std::optional<std::string> reply;
  for (const mip::Field& field : *fields) {
    if (field.descriptor == mip::kAckField) {
      const auto ack = mip::decode_acknowledgement(field.data);
      if (!ack || ack->command != request.descriptor) continue;
      acknowledged = true;
      if (ack->code != 0) return wire::PacketAnswer{{}, ack->code};
    } else if (acknowledged && request.reply_field == field.descriptor) {
      reply = std::string(field.data);
    }
  }
  if (!acknowledged) return std::nullopt;
  if (!request.reply_field) return wire::PacketAnswer{};
  if (!reply) return wire::PacketAnswer{{}, kWithoutReplyField};
  return wire::PacketAnswer{*std::move(reply), std::nullopt};
}

Exchange::Command command_of(const Request& request) {
  return {mip::make_packet(request.set, {mip::make_field(request.descriptor, request.data)}), request.shown(),
          [request](const mip::Packet& packet) { return match_answer(packet, request); }};
}

Exchange::Manner manner(const AccelerometerSettings& settings) {
  const double bytes_per_s = settings.link_bytes_per_s.value_or(kDefaultBytesPerSecond);
  return {.packet = "MIP packet",
          .damaged = "with a wrong checksum",
          .show = wire::bytes_in_hex,
          .answer_time = kAnswerTime +
                         from_seconds(kPacketTimeFactor * static_cast<double>(mip::kMaxPacket) / bytes_per_s),
          .barrier = command_of({mip::kBaseSet, kPing, {}, "ping", {}})};
}

/// Sends a command and returns the data of its reply field (empty if it has none).
/// @throws InstrumentError kRefused, kBadFrame.
std::string ask(Exchange& device, const Request& request) {
  wire::PacketAnswer answer = device.ask(command_of(request));
  if (!answer.error) return std::move(answer.data);
  if (*answer.error == kWithoutReplyField) {
    device.fail(Fault::kBadFrame, fmt::format("\"{}\" was acknowledged without the reply field {:02X}",
                                              request.name, *request.reply_field));
  }
  device.fail(Fault::kRefused,
              fmt::format("code {} ({}) to {}", *answer.error,
                          mip::ack_code_in_words(static_cast<std::uint8_t>(*answer.error)), request.shown()));
}

}  // namespace

MipAccelerometer::MipAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                   const AccelerometerSettings& settings)
    : PacketAccelerometer("microstrain_mip", std::move(stream), clock, settings, manner(settings)) {}

void MipAccelerometer::start() {
  interrogate();
  const std::vector<mip::FormatEntry> format = wanted_format();
  check_rate_and_link(format);
  if (abilities_.modern) {
    ask(exchange_,
        {mip::k3dmSet, kFormat, mip::message_format(mip::kSensorSet, format), "message format", {}});
  } else {
    ask(exchange_,
        {mip::k3dmSet, kLegacyFormat, mip::legacy_message_format(format), "message format (legacy)", {}});
  }
  if (abilities_.stream_control) select_streams();

  // All answers have arrived, so remaining bytes are not part of the stream that begins now.
  readings_.listen(mip::PacketParser());
  last_reference_time_ns_.reset();
  last_gps_timestamp_.reset();
  temperature_degc_.reset();
  ask(exchange_, {mip::kBaseSet, kResume, {}, "resume", {}});
  readings_.start();
}

// Commands.

std::map<std::string, std::string> MipAccelerometer::correction_registers() {
  if (!abilities_.accelerometer_bias) return {};
  const std::string data = ask(exchange_, {mip::k3dmSet, kAccelerometerBias, mip::u8(kReadFunction),
                                           "accelerometer bias", std::uint8_t{0x9A}});
  const auto bias = mip::decode_scaled_accelerometer(data);
  if (!bias) fail(Fault::kBadFrame, "the answer to \"accelerometer bias\" does not have 12 bytes");
  return {{kBias, bias_text(*bias)}};
}

CorrectionAbility MipAccelerometer::ability() {
  if (!abilities_.accelerometer_bias)
    fail(Fault::kRefused,
         "it has no accelerometer bias (0C,37), and no other correction that can be written");
  return {.shape = CorrectionShape::kOffset,
          .rule = "output = a - bias, command 0C,37: three floats in g",
          .offset_step = kBiasStep};
}

OutputCorrection MipAccelerometer::decode(const RegisterTexts& registers) {
  const std::vector<double> bias = register_numbers(registers, kBias, 3);
  return {Eigen::Matrix3d::Identity(), Eigen::Map<const Eigen::Vector3d>(bias.data())};
}

RegisterTexts MipAccelerometer::encode(const OutputCorrection& wanted, const RegisterTexts& now) {
  if (!wanted.offset.allFinite()) throw std::invalid_argument("accelerometer bias: no number");
  RegisterTexts registers = now;
  registers[kBias] = bias_text(wanted.offset.cast<float>().cast<double>());
  return registers;
}

void MipAccelerometer::write(const RegisterTexts& registers) {
  std::string data = mip::u8(kWriteFunction);
  for (const double value : register_numbers(registers, kBias, 3))
    data += mip::u32(std::bit_cast<std::uint32_t>(static_cast<float>(value)));
  ask(exchange_, {mip::k3dmSet, kAccelerometerBias, data, "accelerometer bias", {}});
}

void MipAccelerometer::save(const RegisterTexts&) {
  ask(exchange_, {mip::k3dmSet, kAccelerometerBias, mip::u8(kSaveFunction), "accelerometer bias", {}});
}

void MipAccelerometer::make_quiet() {
  exchange_.restart(mip::PacketParser());
  ask(exchange_, {mip::kBaseSet, kSetIdle, {}, "set idle", {}});
}

AccelerometerInfo MipAccelerometer::interrogate() {
  make_quiet();

  const auto info = mip::decode_device_info(
      ask(exchange_, {mip::kBaseSet, kDeviceInfo, {}, "device info", std::uint8_t{0x81}}));
  if (!info) fail(Fault::kBadFrame, "the answer to \"device info\" does not have 82 bytes");
  name_it(info->model_name, info->serial_number);

  auto offered = mip::decode_descriptors(
      ask(exchange_, {mip::kBaseSet, kDescriptors, {}, "descriptors", std::uint8_t{0x82}}));
  if (!offered) fail(Fault::kBadFrame, "the answer to \"descriptors\" has an odd number of bytes");
  const auto offers = [&](std::uint8_t set, std::uint8_t field) {
    return std::find(offered->begin(), offered->end(), static_cast<std::uint16_t>(set << 8U | field)) !=
           offered->end();
  };
  if (offers(mip::kBaseSet, kExtendedDescriptors)) {  // A packet holds 125: newer devices have more to offer.
    const auto more = mip::decode_descriptors(ask(
        exchange_, {mip::kBaseSet, kExtendedDescriptors, {}, "extended descriptors", std::uint8_t{0x86}}));
    if (!more) fail(Fault::kBadFrame, "the answer to \"extended descriptors\" has an odd number of bytes");
    offered->insert(offered->end(), more->begin(), more->end());
  }
  if (!offers(mip::kSensorSet, mip::kScaledAccelerometer)) {
    fail(Fault::kWrongIdentity, "this MIP device offers no scaled accelerometer (80,04)");
  }

  Abilities abilities;
  abilities.modern = offers(mip::k3dmSet, kBaseRate) && offers(mip::k3dmSet, kFormat);
  if (!abilities.modern && !(offers(mip::k3dmSet, kLegacyBaseRate) && offers(mip::k3dmSet, kLegacyFormat))) {
    fail(Fault::kWrongIdentity,
         "this MIP device offers neither 0C,0E with 0C,0F nor 0C,06 with 0C,08 to set its output");
  }
  abilities.stream_control = offers(mip::k3dmSet, kStreamControl);
  abilities.reference_time =
      offers(mip::kSensorSet, mip::kReferenceTime) || offers(kSharedSet, mip::kReferenceTime);
  abilities.gps_timestamp = offers(mip::kSensorSet, mip::kGpsTimestamp);
  abilities.temperature = offers(mip::kSensorSet, mip::kTemperature);
  abilities.over_range = offers(mip::kSensorSet, mip::kOverRange);
  abilities.accelerometer_bias = offers(mip::k3dmSet, kAccelerometerBias);
  for (const std::uint16_t descriptor : *offered) {
    const auto set = static_cast<std::uint8_t>(descriptor >> 8U);
    auto& others = abilities.other_data_sets;
    const bool known = std::find(others.begin(), others.end(), set) != others.end();
    if (set > mip::kSensorSet && set < kSharedSet && !known) others.push_back(set);
  }

  std::optional<std::uint16_t> base_rate_hz;
  if (abilities.modern) {
    const std::string reply =
        ask(exchange_, {mip::k3dmSet, kBaseRate, mip::u8(mip::kSensorSet), "base rate", std::uint8_t{0x8E}});
    if (reply.starts_with(mip::u8(mip::kSensorSet)))
      base_rate_hz = mip::decode_u16(std::string_view(reply).substr(1));
  } else {
    base_rate_hz = mip::decode_u16(
        ask(exchange_, {mip::k3dmSet, kLegacyBaseRate, {}, "base rate (legacy)", std::uint8_t{0x83}}));
  }
  if (base_rate_hz.value_or(0) == 0) fail(Fault::kBadFrame, "the answer to \"base rate\" contains no rate");
  abilities.base_rate_hz = *base_rate_hz;
  abilities.decimation = nearest_decimation(abilities.base_rate_hz, settings_.rate_hz);
  abilities_ = abilities;

  return AccelerometerInfo{
      .maker = "MicroStrain",
      .model = info->model_name,
      .serial_number = info->serial_number,
      .firmware = fmt::format("{}", info->firmware),
      .output_unit = "g",
      // The bench file takes precedence, because the options are free text.
      .full_scale = settings_.full_scale ? settings_.full_scale : full_scale_in(info->options),
      .resolution = std::nullopt,
      .rate_hz = rate_hz(),
  };
}

double MipAccelerometer::rate_hz() const {
  return static_cast<double>(abilities_.base_rate_hz) / static_cast<double>(abilities_.decimation);
}

std::vector<mip::FormatEntry> MipAccelerometer::wanted_format() const {
  const std::uint16_t decimation = abilities_.decimation;
  std::vector<mip::FormatEntry> format;
  if (abilities_.reference_time) {
    format.push_back({mip::kReferenceTime, decimation});
  } else if (abilities_.gps_timestamp) {
    format.push_back({mip::kGpsTimestamp, decimation});
  }
  format.push_back({mip::kScaledAccelerometer, decimation});
  if (abilities_.over_range) format.push_back({mip::kOverRange, decimation});
  if (abilities_.temperature) {
    // A multiple of the others' decimation, so that it travels in their packets.
    const double multiple = std::clamp(std::round(rate_hz()), 1.0, std::floor(65535.0 / decimation));
    format.push_back({mip::kTemperature, static_cast<std::uint16_t>(multiple * decimation)});
  }
  return format;
}

void MipAccelerometer::check_rate_and_link(const std::vector<mip::FormatEntry>& format) const {
  const double rate = rate_hz();
  if (!(std::abs(rate - settings_.rate_hz) <= kRateTolerance * settings_.rate_hz)) {
    fail(
        Fault::kRefused,
        fmt::format(
            "rate_hz is {}; it makes {} readings per second divided by a whole number, the nearest is {:.6g}",
            settings_.rate_hz, abilities_.base_rate_hz, rate));
  }
  double needed = rate * static_cast<double>(mip::kPacketOverhead);
  for (const mip::FormatEntry& entry : format) {
    const double entry_rate =
        static_cast<double>(abilities_.base_rate_hz) / static_cast<double>(entry.decimation);
    needed += entry_rate * static_cast<double>(data_bytes(entry.descriptor) + 2);
  }
  check_link(rate, needed, settings_.link_bytes_per_s,
             rate * settings_.link_bytes_per_s.value_or(0.0) / needed);
}

void MipAccelerometer::select_streams() {
  const auto selector = [&](std::uint8_t set) -> std::optional<std::uint8_t> {
    if (abilities_.modern) return set;
    // Older devices number their streams: 1 inertial, 2 GNSS, 3 filter.
    if (set < 0x80 || set > 0x82) return std::nullopt;
    return static_cast<std::uint8_t>(set - 0x80 + 1);
  };
  for (const std::uint8_t set : abilities_.other_data_sets) {
    const auto stream = selector(set);
    if (!stream) continue;
    try {
      ask(exchange_,
          {mip::k3dmSet, kStreamControl, mip::u8(1) + mip::u8(*stream) + mip::u8(0), "stream off", {}});
    } catch (const InstrumentError& error) {
      // Not every set that is listed can be streamed. One that continues uses bandwidth, but costs no
      // reading.
      if (error.fault() != Fault::kRefused) throw;
    }
  }
  ask(exchange_, {mip::k3dmSet,
                  kStreamControl,
                  mip::u8(1) + mip::u8(*selector(mip::kSensorSet)) + mip::u8(1),
                  "stream on",
                  {}});
}

// Data.

wire::DecodedFrame MipAccelerometer::decode(const mip::Packet& packet) {
  if (packet.descriptor_set != mip::kSensorSet) return {};

  Reading reading;
  bool has_output = false;
  std::optional<std::uint64_t> reference_time_ns;
  std::optional<mip::GpsTimestamp> gps_timestamp;
  bool sound = true;
  const auto fields = mip::split_fields(packet.payload);
  if (!fields) return {.malformed = true};
  for (const mip::Field& field : *fields) {
    switch (field.descriptor) {
      case mip::kScaledAccelerometer:
        if (const auto output = mip::decode_scaled_accelerometer(field.data)) {
          reading.output = *output;
          has_output = true;
        } else {
          sound = false;
        }
        break;
      case mip::kReferenceTime:
        reference_time_ns = mip::decode_reference_time(field.data);
        sound = sound && reference_time_ns;
        break;
      case mip::kGpsTimestamp:
        gps_timestamp = mip::decode_gps_timestamp(field.data);
        sound = sound && gps_timestamp;
        break;
      case mip::kOverRange: {
        const auto status = mip::decode_over_range(field.data);
        sound = sound && status;
        reading.over_range = status && mip::accelerometer_over_range(*status);
        break;
      }
      case mip::kTemperature: {
        const auto temperature = mip::decode_temperature(field.data);
        sound = sound && temperature;
        if (!temperature) break;
        temperature_degc_ = temperature->mean_degc;
        temperature_arrival_ = readings_.last_arrival();
        break;
      }
      default:
        break;
    }
  }
  if (!sound) return {.malformed = true};
  if (!has_output) return {};
  if (readings_.last_arrival() - temperature_arrival_ <= kTemperatureHold)
    reading.temperature_degc = temperature_degc_;
  return {.reading = std::move(reading), .steps = steps_since_last_reading(reference_time_ns, gps_timestamp)};
}

/// How many readings the device has made since the last one received, by its clock: 1 if none was lost.
std::optional<std::uint64_t> MipAccelerometer::steps_since_last_reading(
    std::optional<std::uint64_t> reference_time_ns, const std::optional<mip::GpsTimestamp>& gps_timestamp) {
  constexpr double kSecondsPerWeek = 604800.0;
  constexpr std::uint16_t kTimeRefresh = 0x0002;  // Toggles when the time is set: it may step.

  const auto last_reference_time_ns = std::exchange(last_reference_time_ns_, reference_time_ns);
  const auto last_gps_timestamp = std::exchange(last_gps_timestamp_, gps_timestamp);

  const auto periods_in = [&](double duration_s) {
    return static_cast<std::uint64_t>(std::max(1.0, std::round(duration_s * rate_hz())));
  };
  if (reference_time_ns && last_reference_time_ns) {
    if (*reference_time_ns < *last_reference_time_ns) {
      end_and_fail(
          Fault::kNotReady,
          fmt::format(
              "its reference time went back from {} ns to {} ns: it was restarted and has lost its settings",
              *last_reference_time_ns, *reference_time_ns));
    }
    return periods_in(1e-9 * static_cast<double>(*reference_time_ns - *last_reference_time_ns));
  }
  if (gps_timestamp && last_gps_timestamp &&
      ((gps_timestamp->flags ^ last_gps_timestamp->flags) & kTimeRefresh) == 0) {
    const double elapsed_s = kSecondsPerWeek * (gps_timestamp->week - last_gps_timestamp->week) +
                             (gps_timestamp->time_of_week_s - last_gps_timestamp->time_of_week_s);
    constexpr double kLongest = 1e6;  // Beyond it the clock was set, or is not finite.
    if (elapsed_s > 0.0 && elapsed_s < kLongest) return periods_in(elapsed_s);
  }
  return std::nullopt;
}

}  // namespace abcal
