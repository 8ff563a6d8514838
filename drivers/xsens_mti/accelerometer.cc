#include "drivers/xsens_mti/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

// A device answers within milliseconds; its output buffer, full at 9600 baud, takes 1 s to empty [M].
constexpr seconds kAnswerTime{2};
// After this long without a byte, an answer behind a false beginning is looked for.
constexpr milliseconds kSilence{50};

constexpr double kRateTolerance = 0.01;
constexpr seconds kTemperatureHold{10};

constexpr std::size_t kFrameBytes = 5;  // FA FF, id, length, checksum.
constexpr std::size_t kItemHeader = 3;
// Packet counter 2, sample time 4, acceleration 3 float32, status word 4.
constexpr std::size_t kPacketBytes = kFrameBytes + 4 * kItemHeader + 2 + 4 + 12 + 4;
constexpr std::size_t kTemperatureBytes = kItemHeader + 4;  // Once a second.

std::string in_hex(std::string_view bytes) {
  std::string text;
  for (const char byte : bytes)
    text += fmt::format("{}{:02X}", text.empty() ? "" : " ", static_cast<unsigned char>(byte));
  return text;
}

std::string trimmed(std::string_view text) {
  constexpr std::string_view kPadding(" \0", 2);
  const std::size_t first = text.find_first_not_of(kPadding);
  if (first == std::string_view::npos) return {};
  return std::string(text.substr(first, text.find_last_not_of(kPadding) - first + 1));
}

}  // namespace

XsensMtiAccelerometer::XsensMtiAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                             const AccelerometerSettings& settings)
    : stream_(std::move(stream)), clock_(clock), settings_(settings) {
  if (stream_ == nullptr) throw std::invalid_argument("XsensMtiAccelerometer: no stream");
  if (!(settings_.rate_hz > 0.0) || !std::isfinite(settings_.rate_hz)) {
    throw std::invalid_argument(
        fmt::format("XsensMtiAccelerometer: rate_hz is {}; required: a positive number", settings_.rate_hz));
  }
  who_ = fmt::format("accelerometer xsens_mti on {}", stream_->name());
}

AccelerometerInfo XsensMtiAccelerometer::identify() {
  return interrogate();
}

void XsensMtiAccelerometer::start() {
  interrogate();
  configure_output();

  // Every answer is in: what is left over is no part of the stream that begins now.
  parser_ = xbus::MessageParser();
  readings_.restart();
  malformed_ = malformed_bytes_ = 0;
  dropped_at_start_ = dropped_at_discard_ = stream_->dropped_bytes();
  unframed_at_last_reading_ = 0;
  last_packet_counter_.reset();
  last_sample_time_.reset();
  lost_packets_ = 0;
  temperature_degc_.reset();
  exchange({xbus::kGotoMeasurement, {}, "go to measurement"});
  started_ = true;
}

std::optional<Reading> XsensMtiAccelerometer::next(Clock::Instant deadline) {
  if (!started_) fail(Fault::kNotReady, "asked for a reading before it was started");
  receive({{}, last_arrival_});  // What came in together with the last answer.
  while (readings_.empty()) {
    const wire::ReceivedBytes received = stream_->read_until(deadline);
    if (received.bytes.empty()) {
      while (const auto message = parser_.next_behind_partial()) take_message(*message);
      break;
    }
    receive(received);
  }
  return readings_.pop();
}

void XsensMtiAccelerometer::discard_pending() {
  if (!started_) return;
  const Clock::Instant now = clock_.now();
  readings_.begin_discard();
  receive({{}, last_arrival_});
  for (;;) {
    const wire::ReceivedBytes received = stream_->read_until(now);
    if (received.bytes.empty()) break;
    receive(received);
  }
  const std::size_t dropped = stream_->dropped_bytes();
  readings_.end_discard(parser_.has_partial(), std::exchange(dropped_at_discard_, dropped) != dropped);
}

