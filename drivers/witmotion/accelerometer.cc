#include "drivers/witmotion/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using witmotion::Frame;
using witmotion::FrameParser;

// A device answers within milliseconds, between the frames that it streams [unverified against a device].
constexpr seconds kAnswerTime{1};
// Long enough for a device that streams once in 5 s, the slowest stored setting.
constexpr seconds kFirstFrameTime{6};
// [unverified against a device] The maker's own library waits a millisecond between unlock and write; more
// than enough at 9600 baud.
constexpr milliseconds kBetweenCommands{10};

// The accuracy of its clock is not specified; its rates, and the rate that a slow line carries, differ by
// more than this.
constexpr double kMeasuredRateTolerance = 0.1;
constexpr double kBitsPerByte = 10.0;  // On a UART, with start and stop bit.

// Writing its memory [unverified against a device].
constexpr milliseconds kSaveTime{500};

constexpr std::string_view kUnknown = "unknown";
const std::string kOffsets = "acceleration offsets (05-07)";

double offset_g(std::uint16_t word) {
  return static_cast<std::int16_t>(word) * witmotion::kOffsetStepG;
}

std::string offsets_text(const Eigen::Vector3d& offset_g) {
  return fmt::format("{:.4f}, {:.4f}, {:.4f} g", offset_g[0], offset_g[1], offset_g[2]);
}

}  // namespace

WitMotionAccelerometer::WitMotionAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                               const AccelerometerSettings& settings)
    : stream_(stream ? std::move(stream) : throw std::invalid_argument("WitMotionAccelerometer: no stream")),
      clock_(clock),
      settings_(settings),
      instrument_(fmt::format("accelerometer witmotion on {}", stream_->name())),
      readings_(*stream_, FrameParser(),
                [this](const Frame& frame) { return wire::DecodedFrame{.reading = take(frame)}; }) {
  if (!(settings_.rate_hz > 0.0) || !std::isfinite(settings_.rate_hz)) {
    throw std::invalid_argument(
        fmt::format("WitMotionAccelerometer: rate_hz is {}; required: a positive number", settings_.rate_hz));
  }
}

AccelerometerInfo WitMotionAccelerometer::identify() {
  return interrogate();
}

void WitMotionAccelerometer::start() {
  const auto rate_code = witmotion::rate_code(settings_.rate_hz);
  if (!rate_code) {
    fail(Fault::kRefused, fmt::format("rate_hz is {}; the device supports 1, 2, 5, 10, 20, 50, 100 or 200 "
                                      "readings per second; the nearest is {}",
                                      settings_.rate_hz, witmotion::nearest_rate_hz(settings_.rate_hz)));
  }
  interrogate();
  check_link();
  configure_output(*rate_code);
}

std::optional<Reading> WitMotionAccelerometer::next(Clock::Instant deadline) {
  if (!readings_.running()) fail(Fault::kNotReady, "asked for a reading before it was started");
  return readings_.next(deadline);
}

void WitMotionAccelerometer::discard_pending() {
  if (readings_.running()) readings_.discard_pending(clock_.now());
}

void WitMotionAccelerometer::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(instrument_, fault, detail);
}

void WitMotionAccelerometer::fail_without_frames(Clock::Duration waited) const {
  const std::string heard =
      fmt::format("{} bytes arrived within {:.1f} s", readings_.received_bytes(), to_seconds(waited));
  if (readings_.received_bytes() == 0) {
    fail(Fault::kNoReply, fmt::format("not one byte arrived within {:.1f} s: is it switched on, and is the "
                                      "baud rate that of the device?",
                                      to_seconds(waited)));
  }
  const std::uint64_t bad = readings_.parser().bad_frames();
  if (2 * (frames_ + bad) * witmotion::kFrameBytes >= readings_.received_bytes()) {
    fail(Fault::kBadFrame,
         fmt::format("{} with {} WitMotion frames, {} of them with a wrong sum", heard, frames_ + bad, bad));
  }
  fail(Fault::kWrongIdentity, fmt::format("{} with {} WitMotion frames, beginning {}: another instrument is "
                                          "on this port, or the baud rate is wrong",
                                          heard, frames_, wire::bytes_in_hex(readings_.first_bytes())));
}

