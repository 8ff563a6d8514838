#include "drivers/microstrain_mip/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

// The timeout rule of MicroStrain's mip_sdk: one packet of the largest size at the baud rate, times 1.5, and
// 2 s for the device to answer.
constexpr double kPacketTimeFactor = 1.5;
constexpr seconds kAnswerTime{2};
constexpr double kDefaultBytesPerSecond =
    11520.0;  // 115200 baud, the setting a device leaves the factory with.

// After this long without a byte, an answer behind a false sync is looked for.
constexpr milliseconds kSilence{50};

// Readings kept for a caller that does not fetch them: 8 s at 1 kHz.
constexpr std::size_t kQueueCapacity = 8192;

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
constexpr std::uint8_t kSharedSet = 0xFF;  // How newer devices list the fields that all data sets share.

std::string in_hex(std::string_view bytes) {
  std::string text;
  for (const char byte : bytes) {
    text += fmt::format("{}{:02X}", text.empty() ? "" : " ", static_cast<unsigned char>(byte));
  }
  return text;
}

/// "5g, 300d/s" -> 5. [M]: seen as the options text of several models, not promised by a manual.
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

}  // namespace

MipAccelerometer::MipAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                   const AccelerometerSettings& settings)
    : stream_(std::move(stream)), clock_(clock), settings_(settings) {
  if (stream_ == nullptr) throw std::invalid_argument("MipAccelerometer: no stream");
  if (!(settings_.rate_hz > 0.0) || !std::isfinite(settings_.rate_hz)) {
    throw std::invalid_argument(
        fmt::format("MipAccelerometer: rate_hz is {}; required: a positive number", settings_.rate_hz));
  }
  who_ = fmt::format("accelerometer microstrain_mip on {}", stream_->name());
}

AccelerometerInfo MipAccelerometer::identify() {
  return interrogate();
}

void MipAccelerometer::start() {
  interrogate();
  const std::vector<mip::FormatEntry> format = wanted_format();
  check_rate_and_link(format);
  if (abilities_.modern) {
    exchange({mip::k3dmSet, kFormat, mip::message_format(mip::kSensorSet, format), "message format", {}});
  } else {
    exchange(
        {mip::k3dmSet, kLegacyFormat, mip::legacy_message_format(format), "message format (legacy)", {}});
  }
  if (abilities_.stream_control) select_streams();

  // Every answer is in: what is left over is no part of the stream that begins now.
  parser_ = mip::PacketParser();
  exchange({mip::kBaseSet, kResume, {}, "resume", {}});

  health_ = StreamHealth();
  dropped_at_start_ = dropped_at_discard_ = stream_->dropped_bytes();
  malformed_bytes_ = 0;
  last_sequence_.reset();
  last_reference_time_ns_.reset();
  last_gps_timestamp_.reset();
  discard_next_reading_ = forgive_next_gap_ = false;
  temperature_degc_.reset();
  unframed_at_last_reading_ = 0;
  started_ = true;
}

std::optional<Reading> MipAccelerometer::next(Clock::Instant deadline) {
  if (!started_) fail(Fault::kNotReady, "asked for a reading before it was started");
  receive({{}, last_arrival_}, true);  // What came in together with the answer to "resume".
  while (queue_.empty()) {
    const wire::ReceivedBytes received = stream_->read_until(deadline);
    if (received.bytes.empty()) {
      while (const auto packet = parser_.next_behind_partial()) take_packet(*packet, true);
      break;
    }
    receive(received, true);
  }
  if (queue_.empty()) return std::nullopt;
  const Reading reading = queue_.front();
  queue_.pop_front();
  return reading;
}