StreamHealth XsensMtiAccelerometer::health() const {
  StreamHealth health{.readings = readings_.readings(),
                      .lost_readings = readings_.lost(),
                      .bad_frames = bad_frames_at_end_,
                      .skipped_bytes = skipped_bytes_at_end_};
  if (started_) {
    health.bad_frames = parser_.bad_messages() + malformed_;
    health.skipped_bytes = parser_.skipped_bytes() + (stream_->dropped_bytes() - dropped_at_start_);
  }
  return health;
}

void XsensMtiAccelerometer::stop() noexcept {
  try {
    go_to_config();
  } catch (...) {
    // On the way out: the interface says that failure is not reported.
  }
  end_stream();
}

// Commands.

void XsensMtiAccelerometer::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(who_, fault, detail);
}

void XsensMtiAccelerometer::refuse(const Command& command, unsigned error) const {
  fail(Fault::kRefused, fmt::format("error {:02X} ({}) to \"{}\" ({:02X})", error,
                                    xbus::error_in_words(error), command.name, command.id));
}

void XsensMtiAccelerometer::fail_without_answer(const Command& command, const Evidence& evidence,
                                                Clock::Duration waited) const {
  const std::string asked = fmt::format("no answer to \"{}\" ({:02X}) within {:.1f} s", command.name,
                                        command.id, to_seconds(waited));
  if (evidence.bytes == 0) {
    fail(Fault::kNoReply,
         asked + ", not one byte came: is it switched on, and is the baud rate the one of the device?");
  }
  if (evidence.messages > 0) {
    fail(Fault::kNoReply, fmt::format("{}, though {} other Xbus messages came in ({} damaged)", asked,
                                      evidence.messages, evidence.bad_messages));
  }
  if (evidence.bad_messages > 0) {
    fail(Fault::kBadFrame, fmt::format("{}; {} bytes came with {} Xbus messages, every one damaged", asked,
                                       evidence.bytes, evidence.bad_messages));
  }
  fail(Fault::kWrongIdentity,
       fmt::format(
           "{}; {} bytes came that are no Xbus message, beginning {}: another instrument is on this port, or "
           "the baud rate is wrong",
           asked, evidence.bytes, in_hex(evidence.first_bytes)));
}

/// Sends a command and returns the data of its answer. @throws InstrumentError kRefused.
std::string XsensMtiAccelerometer::exchange(const Command& command) {
  Answer answer = try_exchange(command);
  if (answer.error) refuse(command, *answer.error);
  return std::move(answer.data);
}

/// Sends a command, again if no answer comes, and returns its answer or refusal.
XsensMtiAccelerometer::Answer XsensMtiAccelerometer::try_exchange(const Command& command) {
  // A device that streams may need more than a second try: the line is full, and an answer may get damaged.
  constexpr int kTries = 2;
  constexpr int kTriesWhileStreaming = 4;
  // If that fails too, it is tried again behind the answer; and until then an error may be a late answer.
  const bool heed_errors = !answers_outstanding_ || settle();
  const Clock::Instant begin = clock_.now();
  Evidence evidence;
  auto answer = ask(command, heed_errors, evidence);
  for (int tries = 1; !answer; ++tries) {
    if (tries >= (evidence.messages > 0 ? kTriesWhileStreaming : kTries))
      fail_without_answer(command, evidence, clock_.now() - begin);
    evidence = Evidence();
    answer = ask(command, heed_errors, evidence);
  }
  if (answers_outstanding_ && !settle())
    fail(Fault::kNoReply, fmt::format("it answered \"{}\" late, and nothing after that", command.name));
  return *answer;
}

/// Waits until no answer is outstanding. An earlier try may be answered late, and its answer would pass for
/// that of a like command; an error names no command at all. A device answers in order: behind the answer to
/// this question, asked only here, there is none. False: it was not answered.
bool XsensMtiAccelerometer::settle() {
  Evidence evidence;
  answers_outstanding_ = !ask({xbus::kReqHardware, {}, "hardware version"}, false, evidence);
  return !answers_outstanding_;
}

/// Sends a command once and waits for its answer; nothing at the deadline.
std::optional<XsensMtiAccelerometer::Answer> XsensMtiAccelerometer::ask(const Command& command,
                                                                        bool heed_errors,
                                                                        Evidence& evidence) {
  stream_->write(xbus::make_message(command.id, command.data));
  auto answer = await_answer(command, heed_errors, clock_.now() + kAnswerTime, evidence);
  if (!answer) answers_outstanding_ = true;
  return answer;
}

