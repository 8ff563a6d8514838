#include "drivers/vectornav/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using vectornav::BinaryMessage;
using vectornav::Message;
using vectornav::TextMessage;

// A device answers within milliseconds; its output buffer, full at 9600 baud, takes 1 s to empty [M].
constexpr seconds kAnswerTime{2};
// After this long without a byte, an answer behind a false beginning is looked for.
constexpr milliseconds kSilence{50};

constexpr double kRateTolerance = 0.01;
constexpr unsigned kBitsPerByte = 10;  // On a UART, with start and stop bit.

// Rates of the text output (register 7).
constexpr std::array kTextRates{1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0};
// [M] "$VNIMU" with 11 numbers and "$VNACC" with 3, in the widths that are seen, at 16 g, with a CRC.
constexpr std::size_t kImuTextBytes = 115;
constexpr std::size_t kAccelerationTextBytes = 40;

constexpr unsigned kInvalidCommand = 0x04;
constexpr unsigned kInvalidParameter = 0x07;
constexpr unsigned kInvalidRegister = 0x08;

/// Time since startup and acceleration of the common group, temperature of the IMU group.
constexpr std::array<std::uint16_t, vectornav::kGroups> kOutputFields{
    (1U << vectornav::kTimeStartup) | (1U << vectornav::kAcceleration),
    0,
    1U << vectornav::kTemperature,
    0,
    0,
    0};

std::string printable(std::string_view bytes) {
  std::string text;
  for (const char c : bytes) {
    const bool plain = c >= ' ' && c <= '~';
    text += plain ? std::string(1, c) : fmt::format("\\x{:02X}", static_cast<unsigned char>(c));
  }
  return text;
}

/// Errors that a device reports on its own account: no answer to a command.
bool is_of_no_command(unsigned error) {
  return error == 0x01 || error == 0x02 || error == 0x0A || error == 0x0B || error == 0xFF;
}

std::optional<unsigned> error_code(std::string_view text) {
  constexpr std::string_view kError = "VNERR,";
  if (!text.starts_with(kError)) return std::nullopt;
  text.remove_prefix(kError.size());
  unsigned code = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), code, 16);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return code;
}

/// What stands behind `VNxxx,n` of an answer to this command ("VNRRG,01", "VNWRG,75,1,..."); nothing if it
/// answers another one. Register numbers are compared as numbers: "01" and "1" are the same.
std::optional<std::string> values_if_answer(std::string_view text, std::string_view command) {
  const auto parse = [](std::string_view words) -> std::optional<std::pair<std::string_view, unsigned>> {
    const std::size_t comma = words.find(',');
    if (comma == std::string_view::npos) return std::nullopt;
    unsigned number = 0;
    const std::string_view rest = words.substr(comma + 1);
    const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), number);
    if (error != std::errc{} || (end != rest.data() + rest.size() && *end != ',')) return std::nullopt;
    return std::pair(words.substr(0, comma), number);
  };
  const auto asked = parse(command);
  const auto answered = parse(text);
  if (!asked || answered != asked) return std::nullopt;
  const std::size_t second = text.find(',', text.find(',') + 1);
  return std::string(second == std::string_view::npos ? std::string_view() : text.substr(second + 1));
}

/// [M] The manuals give the IMU rate of the VN-100 as 800 Hz and that of the VN-200 and VN-300 as 400 Hz. A
/// device for which this is wrong is found out by its time stamps (check_period).
unsigned imu_rate_of(std::string_view model) {
  return model.starts_with("VN-2") || model.starts_with("VN-3") ? 400U : 800U;
}

}  // namespace

VectorNavAccelerometer::VectorNavAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                               const AccelerometerSettings& settings)
    : stream_(std::move(stream)), clock_(clock), settings_(settings) {
  if (stream_ == nullptr) throw std::invalid_argument("VectorNavAccelerometer: no stream");
  if (!(settings_.rate_hz > 0.0) || !std::isfinite(settings_.rate_hz)) {
    throw std::invalid_argument(
        fmt::format("VectorNavAccelerometer: rate_hz is {}; required: a positive number", settings_.rate_hz));
  }
  who_ = fmt::format("accelerometer vectornav on {}", stream_->name());
}