void MipAccelerometer::discard_pending() {
  if (!started_) return;
  // What is thrown away is decoded all the same, as its time stamps say what was lost before and after it.
  const std::uint64_t lost_before = health_.lost_readings;
  const Clock::Instant now = clock_.now();
  receive({{}, last_arrival_}, false);
  for (;;) {
    const wire::ReceivedBytes received = stream_->read_until(now);
    if (received.bytes.empty()) break;
    receive(received, false);
  }
  queue_.clear();
  discard_next_reading_ = parser_.has_partial();  // It was made before now.
  if (stream_->dropped_bytes() != dropped_at_discard_) {
    // The input queue ran over since the last discard: that gap is of what is thrown away here.
    dropped_at_discard_ = stream_->dropped_bytes();
    health_.lost_readings = lost_before;
    forgive_next_gap_ = true;
  }
}

StreamHealth MipAccelerometer::health() const {
  StreamHealth health = health_;
  if (started_) {
    health.bad_frames += parser_.bad_checksums();
    health.skipped_bytes += parser_.skipped_bytes() + (stream_->dropped_bytes() - dropped_at_start_);
  }
  return health;
}

void MipAccelerometer::stop() noexcept {
  try {
    set_idle();
  } catch (...) {
    // On the way out: the interface says that failure is not reported.
  }
  end_stream();
}

// Commands.

Clock::Duration MipAccelerometer::reply_deadline() const {
  const double bytes_per_s = settings_.link_bytes_per_s.value_or(kDefaultBytesPerSecond);
  return kAnswerTime + from_seconds(kPacketTimeFactor * static_cast<double>(mip::kMaxPacket) / bytes_per_s);
}

void MipAccelerometer::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(who_, fault, detail);
}

void MipAccelerometer::fail_without_answer(const Command& command, const Evidence& evidence,
                                           Clock::Duration waited) const {
  const std::string asked = fmt::format("no answer to \"{}\" ({:02X},{:02X}) within {:.1f} s", command.name,
                                        command.set, command.descriptor, to_seconds(waited));
  if (evidence.bytes == 0) {
    fail(Fault::kNoReply,
         asked + ", not one byte came: is it switched on, and is the baud rate the one of the device?");
  }
  if (evidence.packets > 0) {
    fail(Fault::kNoReply, fmt::format("{}, though {} other MIP packets came in ({} with a wrong checksum)",
                                      asked, evidence.packets, evidence.bad_checksums));
  }
  if (evidence.bad_checksums > 0) {
    fail(Fault::kBadFrame,
         fmt::format("{}; {} bytes came with {} MIP packets, every one with a wrong checksum", asked,
                     evidence.bytes, evidence.bad_checksums));
  }
  fail(Fault::kWrongIdentity,
       fmt::format(
           "{}; {} bytes came that are no MIP packet, beginning {}: another instrument is on this port, "
           "or the baud rate is wrong",
           asked, evidence.bytes, in_hex(evidence.first_bytes)));
}

void MipAccelerometer::set_idle() {
  end_stream();
  parser_ = mip::PacketParser();
  stream_->discard_input();
  exchange({mip::kBaseSet, kSetIdle, {}, "set idle", {}});
}

/// Sends a command, once more if no answer comes, and returns the data of its reply field (empty if it has
/// none).
std::string MipAccelerometer::exchange(const Command& command) {
  // A device that streams may need more than a second try: the line is full, and an answer may get damaged.
  constexpr int kTries = 2;
  constexpr int kTriesWhileStreaming = 4;
  const Clock::Instant begin = clock_.now();
  Evidence evidence;
  auto reply = ask(command, evidence);
  for (int tries = 1; !reply; ++tries) {
    if (tries >= (evidence.packets > 0 ? kTriesWhileStreaming : kTries)) {
      fail_without_answer(command, evidence, clock_.now() - begin);
    }
    evidence = Evidence();
    reply = ask(command, evidence);
  }
  if (answers_outstanding_) {
    // An earlier try may be answered late, and its answer would pass for that of a like command. A device
    // answers in order: behind the answer to a ping, sent once, there is none.
    const Command ping{mip::kBaseSet, kPing, {}, "ping", {}};
    const Clock::Instant ping_begin = clock_.now();
    evidence = Evidence();
    if (!ask(ping, evidence)) fail_without_answer(ping, evidence, clock_.now() - ping_begin);
    answers_outstanding_ = false;
  }
  return *reply;
}