std::optional<XsensMtiAccelerometer::Answer> XsensMtiAccelerometer::await_answer(const Command& command,
                                                                                 bool heed_errors,
                                                                                 Clock::Instant deadline,
                                                                                 Evidence& evidence) {
  constexpr std::size_t kShownBytes = 24;
  const std::uint64_t bad_before = parser_.bad_messages();
  std::optional<Answer> answer;
  const auto look_at = [&](const std::optional<xbus::Message>& message) {
    if (!message) return false;
    ++evidence.messages;
    if (message->id == command.id + 1) {
      answer = Answer{std::string(message->data), std::nullopt};
    } else if (message->id == xbus::kError && heed_errors && message->data.size() == 1) {
      answer = Answer{{}, static_cast<unsigned char>(message->data.front())};
    }
    return true;
  };
  for (;;) {
    while (!answer && look_at(parser_.next())) continue;
    if (answer) break;
    const wire::ReceivedBytes received = stream_->read_until(std::min(deadline, clock_.now() + kSilence));
    if (received.bytes.empty()) {
      while (!answer && look_at(parser_.next_behind_partial())) continue;
      if (answer || clock_.now() >= deadline) break;
      continue;
    }
    last_arrival_ = received.arrival;
    evidence.bytes += received.bytes.size();
    evidence.first_bytes +=
        received.bytes.substr(0, kShownBytes - std::min(kShownBytes, evidence.first_bytes.size()));
    parser_.feed(received.bytes);
    if (clock_.now() >= deadline) {  // Data may never cease to come: look at these, then no further.
      while (!answer && look_at(parser_.next())) continue;
      break;
    }
  }
  evidence.bad_messages += parser_.bad_messages() - bad_before;
  return answer;
}

void XsensMtiAccelerometer::go_to_config() {
  end_stream();
  parser_ = xbus::MessageParser();
  stream_->discard_input();
  exchange({xbus::kGotoConfig, {}, "go to config"});
}

AccelerometerInfo XsensMtiAccelerometer::interrogate() {
  go_to_config();
  const std::string device_id = exchange({xbus::kReqDeviceId, {}, "device id"});
  if (device_id.size() != 4 && device_id.size() != 8) {  // Eight of the MTi-600 series [M].
    fail(Fault::kBadFrame,
         fmt::format("the answer to \"device id\" has {} bytes; required: 4 or 8", device_id.size()));
  }
  std::string serial_number;
  for (const char byte : device_id) serial_number += fmt::format("{:02X}", static_cast<unsigned char>(byte));
  const std::string model = trimmed(exchange({xbus::kReqProductCode, {}, "product code"}));
  if (!model.starts_with("MT")) {
    fail(Fault::kWrongIdentity,
         fmt::format("its product code is \"{}\"; required: one that begins with MT", model));
  }
  const std::string firmware = exchange({xbus::kReqFirmware, {}, "firmware version"});
  if (firmware.size() < 3) {
    fail(Fault::kBadFrame, fmt::format("the answer to \"firmware version\" has {} bytes; required: 3 or more",
                                       firmware.size()));
  }
  const auto part = [&](std::size_t index) {
    return static_cast<unsigned>(static_cast<unsigned char>(firmware[index]));
  };
  who_ = fmt::format("accelerometer {} (SN {}) on {}", model, serial_number, stream_->name());
  return AccelerometerInfo{
      .maker = "Xsens",
      .model = model,
      .serial_number = serial_number,
      .firmware = fmt::format("{}.{}.{}", part(0), part(1), part(2)),
      .output_unit = "m/s2",
      .full_scale = settings_.full_scale,  // The device does not say.
      .resolution = std::nullopt,
      .rate_hz = rate_hz_ > 0.0 ? rate_hz_ : std::round(settings_.rate_hz),
  };
}