AccelerometerInfo VectorNavAccelerometer::identify() {
  return interrogate();
}

void VectorNavAccelerometer::start() {
  interrogate();
  exchange("VNWRG,06,0");  // No text output: its messages would share the line.
  if (!try_binary_output()) set_text_output();

  // Every answer is in: what is left over is no part of the stream that begins now.
  parser_ =
      vectornav::MessageParser(output_ == Output::kBinary ? vectornav::binary_header(kOutputFields) : "");
  readings_.restart();
  malformed_ = 0;
  dropped_at_start_ = dropped_at_discard_ = stream_->dropped_bytes();
  unframed_at_last_reading_ = 0;
  last_time_ns_.reset();
  periods_seen_ = 0;
  const Answer resumed = try_exchange("VNASY,1");
  // A firmware without this command could not be paused either: it streams.
  if (resumed.error && *resumed.error != kInvalidCommand) refuse("VNASY,1", *resumed.error);
  started_ = true;
}

std::optional<Reading> VectorNavAccelerometer::next(Clock::Instant deadline) {
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

void VectorNavAccelerometer::discard_pending() {
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

StreamHealth VectorNavAccelerometer::health() const {
  StreamHealth health{.readings = readings_.readings(),
                      .lost_readings = readings_.lost(),
                      .bad_frames = bad_frames_at_end_,
                      .skipped_bytes = skipped_bytes_at_end_};
  if (started_) {
    health.bad_frames = parser_.bad_checksums() + malformed_;
    health.skipped_bytes = parser_.skipped_bytes() + (stream_->dropped_bytes() - dropped_at_start_);
  }
  return health;
}

void VectorNavAccelerometer::stop() noexcept {
  try {
    pause_output();
  } catch (...) {
    // On the way out: the interface says that failure is not reported.
  }
  end_stream();
}

// Commands.

void VectorNavAccelerometer::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(who_, fault, detail);
}

void VectorNavAccelerometer::refuse(std::string_view command, unsigned error) const {
  fail(Fault::kRefused,
       fmt::format("error {:02X} ({}) to \"{}\"", error, vectornav::error_in_words(error), command));
}

void VectorNavAccelerometer::fail_without_answer(std::string_view command, const Evidence& evidence,
                                                 Clock::Duration waited) const {
  const std::string asked = fmt::format("no answer to \"{}\" within {:.1f} s", command, to_seconds(waited));
  if (evidence.bytes == 0) {
    fail(Fault::kNoReply,
         asked + ", not one byte came: is it switched on, and is the baud rate the one of the device?");
  }
  if (evidence.messages > 0) {
    fail(Fault::kNoReply,
         fmt::format("{}, though {} other VectorNav messages came in ({} with a wrong checksum)", asked,
                     evidence.messages, evidence.bad_checksums));
  }
  if (evidence.bad_checksums > 0) {
    fail(Fault::kBadFrame,
         fmt::format("{}; {} bytes came with {} VectorNav messages, every one with a wrong checksum", asked,
                     evidence.bytes, evidence.bad_checksums));
  }
  fail(Fault::kWrongIdentity,
       fmt::format(
           "{}; {} bytes came that are no VectorNav message, beginning \"{}\": another instrument is on this "
           "port, or the baud rate is wrong",
           asked, evidence.bytes, printable(evidence.first_bytes)));
}

/// Sends a command and returns the values of its answer. @throws InstrumentError kRefused.
std::string VectorNavAccelerometer::exchange(std::string_view command) {
  Answer answer = try_exchange(command);
  if (answer.error) refuse(command, *answer.error);
  return std::move(answer.values);
}

/// Sends a command, again if no answer comes, and returns its answer or refusal.
VectorNavAccelerometer::Answer VectorNavAccelerometer::try_exchange(std::string_view command) {
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
    fail(Fault::kNoReply, fmt::format("it answered \"{}\" late, and nothing after that", command));
  return *answer;
}

/// Waits until no answer is outstanding. An earlier try may be answered late, and its answer would pass for
/// that of a like command; an error names no command at all. A device answers in order: behind the answer to
/// this question, asked only here, there is none. False: it was not answered.
bool VectorNavAccelerometer::settle() {
  Evidence evidence;
  answers_outstanding_ = !ask("VNRRG,02", false, evidence);
  return !answers_outstanding_;
}

/// Sends a command once and waits for its answer; nothing at the deadline.
std::optional<VectorNavAccelerometer::Answer> VectorNavAccelerometer::ask(std::string_view command,
                                                                          bool heed_errors,
                                                                          Evidence& evidence) {
  // With a CRC: the device then answers with one, and an XOR overlooks one damaged message in 256.
  stream_->write(vectornav::make_message(command, vectornav::Checksum::kCrc16));
  auto answer = await_answer(command, heed_errors, clock_.now() + kAnswerTime, evidence);
  if (!answer) answers_outstanding_ = true;
  return answer;
}

std::optional<VectorNavAccelerometer::Answer> VectorNavAccelerometer::await_answer(std::string_view command,
                                                                                   bool heed_errors,
                                                                                   Clock::Instant deadline,
                                                                                   Evidence& evidence) {
  constexpr std::size_t kShownBytes = 24;
  const std::uint64_t bad_before = parser_.bad_checksums();
  std::optional<Answer> answer;
  const auto look_at = [&](const std::optional<Message>& message) {
    if (!message) return false;
    ++evidence.messages;
    const auto* text = std::get_if<TextMessage>(&*message);
    if (text == nullptr) return true;
    const auto error = error_code(text->text);
    if (error && heed_errors && !is_of_no_command(*error)) answer = Answer{{}, error};
    if (auto values = values_if_answer(text->text, command))
      answer = Answer{std::move(*values), std::nullopt};
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
  evidence.bad_checksums += parser_.bad_checksums() - bad_before;
  return answer;
}

void VectorNavAccelerometer::pause_output() {
  end_stream();
  parser_ = vectornav::MessageParser();
  stream_->discard_input();
  const Answer answer = try_exchange("VNASY,0");
  // A firmware without this command streams on; answers are found among the data.
  if (answer.error && *answer.error != kInvalidCommand) refuse("VNASY,0", *answer.error);
}

AccelerometerInfo VectorNavAccelerometer::interrogate() {
  pause_output();
  const std::string model = exchange("VNRRG,01");
  if (!model.starts_with("VN-")) {
    fail(Fault::kWrongIdentity,
         fmt::format("its model is \"{}\"; required: a name that begins with VN-", printable(model)));
  }
  const std::string serial_number = exchange("VNRRG,03");
  const std::string firmware = exchange("VNRRG,04");
  who_ = fmt::format("accelerometer {} (SN {}) on {}", model, serial_number, stream_->name());
  imu_rate_hz_ = imu_rate_of(model);

  link_bytes_per_s_ = settings_.link_bytes_per_s;
  if (!link_bytes_per_s_) {
    const Answer baud = try_exchange("VNRRG,05");
    unsigned value = 0;
    const auto [end, error] =
        std::from_chars(baud.values.data(), baud.values.data() + baud.values.size(), value);
    if (!baud.error && error == std::errc{} && value > 0)
      link_bytes_per_s_ = static_cast<double>(value) / kBitsPerByte;
  }
  const double divisor = std::max(1.0, std::round(imu_rate_hz_ / settings_.rate_hz));
  return AccelerometerInfo{
      .maker = "VectorNav",
      .model = model,
      .serial_number = serial_number,
      .firmware = firmware,
      .output_unit = "m/s2",
      .full_scale = settings_.full_scale,  // The device does not say.
      .resolution = std::nullopt,
      .rate_hz = rate_hz_ > 0.0 ? rate_hz_ : imu_rate_hz_ / divisor,
  };
}

void VectorNavAccelerometer::check_rate(double rate_hz, std::string_view possible) const {
  if (std::abs(rate_hz - settings_.rate_hz) <= kRateTolerance * settings_.rate_hz) return;
  fail(Fault::kRefused, fmt::format("rate_hz is {}; it makes {}, the nearest is {:.6g}", settings_.rate_hz,
                                    possible, rate_hz));
}

void VectorNavAccelerometer::check_link(double rate_hz, std::size_t message_bytes) const {
  const double needed = rate_hz * static_cast<double>(message_bytes);
  if (!link_bytes_per_s_ || needed <= *link_bytes_per_s_) return;
  fail(
      Fault::kRefused,
      fmt::format(
          "{:.6g} readings a second need {:.0f} bytes/s, the link carries {:.0f}: lower rate_hz to {:.0f} or "
          "less, or raise the baud rate of the device",
          rate_hz, needed, *link_bytes_per_s_,
          std::floor(*link_bytes_per_s_ / static_cast<double>(message_bytes))));
}

/// Configures binary output 1; false if the firmware has none.
bool VectorNavAccelerometer::try_binary_output() {
  const double divisor = std::clamp(std::round(imu_rate_hz_ / settings_.rate_hz), 1.0, 65535.0);
  const double rate_hz = imu_rate_hz_ / divisor;
  const std::size_t bytes = *vectornav::binary_size(kOutputFields);
  check_rate(rate_hz, fmt::format("{} readings a second divided by a whole number", imu_rate_hz_));
  check_link(rate_hz, bytes);
  // Mode 3, as the vendor's library sends it: both ports of the device, whichever this is.
  const std::string command = fmt::format("VNWRG,75,3,{},05,{:04X},{:04X}", divisor,
                                          kOutputFields[vectornav::kCommon], kOutputFields[vectornav::kImu]);
  const Answer answer = try_exchange(command);
  if (answer.error) {
    const bool has_none = *answer.error == kInvalidCommand || *answer.error == kInvalidParameter ||
                          *answer.error == kInvalidRegister;
    if (!has_none) refuse(command, *answer.error);
    return false;
  }
  for (const int other : {76, 77}) {
    // Off, as they would share the line. A device without them refuses, and has nothing to switch off.
    try_exchange(fmt::format("VNWRG,{},0,{},01,0001", other, divisor));
  }
  output_ = Output::kBinary;
  rate_hz_ = rate_hz;
  message_bytes_ = bytes;
  return true;
}

/// Configures the text output IMU, which has the temperature; ACC if the link is too slow for it, or there is
/// none.
void VectorNavAccelerometer::set_text_output() {
  const double rate_hz = *std::min_element(kTextRates.begin(), kTextRates.end(), [&](double a, double b) {
    return std::abs(a - settings_.rate_hz) < std::abs(b - settings_.rate_hz);
  });
  check_rate(rate_hz, "1, 2, 4, 5, 10, 20, 25, 40, 50, 100 or 200 readings a second (no binary output)");
  check_link(rate_hz, kAccelerationTextBytes);
  exchange(fmt::format("VNWRG,07,{}", rate_hz));
  rate_hz_ = rate_hz;
  output_ = Output::kImuText;
  message_bytes_ = kImuTextBytes;
  if (!link_bytes_per_s_ || rate_hz * kImuTextBytes <= *link_bytes_per_s_) {
    const Answer answer = try_exchange("VNWRG,06,19");
    if (!answer.error) return;
    if (*answer.error != kInvalidParameter) refuse("VNWRG,06,19", *answer.error);
  }
  output_ = Output::kAccelerationText;
  message_bytes_ = kAccelerationTextBytes;
  exchange("VNWRG,06,11");
}

// Data.

/// Ends the counting of a stream; its figures remain.
void VectorNavAccelerometer::end_stream() noexcept {
  if (!started_) return;
  const StreamHealth figures = health();
  bad_frames_at_end_ = figures.bad_frames;
  skipped_bytes_at_end_ = figures.skipped_bytes;
  started_ = false;
  readings_.close();
}

void VectorNavAccelerometer::receive(const wire::ReceivedBytes& received) {
  last_arrival_ = received.arrival;
  parser_.feed(received.bytes);
  while (const auto message = parser_.next()) take_message(*message);
}

void VectorNavAccelerometer::take_message(const Message& message) {
  std::optional<vectornav::Measurement> measurement;
  if (const auto* text = std::get_if<TextMessage>(&message)) {
    if (const auto error = error_code(text->text)) {
      end_stream();
      fail(Fault::kRefused, fmt::format("error {:02X} ({}) while it streams {:.6g} readings a second", *error,
                                        vectornav::error_in_words(*error), rate_hz_));
    }
    const std::string_view expected = output_ == Output::kImuText ? "VNIMU," : "VNACC,";
    if (output_ == Output::kBinary || !text->text.starts_with(expected))
      return;  // Late answers, other messages.
    measurement = vectornav::decode_text_measurement(text->text);
    message_bytes_ = text->text.size() + (text->checksum == vectornav::Checksum::kXor8 ? 6 : 8);
  } else {
    if (output_ != Output::kBinary) return;
    measurement = vectornav::decode_binary_measurement(std::get<BinaryMessage>(message));
  }
  if (!measurement) {
    ++malformed_;
    return;
  }
  const std::uint64_t steps = steps_since_last_reading(measurement->time_startup_ns);
  readings_.push(Reading{.output = measurement->acceleration_mps2,
                         .arrival = last_arrival_,
                         .temperature_degc = measurement->temperature_degc},
                 steps);
}

/// How many readings the device has made since the last one received: 1 if none was lost.
std::uint64_t VectorNavAccelerometer::steps_since_last_reading(std::optional<std::uint64_t> time_startup_ns) {
  const auto last_time_ns = std::exchange(last_time_ns_, time_startup_ns);
  const std::uint64_t unframed = unframed_bytes();
  const std::uint64_t unframed_since = unframed - std::exchange(unframed_at_last_reading_, unframed);
  if (!readings_.has_any_come()) return 1;
  if (time_startup_ns && last_time_ns) {
    if (*time_startup_ns <= *last_time_ns) {
      end_stream();
      fail(Fault::kNotReady,
           fmt::format("its time went from {} ns to {} ns: it was restarted and has lost its settings",
                       *last_time_ns, *time_startup_ns));
    }
    const double period_s = 1e-9 * static_cast<double>(*time_startup_ns - *last_time_ns);
    check_period(period_s);
    return static_cast<std::uint64_t>(std::max(1.0, std::round(period_s * rate_hz_)));
  }
  // No clock: every stretch of lost or damaged bytes as long as a message was a reading.
  return 1 + static_cast<std::uint64_t>(
                 std::round(static_cast<double>(unframed_since) / static_cast<double>(message_bytes_)));
}

/// A wrong belief about the device's IMU rate would make every gap a wrong count: the first periods must be
/// as configured. The shortest of eight: gaps make some longer.
void VectorNavAccelerometer::check_period(double period_s) {
  constexpr unsigned kPeriods = 8;
  constexpr double kTolerance =
      0.2;  // One tick of 800 Hz in the shortest division that can be mistaken for another.
  if (periods_seen_ >= kPeriods) return;
  shortest_period_s_ = periods_seen_ == 0 ? period_s : std::min(shortest_period_s_, period_s);
  if (++periods_seen_ < kPeriods || std::abs(shortest_period_s_ * rate_hz_ - 1.0) <= kTolerance) return;
  end_stream();
  fail(Fault::kImplausible,
       fmt::format("its time stamps are {:.6g} s apart, {:.6g} s were configured: is its IMU rate not {} Hz?",
                   shortest_period_s_, 1.0 / rate_hz_, imu_rate_hz_));
}

/// Bytes since start() that came to no use. Those the parser still holds back are not among them.
std::uint64_t VectorNavAccelerometer::unframed_bytes() const {
  return parser_.skipped_bytes() + malformed_ * message_bytes_ +
         (stream_->dropped_bytes() - dropped_at_start_);
}

}  // namespace abcal