AccelerometerInfo WitMotionAccelerometer::interrogate() {
  only_acceleration_ = false;
  frames_ = 0;
  readings_.listen(FrameParser());
  stream_->discard_input();

  const Clock::Instant began = clock_.now();
  const auto version = ask(witmotion::kVersion);
  const auto range = ask(witmotion::kAccelerationRange);
  const auto output = ask(witmotion::kOutputMask);  // And, behind it, rate and baud rate.
  // Silent to questions: it may stream slowly.
  while (readings_.received_bytes() == 0 && readings_.receive(began + kFirstFrameTime)) continue;
  // On a line with other data a single frame may be accidental.
  if (frames_ == 0 || 2 * frames_ * witmotion::kFrameBytes < readings_.received_bytes())
    fail_without_frames(clock_.now() - began);

  if (version) version_ = version->front();
  if (output && !found_output_) found_output_ = output;
  link_bytes_per_s_ = settings_.link_bytes_per_s;
  if (!link_bytes_per_s_ && output) {
    if (const auto baud = witmotion::baud_rate((*output)[witmotion::kBaud - witmotion::kOutputMask]))
      link_bytes_per_s_ = *baud / kBitsPerByte;
  }
  double full_scale = settings_.full_scale.value_or(witmotion::kFormatFullScaleG);
  if (range) full_scale = std::min(full_scale, witmotion::range_g(range->front()).value_or(full_scale));
  return AccelerometerInfo{
      .maker = "WitMotion",
      .model = std::string(kUnknown),  // The device does not report it.
      .serial_number = "",             // The device does not report it, either.
      .firmware = version_ ? fmt::format("{}", *version_) : std::string(kUnknown),
      .output_unit = "g",
      .full_scale = std::min(full_scale, witmotion::kFormatFullScaleG),
      .resolution = witmotion::kStepG,
      .rate_hz = witmotion::nearest_rate_hz(settings_.rate_hz),
  };
}

/// Asks for four registers; absent if it does not answer, as is usual for cheap models. An answer does not
/// name its question. So once a question has had no answer, only that question is repeated: an answer to any
/// other might be a late one to it.
std::optional<WitMotionAccelerometer::Registers> WitMotionAccelerometer::ask(witmotion::Register first) {
  constexpr int kTries = 2;
  if (answers_doubtful_) return std::nullopt;
  answer_.reset();
  for (int tries = 0; tries < kTries && !answer_; ++tries) {
    stream_->write(witmotion::read_registers(first));
    const Clock::Instant deadline = clock_.now() + kAnswerTime;
    // The stream may never pause.
    while (!answer_ && readings_.receive(deadline) && clock_.now() < deadline) continue;
    if (!answer_) answers_doubtful_ = true;
  }
  return answer_;
}

std::map<std::string, std::string> WitMotionAccelerometer::correction_registers() {
  const auto answer = ask(witmotion::kAccelerationOffset);
  if (!answer) return {};
  return {{kOffsets, offsets_text({offset_g((*answer)[0]), offset_g((*answer)[1]), offset_g((*answer)[2])})}};
}

CorrectionAbility WitMotionAccelerometer::ability() {
  if (answers_doubtful_)
    fail(Fault::kRefused,
         "it answers no question, so that its registers cannot be read back; required: a model that answers");
  return {.shape = CorrectionShape::kOffset,
          .rule = "output = a - offset, registers 05 to 07: 16 bits in 0.0001 g",
          .offset_step = witmotion::kOffsetStepG};
}

OutputCorrection WitMotionAccelerometer::decode(const RegisterTexts& registers) {
  const std::vector<double> offset = register_numbers(registers, kOffsets, 3);
  return {Eigen::Matrix3d::Identity(), Eigen::Map<const Eigen::Vector3d>(offset.data())};
}

RegisterTexts WitMotionAccelerometer::encode(const OutputCorrection& wanted, const RegisterTexts& now) {
  constexpr double kLargestG = 32767.0 * witmotion::kOffsetStepG;
  for (const double value : wanted.offset)
    if (!(std::abs(value) <= kLargestG))
      throw std::invalid_argument(
          fmt::format("{}: an offset would be {:.4g} g; they hold up to {} g", kOffsets, value, kLargestG));
  RegisterTexts registers = now;
  registers[kOffsets] = offsets_text(wanted.offset);
  return registers;
}

void WitMotionAccelerometer::send(witmotion::Register where, std::uint16_t value) {
  stream_->write(witmotion::write_register(where, value));
  clock_.sleep_until(clock_.now() + kBetweenCommands);
}