void XsensMtiAccelerometer::configure_output() {
  // A rate is a whole number of hertz, FFFF excepted.
  const double rate_hz = std::clamp(std::round(settings_.rate_hz), 1.0, 65534.0);
  if (std::abs(rate_hz - settings_.rate_hz) > kRateTolerance * settings_.rate_hz) {
    fail(Fault::kRefused,
         fmt::format("rate_hz is {}; it makes whole numbers of readings a second, the nearest is {}",
                     settings_.rate_hz, rate_hz));
  }
  check_link(rate_hz);
  const xbus::Output counter{xbus::kPacketCounter, xbus::kEveryPacket};
  const xbus::Output acceleration{xbus::kAcceleration, static_cast<std::uint16_t>(rate_hz)};
  const std::vector<xbus::Output> all{counter,
                                      {xbus::kSampleTimeFine, xbus::kEveryPacket},
                                      acceleration,
                                      {xbus::kTemperature, 1},
                                      {xbus::kStatusWord, xbus::kEveryPacket}};
  constexpr std::string_view kName = "set output configuration";
  Answer answer = try_exchange({xbus::kSetOutputConfiguration, xbus::output_configuration(all), kName});
  if (answer.error) {
    // Not every model has all of them; these two are needed.
    answer.data =
        exchange({xbus::kSetOutputConfiguration, xbus::output_configuration({counter, acceleration}), kName});
  }
  const auto outputs = xbus::decode_output_configuration(answer.data);
  if (!outputs) fail(Fault::kBadFrame, "the answer to \"set output configuration\" is no list of outputs");
  const auto find = [&](std::uint16_t kind) {
    return std::find_if(outputs->begin(), outputs->end(),
                        [&](const xbus::Output& output) { return xbus::kind_of(output.id) == kind; });
  };
  const auto set = find(xbus::kAcceleration);
  if (set == outputs->end()) fail(Fault::kWrongIdentity, "this device offers no acceleration (4020)");
  if (set->rate_hz == 0 || std::abs(set->rate_hz - settings_.rate_hz) > kRateTolerance * settings_.rate_hz) {
    fail(Fault::kRefused,
         fmt::format("rate_hz is {}; it set its acceleration output to {}", settings_.rate_hz, set->rate_hz));
  }
  rate_hz_ = set->rate_hz;
  counts_packets_ = find(xbus::kPacketCounter) != outputs->end();
}

void XsensMtiAccelerometer::check_link(double rate_hz) const {
  if (!settings_.link_bytes_per_s) return;
  const double available = *settings_.link_bytes_per_s - kTemperatureBytes;
  const double needed = rate_hz * static_cast<double>(kPacketBytes);
  if (needed <= available) return;
  fail(
      Fault::kRefused,
      fmt::format(
          "{:.6g} readings a second need {:.0f} bytes/s, the link carries {:.0f}: lower rate_hz to {:.0f} or "
          "less, or raise the baud rate of the device",
          rate_hz, needed + kTemperatureBytes, *settings_.link_bytes_per_s,
          std::floor(std::max(0.0, available) / static_cast<double>(kPacketBytes))));
}

// Data.

/// Ends the counting of a stream; its figures remain.
void XsensMtiAccelerometer::end_stream() noexcept {
  if (!started_) return;
  const StreamHealth figures = health();
  bad_frames_at_end_ = figures.bad_frames;
  skipped_bytes_at_end_ = figures.skipped_bytes;
  started_ = false;
  readings_.close();
}

void XsensMtiAccelerometer::receive(const wire::ReceivedBytes& received) {
  last_arrival_ = received.arrival;
  parser_.feed(received.bytes);
  while (const auto message = parser_.next()) take_message(*message);
}

void XsensMtiAccelerometer::take_message(const xbus::Message& message) {
  switch (message.id) {
    case xbus::kMtData2:
      take_data(message);
      return;
    case xbus::kError: {
      const unsigned code = message.data.empty() ? 0U : static_cast<unsigned char>(message.data.front());
      end_stream();
      fail(Fault::kRefused, fmt::format("error {:02X} ({}) while it streams {:.6g} readings a second", code,
                                        xbus::error_in_words(code), rate_hz_));
    }
    case xbus::kWakeUp:
      end_stream();
      fail(Fault::kNotReady, "it says that it woke up: it was restarted");
    default:
      return;  // Late answers.
  }
}