/// Sends a command once and waits for its answer; nothing at the deadline.
std::optional<std::string> MipAccelerometer::ask(const Command& command, Evidence& evidence) {
  stream_->write(mip::make_packet(command.set, {mip::make_field(command.descriptor, command.data)}));
  auto reply = await_reply(command, clock_.now() + reply_deadline(), evidence);
  if (!reply) answers_outstanding_ = true;
  return reply;
}

/// Waits for the answer; nothing at the deadline.
std::optional<std::string> MipAccelerometer::await_reply(const Command& command, Clock::Instant deadline,
                                                         Evidence& evidence) {
  constexpr std::size_t kShownBytes = 24;
  const std::uint64_t bad_before = parser_.bad_checksums();
  std::optional<std::string> reply;
  const auto look_at = [&](const std::optional<mip::Packet>& packet) {
    if (!packet) return false;
    ++evidence.packets;
    reply = match_reply(*packet, command);
    return true;
  };
  for (;;) {
    while (!reply && look_at(parser_.next())) continue;
    if (reply) break;
    const wire::ReceivedBytes received = stream_->read_until(std::min(deadline, clock_.now() + kSilence));
    if (received.bytes.empty()) {
      while (!reply && look_at(parser_.next_behind_partial())) continue;
      if (reply || clock_.now() >= deadline) break;
      continue;
    }
    last_arrival_ = received.arrival;
    evidence.bytes += received.bytes.size();
    evidence.first_bytes +=
        received.bytes.substr(0, kShownBytes - std::min(kShownBytes, evidence.first_bytes.size()));
    parser_.feed(received.bytes);
    if (clock_.now() >= deadline) {  // Data may never cease to come: look at these, then no further.
      while (!reply && look_at(parser_.next())) continue;
      break;
    }
  }
  evidence.bad_checksums += parser_.bad_checksums() - bad_before;
  return reply;
}

/// The data of the reply field if the packet answers this command. @throws InstrumentError kRefused.
std::optional<std::string> MipAccelerometer::match_reply(const mip::Packet& packet,
                                                         const Command& command) const {
  if (packet.descriptor_set != command.set) return std::nullopt;
  const auto fields = mip::split_fields(packet.payload);
  if (!fields) return std::nullopt;
  bool acknowledged = false;
  std::optional<std::string> reply;
  for (const mip::Field& field : *fields) {
    if (field.descriptor == mip::kAckField) {
      const auto ack = mip::decode_acknowledgement(field.data);
      if (!ack || ack->command != command.descriptor) continue;
      acknowledged = true;
      if (ack->code != 0) {
        fail(Fault::kRefused,
             fmt::format("code {} ({}) to \"{}\" ({:02X},{:02X})", ack->code,
                         mip::ack_code_in_words(ack->code), command.name, command.set, command.descriptor));
      }
    } else if (acknowledged && command.reply_field == field.descriptor) {
      reply = std::string(field.data);
    }
  }
  if (!acknowledged) return std::nullopt;
  if (!command.reply_field) return std::string();
  if (!reply) {
    fail(Fault::kBadFrame, fmt::format("\"{}\" was acknowledged without the reply field {:02X}", command.name,
                                       *command.reply_field));
  }
  return reply;
}