void WitMotionAccelerometer::write(const RegisterTexts& registers) {
  send(witmotion::kLock, witmotion::kUnlock);
  unsigned where = witmotion::kAccelerationOffset;
  for (const double value : register_numbers(registers, kOffsets, 3)) {
    const auto word = static_cast<std::int16_t>(std::lround(value / witmotion::kOffsetStepG));
    send(static_cast<witmotion::Register>(where++), static_cast<std::uint16_t>(word));
  }
}

void WitMotionAccelerometer::save(const RegisterTexts& registers) {
  if (!found_output_)
    fail(Fault::kRefused,
         "it has not said which output and rate are set, and saving stores all settings; required: a model "
         "that answers");
  write(registers);
  send(witmotion::kOutputMask, (*found_output_)[0]);
  send(witmotion::kRate, (*found_output_)[1]);
  send(witmotion::kSave, 0);
  clock_.sleep_until(clock_.now() + kSaveTime);
}

void WitMotionAccelerometer::check_link() const {
  const double needed = settings_.rate_hz * static_cast<double>(witmotion::kFrameBytes);
  if (!link_bytes_per_s_ || needed <= *link_bytes_per_s_) return;
  fail(Fault::kRefused,
       fmt::format("{:.6g} readings per second need {:.0f} bytes/s, but the link carries {:.0f}: lower "
                   "rate_hz to {:.0f} or less, or raise the baud rate of the device",
                   settings_.rate_hz, needed, *link_bytes_per_s_,
                   std::floor(*link_bytes_per_s_ / static_cast<double>(witmotion::kFrameBytes))));
}

/// Sets output and rate, and verifies both. Commands are not acknowledged: a lost one shows in the rate, and
/// is sent again.
void WitMotionAccelerometer::configure_output(std::uint16_t rate_code) {
  constexpr int kTries = 3;
  const Clock::Duration span = from_seconds(std::max(1.0, 2.0 / settings_.rate_hz));
  std::optional<double> measured_hz;
  for (int tries = 0; tries < kTries; ++tries) {
    for (const std::string& command :
         {witmotion::write_register(witmotion::kLock, witmotion::kUnlock),
          witmotion::write_register(witmotion::kOutputMask, witmotion::kAccelerationOnly),
          witmotion::write_register(witmotion::kRate, rate_code)}) {
      stream_->write(command);
      clock_.sleep_until(clock_.now() + kBetweenCommands);
    }
    readings_.listen(FrameParser());
    stream_->discard_input();
    other_frames_ = 0;
    measured_hz = readings_.measure_rate_hz(span, clock_.now() + 2 * span + kAnswerTime);
    if (!measured_hz || std::abs(*measured_hz / settings_.rate_hz - 1.0) > kMeasuredRateTolerance) continue;
    only_acceleration_ = other_frames_ == 0;
    readings_.start();
    return;
  }
  if (!measured_hz)
    fail(Fault::kNoReply,
         fmt::format("no readings arrived after its rate was set to {:.6g} per second", settings_.rate_hz));
  fail(Fault::kImplausible,
       fmt::format(
           "rate_hz is {:.6g} and its rate was set to this (register 03 = {:02X}), but {:.3g} readings per "
           "second arrived: set rate_hz to that rate if the device has no other, or raise its baud rate",
           settings_.rate_hz, rate_code, *measured_hz));
}

std::optional<Reading> WitMotionAccelerometer::take(const Frame& frame) {
  constexpr std::uint64_t kNoChance = 2;  // A single frame may be made of damaged ones.
  ++frames_;
  if (frame.type == witmotion::kRegisters) {
    answer_ = frame.words;
    return std::nullopt;
  }
  if (const auto acceleration = witmotion::decode_acceleration(frame)) {
    Reading reading;
    reading.output = acceleration->output_g;
    reading.temperature_degc = acceleration->temperature_degc;
    reading.over_range = acceleration->clipped;
    return reading;
  }
  if (frame.type == witmotion::kAngle) version_ = frame.words[3];
  if (++other_frames_ >= kNoChance && only_acceleration_) {
    readings_.end();
    fail(Fault::kNotReady,
         fmt::format("it sends frames of type {:02X} again: it was restarted and has lost its settings",
                     frame.type));
  }
  return std::nullopt;
}

}  // namespace abcal