void XsensMtiAccelerometer::take_data(const xbus::Message& message) {
  Reading reading;
  bool has_output = false;
  std::optional<std::uint16_t> packet_counter;
  std::optional<std::uint32_t> sample_time;
  std::optional<std::uint32_t> status_word;
  std::optional<double> temperature;
  bool sound = true;
  const auto items = xbus::split_items(message.data);
  const auto keep = [&](auto& value, auto decoded) {
    value = decoded;
    sound = sound && decoded.has_value();
  };
  for (const xbus::Item& item : items.value_or(std::vector<xbus::Item>())) {
    switch (xbus::kind_of(item.id)) {
      case xbus::kAcceleration:
        if (const auto acceleration = xbus::decode_acceleration(item)) {
          reading.output = *acceleration;
          has_output = true;
        } else {
          sound = false;
        }
        break;
      case xbus::kPacketCounter:
        keep(packet_counter, xbus::decode_u16(item.data));
        break;
      case xbus::kSampleTimeFine:
        keep(sample_time, xbus::decode_u32(item.data));
        break;
      case xbus::kStatusWord:
        keep(status_word, xbus::decode_u32(item.data));
        break;
      case xbus::kTemperature:
        keep(temperature, xbus::decode_temperature(item));
        break;
      default:
        break;
    }
  }
  // The same packet twice is no second reading.
  const bool repeated = packet_counter && packet_counter == last_packet_counter_;
  if (!items || !sound || repeated || (counts_packets_ && !packet_counter)) {
    ++malformed_;
    malformed_bytes_ += message.data.size() + kFrameBytes;
    return;
  }
  if (sample_time) check_sample_time(*sample_time);
  if (temperature) {
    temperature_degc_ = temperature;
    temperature_arrival_ = last_arrival_;
  }
  if (packet_counter) {
    if (last_packet_counter_) {
      // The counter has 16 bits: FFFF is followed by 0.
      lost_packets_ += static_cast<std::uint16_t>(*packet_counter - *last_packet_counter_ - 1U);
    }
    last_packet_counter_ = packet_counter;
  }
  if (!has_output) return;  // Counted, and no reading.

  std::uint64_t steps = 1 + std::exchange(lost_packets_, 0);
  const std::uint64_t unframed = unframed_bytes();
  const std::uint64_t unframed_since = unframed - std::exchange(unframed_at_last_reading_, unframed);
  if (!packet_counter && readings_.has_any_come()) {
    // No counter: every stretch of lost or damaged bytes as long as a packet was a reading.
    steps = 1 + static_cast<std::uint64_t>(std::round(static_cast<double>(unframed_since) /
                                                      static_cast<double>(last_reading_bytes_)));
  }
  last_reading_bytes_ = message.data.size() + kFrameBytes;

  reading.arrival = last_arrival_;
  if (last_arrival_ - temperature_arrival_ <= kTemperatureHold) reading.temperature_degc = temperature_degc_;
  reading.over_range = status_word && xbus::accelerometer_clipped(*status_word);
  readings_.push(std::move(reading), steps);
}

/// A packet counter that begins anew passes for a long gap; the sample time, in 0.1 ms, does not.
void XsensMtiAccelerometer::check_sample_time(std::uint32_t sample_time) {
  const auto last = std::exchange(last_sample_time_, sample_time);
  if (!last) return;
  const std::uint32_t ahead = sample_time - *last;  // Wraps after 5 days.
  if (ahead < 0x8000'0000U) return;
  end_stream();
  fail(Fault::kNotReady,
       fmt::format("its sample time went back from {} to {} (0.1 ms): it was restarted", *last, sample_time));
}

/// Bytes since start() that came to no use. Those the parser still holds back are not among them.
std::uint64_t XsensMtiAccelerometer::unframed_bytes() const {
  return parser_.skipped_bytes() + malformed_bytes_ + (stream_->dropped_bytes() - dropped_at_start_);
}

}  // namespace abcal