AccelerometerInfo MipAccelerometer::interrogate() {
  set_idle();

  const auto info =
      mip::decode_device_info(exchange({mip::kBaseSet, kDeviceInfo, {}, "device info", std::uint8_t{0x81}}));
  if (!info) fail(Fault::kBadFrame, "the answer to \"device info\" has not 82 bytes");
  who_ =
      fmt::format("accelerometer {} (SN {}) on {}", info->model_name, info->serial_number, stream_->name());

  auto offered =
      mip::decode_descriptors(exchange({mip::kBaseSet, kDescriptors, {}, "descriptors", std::uint8_t{0x82}}));
  if (!offered) fail(Fault::kBadFrame, "the answer to \"descriptors\" has an odd number of bytes");
  const auto offers = [&](std::uint8_t set, std::uint8_t field) {
    return std::find(offered->begin(), offered->end(), static_cast<std::uint16_t>(set << 8U | field)) !=
           offered->end();
  };
  if (offers(mip::kBaseSet, kExtendedDescriptors)) {  // A packet holds 125: newer devices have more to offer.
    const auto more = mip::decode_descriptors(
        exchange({mip::kBaseSet, kExtendedDescriptors, {}, "extended descriptors", std::uint8_t{0x86}}));
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
  for (const std::uint16_t descriptor : *offered) {
    const auto set = static_cast<std::uint8_t>(descriptor >> 8U);
    auto& others = abilities.other_data_sets;
    const bool known = std::find(others.begin(), others.end(), set) != others.end();
    if (set > mip::kSensorSet && set < kSharedSet && !known) others.push_back(set);
  }

  std::optional<std::uint16_t> base_rate_hz;
  if (abilities.modern) {
    const std::string reply =
        exchange({mip::k3dmSet, kBaseRate, mip::u8(mip::kSensorSet), "base rate", std::uint8_t{0x8E}});
    if (reply.starts_with(mip::u8(mip::kSensorSet)))
      base_rate_hz = mip::decode_u16(std::string_view(reply).substr(1));
  } else {
    base_rate_hz = mip::decode_u16(
        exchange({mip::k3dmSet, kLegacyBaseRate, {}, "base rate (legacy)", std::uint8_t{0x83}}));
  }
  if (base_rate_hz.value_or(0) == 0) fail(Fault::kBadFrame, "the answer to \"base rate\" holds no rate");
  abilities.base_rate_hz = *base_rate_hz;
  abilities.decimation = nearest_decimation(abilities.base_rate_hz, settings_.rate_hz);
  abilities_ = abilities;

  return AccelerometerInfo{
      .maker = "MicroStrain",
      .model = info->model_name,
      .serial_number = info->serial_number,
      .firmware = fmt::format("{}", info->firmware),
      .output_unit = "g",
      // What the bench file says goes first: the options text is free text.
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
    fail(Fault::kRefused,
         fmt::format(
             "rate_hz is {}; it makes {} readings a second divided by a whole number, the nearest is {:.6g}",
             settings_.rate_hz, abilities_.base_rate_hz, rate));
  }
  if (!settings_.link_bytes_per_s) return;
  double needed = rate * static_cast<double>(mip::kPacketOverhead);
  for (const mip::FormatEntry& entry : format) {
    const double entry_rate =
        static_cast<double>(abilities_.base_rate_hz) / static_cast<double>(entry.decimation);
    needed += entry_rate * static_cast<double>(data_bytes(entry.descriptor) + 2);
  }
  if (needed > *settings_.link_bytes_per_s) {
    fail(Fault::kRefused,
         fmt::format(
             "{:.6g} readings a second need {:.0f} bytes/s, the link carries {:.0f}: lower rate_hz to {:.0f} "
             "or less, or raise the baud rate of the device",
             rate, needed, *settings_.link_bytes_per_s,
             std::floor(rate * *settings_.link_bytes_per_s / needed)));
  }
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
      exchange({mip::k3dmSet, kStreamControl, mip::u8(1) + mip::u8(*stream) + mip::u8(0), "stream off", {}});
    } catch (const InstrumentError& error) {
      // Not every set that is listed can be streamed. One that goes on costs room on the line, no reading.
      if (error.fault() != Fault::kRefused) throw;
    }
  }
  exchange({mip::k3dmSet,
            kStreamControl,
            mip::u8(1) + mip::u8(*selector(mip::kSensorSet)) + mip::u8(1),
            "stream on",
            {}});
}

// Data.

/// Ends the counting of a stream; its figures remain.
void MipAccelerometer::end_stream() noexcept {
  if (!started_) return;
  health_ = health();
  started_ = false;
  queue_.clear();
}

void MipAccelerometer::receive(const wire::ReceivedBytes& received, bool keep) {
  last_arrival_ = received.arrival;
  parser_.feed(received.bytes);
  while (const auto packet = parser_.next()) take_packet(*packet, keep);
}

void MipAccelerometer::take_packet(const mip::Packet& packet, bool keep) {
  if (packet.descriptor_set != mip::kSensorSet) return;

  Reading reading;
  bool has_output = false;
  std::optional<std::uint64_t> reference_time_ns;
  std::optional<mip::GpsTimestamp> gps_timestamp;
  bool sound = true;
  const auto fields = mip::split_fields(packet.payload);
  for (const mip::Field& field : fields.value_or(std::vector<mip::Field>())) {
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
        temperature_arrival_ = last_arrival_;
        break;
      }
      default:
        break;
    }
  }
  if (!fields || !sound) {
    ++health_.bad_frames;
    malformed_bytes_ += packet.payload.size() + mip::kPacketOverhead;
    return;
  }
  if (!has_output) return;

  const std::uint64_t steps = steps_since_last_reading(reference_time_ns, gps_timestamp);
  last_reading_packet_bytes_ = packet.payload.size() + mip::kPacketOverhead;
  if (last_sequence_ && !forgive_next_gap_) health_.lost_readings += steps - 1;
  forgive_next_gap_ = false;

  reading.sequence = last_sequence_ ? *last_sequence_ + steps : 0;
  reading.arrival = last_arrival_;
  if (last_arrival_ - temperature_arrival_ <= kTemperatureHold) reading.temperature_degc = temperature_degc_;
  last_sequence_ = reading.sequence;

  if (std::exchange(discard_next_reading_, false) || !keep) return;
  if (queue_.size() >= kQueueCapacity) {
    ++health_.lost_readings;
    return;
  }
  ++health_.readings;
  queue_.push_back(reading);
}

/// How many readings the device has made since the last one received: 1 if none was lost.
std::uint64_t MipAccelerometer::steps_since_last_reading(
    std::optional<std::uint64_t> reference_time_ns, const std::optional<mip::GpsTimestamp>& gps_timestamp) {
  constexpr double kSecondsPerWeek = 604800.0;
  constexpr std::uint16_t kTimeRefresh = 0x0002;  // Toggles when the time is set: it may step.

  const auto last_reference_time_ns = std::exchange(last_reference_time_ns_, reference_time_ns);
  const auto last_gps_timestamp = std::exchange(last_gps_timestamp_, gps_timestamp);
  const std::uint64_t unframed = unframed_bytes();
  const std::uint64_t unframed_since = unframed - std::exchange(unframed_at_last_reading_, unframed);
  if (!last_sequence_) return 1;

  const auto periods_in = [&](double duration_s) {
    return static_cast<std::uint64_t>(std::max(1.0, std::round(duration_s * rate_hz())));
  };
  if (reference_time_ns && last_reference_time_ns) {
    if (*reference_time_ns < *last_reference_time_ns) {
      end_stream();
      fail(Fault::kNotReady,
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
  // No clock: every stretch of lost or damaged bytes as long as a packet was a reading.
  return 1 + static_cast<std::uint64_t>(std::round(static_cast<double>(unframed_since) /
                                                   static_cast<double>(last_reading_packet_bytes_)));
}

/// Bytes since start() that came to no use. Those the parser still holds back are not among them.
std::uint64_t MipAccelerometer::unframed_bytes() const {
  return parser_.skipped_bytes() + malformed_bytes_ + (stream_->dropped_bytes() - dropped_at_start_);
}

}  // namespace abcal
