#include "drivers/vectornav/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::seconds;
using vectornav::BinaryMessage;
using vectornav::TextMessage;

// A device answers within milliseconds; its output buffer, full at 9600 baud, takes 1 s to empty [unverified
// against a device].
constexpr seconds kAnswerTime{2};
// Longest duration of a restart [unverified against a device].
constexpr seconds kRestartTime{2};

constexpr double kRateTolerance = 0.01;
constexpr unsigned kBitsPerByte = 10;  // On a UART, with start and stop bit.

// Rates of the text output (register 7).
constexpr std::array kTextRates{1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0};
// [unverified against a device] "$VNIMU" with 11 numbers and "$VNACC" with 3, in the widths that are seen, at
// 16 g, with a CRC.
constexpr std::size_t kImuTextBytes = 115;
constexpr std::size_t kAccelerationTextBytes = 40;

const std::string kCompensation = "acceleration compensation (25)";
const std::string kRotation = "reference frame rotation (26)";
constexpr double kCompensationStep = 1e-6;      // Resolution of its decimal text.
constexpr double kLargestCompensation = 99.99;  // Two digits before the point.

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

/// Errors that a device reports on its own account: no answer to a command.
bool is_of_no_command(unsigned error) {
  return error == 0x01 || error == 0x02 || error == 0x0A || error == 0x0B || error == 0xFF;
}

std::optional<unsigned> error_code(std::string_view text) {
  constexpr std::string_view kError = "VNERR,";
  if (!text.starts_with(kError)) return std::nullopt;
  text.remove_prefix(kError.size());
  return pieces::number<unsigned>(text, 16);
}

/// The values behind `VNxxx,n` in an answer to this command ("VNRRG,01", "VNWRG,75,1,..."); absent if it
/// answers another one. Register numbers are compared as numbers: "01" and "1" are the same.
std::optional<std::string> values_if_answer(std::string_view text, std::string_view command) {
  if (command.find(',') == std::string_view::npos)  // "VNWNV": only echoed.
    return text == command ? std::optional(std::string()) : std::nullopt;
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

/// [unverified against a device] The manuals give the IMU rate of the VN-100 as 800 Hz and that of the VN-200
/// and VN-300 as 400 Hz. Its time stamps reveal a device for which this is wrong (check_period).
unsigned imu_rate_of(std::string_view model) {
  return model.starts_with("VN-2") || model.starts_with("VN-3") ? 400U : 800U;
}

using Exchange = wire::PacketExchange<vectornav::MessageParser>;

/// An answer is recognised by its command and register.
Exchange::Command command_of(std::string_view text) {
  return {
      // With a CRC: the device then answers with one, and an XOR overlooks one damaged message in 256.
      vectornav::make_message(text, vectornav::Checksum::kCrc16), fmt::format("\"{}\"", text),
      [command = std::string(text)](const vectornav::Message& message) -> std::optional<wire::PacketAnswer> {
        const auto* said = std::get_if<TextMessage>(&message);
        if (said == nullptr) return std::nullopt;
        if (const auto error = error_code(said->text)) {
          if (is_of_no_command(*error)) return std::nullopt;
          return wire::PacketAnswer{{}, error};
        }
        auto values = values_if_answer(said->text, command);
        if (!values) return std::nullopt;
        return wire::PacketAnswer{*std::move(values), std::nullopt};
      }};
}

Exchange::Manner manner() {
  return {.packet = "VectorNav message",
          .damaged = "with a wrong checksum",
          .show = [](std::string_view bytes) { return fmt::format("\"{}\"", wire::bytes_as_text(bytes)); },
          .answer_time = kAnswerTime,
          .barrier = command_of("VNRRG,02")};
}

}  // namespace

VectorNavAccelerometer::VectorNavAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                               const AccelerometerSettings& settings)
    : PacketAccelerometer("vectornav", std::move(stream), clock, settings, manner()) {}

void VectorNavAccelerometer::start() {
  interrogate();
  exchange("VNWRG,06,0");  // No text output: its messages would share the line.
  if (!try_binary_output()) set_text_output();

  // All answers have arrived, so remaining bytes are not part of the stream that begins now.
  readings_.listen(
      vectornav::MessageParser(output_ == Output::kBinary ? vectornav::binary_header(kOutputFields) : ""));
  last_time_ns_.reset();
  periods_seen_ = 0;
  const wire::PacketAnswer resumed = try_exchange("VNASY,1");
  // A firmware without this command could not be paused either: it streams.
  if (resumed.error && *resumed.error != kInvalidCommand) refuse("VNASY,1", *resumed.error);
  readings_.start();
}

// Commands.

void VectorNavAccelerometer::refuse(std::string_view command, unsigned error) const {
  fail(Fault::kRefused,
       fmt::format("error {:02X} ({}) to \"{}\"", error, vectornav::error_in_words(error), command));
}

/// Sends a command and returns the values of its answer. @throws InstrumentError kRefused.
std::string VectorNavAccelerometer::exchange(std::string_view command) {
  wire::PacketAnswer answer = try_exchange(command);
  if (answer.error) refuse(command, *answer.error);
  return std::move(answer.data);
}

/// Sends a command, again if no answer arrives, and returns its answer or refusal.
wire::PacketAnswer VectorNavAccelerometer::try_exchange(std::string_view command) {
  return exchange_.ask(command_of(command));
}

void VectorNavAccelerometer::make_quiet() {
  exchange_.restart(vectornav::MessageParser());
  const wire::PacketAnswer answer = try_exchange("VNASY,0");
  // A firmware without this command streams on; answers are found among the data.
  if (answer.error && *answer.error != kInvalidCommand) refuse("VNASY,0", *answer.error);
}

AccelerometerInfo VectorNavAccelerometer::interrogate() {
  make_quiet();
  const std::string model = exchange("VNRRG,01");
  if (!model.starts_with("VN-")) {
    fail(Fault::kWrongIdentity, fmt::format("its model is \"{}\"; required: a name that begins with VN-",
                                            wire::bytes_as_text(model)));
  }
  const std::string serial_number = exchange("VNRRG,03");
  const std::string firmware = exchange("VNRRG,04");
  name_it(model, serial_number);
  imu_rate_hz_ = imu_rate_of(model);

  link_bytes_per_s_ = settings_.link_bytes_per_s;
  if (!link_bytes_per_s_) {
    const wire::PacketAnswer baud = try_exchange("VNRRG,05");
    unsigned value = 0;
    const auto [end, error] = std::from_chars(baud.data.data(), baud.data.data() + baud.data.size(), value);
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
      .full_scale = settings_.full_scale,  // The device does not report it.
      .resolution = std::nullopt,
      .rate_hz = rate_hz_ > 0.0 ? rate_hz_ : imu_rate_hz_ / divisor,
  };
}

std::map<std::string, std::string> VectorNavAccelerometer::correction_registers() {
  std::map<std::string, std::string> registers;
  for (const auto& [number, name] : {std::pair{25, kCompensation}, std::pair{26, kRotation}}) {
    const std::string command = fmt::format("VNRRG,{:02}", number);
    const wire::PacketAnswer answer = try_exchange(command);
    if (answer.error && *answer.error != kInvalidRegister) refuse(command, *answer.error);
    registers[name] = answer.error ? "not in this device" : answer.data;
  }
  return registers;
}

CorrectionAbility VectorNavAccelerometer::ability() {
  return {.shape = CorrectionShape::kFull,
          .rule = "output = C (a - B), register 25: C row by row, then B in m/s2",
          .offset_step = kCompensationStep,
          .matrix_step = kCompensationStep};
}

OutputCorrection VectorNavAccelerometer::decode(const RegisterTexts& registers) {
  const std::vector<double> values = register_numbers(registers, kCompensation, 12);
  // A device without register 26 has no rotation.
  const auto rotation = registers.find(kRotation);
  if (rotation != registers.end() && rotation->second != "not in this device") {
    const std::vector<double> r = register_numbers(registers, kRotation, 9);
    if (!Eigen::Map<const Eigen::Matrix3d>(r.data()).isIdentity(kCompensationStep))
      throw std::invalid_argument(
          fmt::format("{} is {}, so that the axes of the output are not those of register 25; required: the "
                      "identity. Set it, calibrate, and set it back afterwards",
                      kRotation, rotation->second));
  }
  OutputCorrection correction;
  correction.matrix = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(values.data());
  correction.offset = Eigen::Map<const Eigen::Vector3d>(values.data() + 9);
  return correction;
}

RegisterTexts VectorNavAccelerometer::encode(const OutputCorrection& wanted, const RegisterTexts& now) {
  std::string text;
  const auto add = [&text](double value) {
    if (!(std::abs(value) <= kLargestCompensation))
      throw std::invalid_argument(fmt::format("{}: a value would be {:.6g}; it holds up to {:g}",
                                              kCompensation, value, kLargestCompensation));
    text += fmt::format("{}{:+.6f}", text.empty() ? "" : ",", value);
  };
  for (Eigen::Index row = 0; row < 3; ++row)
    for (Eigen::Index column = 0; column < 3; ++column) add(wanted.matrix(row, column));
  for (Eigen::Index row = 0; row < 3; ++row) add(wanted.offset[row]);
  RegisterTexts registers = now;
  registers[kCompensation] = text;
  return registers;
}

void VectorNavAccelerometer::write(const RegisterTexts& registers) {
  std::string command = "VNWRG,25";
  for (const double value : register_numbers(registers, kCompensation, 12))
    command += fmt::format(",{:.6f}", value);
  exchange(command);
}

void VectorNavAccelerometer::save(const RegisterTexts& registers) {
  exchange("VNRST");  // Otherwise the settings of start() would be stored, too.
  clock_.sleep_until(clock_.now() + kRestartTime);
  make_quiet();
  write(registers);
  exchange("VNWNV");
}

void VectorNavAccelerometer::check_rate(double rate_hz, std::string_view possible) const {
  if (std::abs(rate_hz - settings_.rate_hz) <= kRateTolerance * settings_.rate_hz) return;
  fail(Fault::kRefused, fmt::format("rate_hz is {}; the device supports {}; the nearest is {:.6g}",
                                    settings_.rate_hz, possible, rate_hz));
}

void VectorNavAccelerometer::check_message_rate(double rate_hz, std::size_t message_bytes) const {
  const auto bytes = static_cast<double>(message_bytes);
  check_link(rate_hz, rate_hz * bytes, link_bytes_per_s_, link_bytes_per_s_.value_or(0.0) / bytes);
}

/// Configures binary output 1; false if the firmware has none.
bool VectorNavAccelerometer::try_binary_output() {
  const double divisor = std::clamp(std::round(imu_rate_hz_ / settings_.rate_hz), 1.0, 65535.0);
  const double rate_hz = imu_rate_hz_ / divisor;
  const std::size_t bytes = *vectornav::binary_size(kOutputFields);
  check_rate(rate_hz, fmt::format("{} readings per second divided by a whole number", imu_rate_hz_));
  check_message_rate(rate_hz, bytes);
  // Mode 3, as the vendor's library sends it: both ports of the device, whichever this is.
  const std::string command = fmt::format("VNWRG,75,3,{},05,{:04X},{:04X}", divisor,
                                          kOutputFields[vectornav::kCommon], kOutputFields[vectornav::kImu]);
  const wire::PacketAnswer answer = try_exchange(command);
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
  return true;
}

/// Configures the text output IMU, which has the temperature; ACC if the link is too slow for it, or there is
/// none.
void VectorNavAccelerometer::set_text_output() {
  const double rate_hz = *std::min_element(kTextRates.begin(), kTextRates.end(), [&](double a, double b) {
    return std::abs(a - settings_.rate_hz) < std::abs(b - settings_.rate_hz);
  });
  check_rate(rate_hz, "1, 2, 4, 5, 10, 20, 25, 40, 50, 100 or 200 readings per second (no binary output)");
  check_message_rate(rate_hz, kAccelerationTextBytes);
  exchange(fmt::format("VNWRG,07,{}", rate_hz));
  rate_hz_ = rate_hz;
  output_ = Output::kImuText;
  if (!link_bytes_per_s_ || rate_hz * kImuTextBytes <= *link_bytes_per_s_) {
    const wire::PacketAnswer answer = try_exchange("VNWRG,06,19");
    if (!answer.error) return;
    if (*answer.error != kInvalidParameter) refuse("VNWRG,06,19", *answer.error);
  }
  output_ = Output::kAccelerationText;
  exchange("VNWRG,06,11");
}

// Data.

wire::DecodedFrame VectorNavAccelerometer::decode(const vectornav::Message& message) {
  std::optional<vectornav::Measurement> measurement;
  if (const auto* text = std::get_if<TextMessage>(&message)) {
    if (const auto error = error_code(text->text)) {
      // A late error of a command: none is outstanding while it streams.
      if (!is_of_no_command(*error)) return {};
      end_and_fail(Fault::kRefused,
                   fmt::format("error {:02X} ({}) while it streams {:.6g} readings per second", *error,
                               vectornav::error_in_words(*error), rate_hz_));
    }
    const std::string_view expected = output_ == Output::kImuText ? "VNIMU," : "VNACC,";
    if (output_ == Output::kBinary || !text->text.starts_with(expected))
      return {};  // Late answers, other messages.
    measurement = vectornav::decode_text_measurement(text->text);
  } else {
    if (output_ != Output::kBinary) return {};
    measurement = vectornav::decode_binary_measurement(std::get<BinaryMessage>(message));
  }
  if (!measurement) return {.malformed = true};
  Reading reading;
  reading.output = measurement->acceleration_mps2;
  reading.temperature_degc = measurement->temperature_degc;
  return {.reading = reading, .steps = steps_since_last_reading(measurement->time_startup_ns)};
}

/// How many readings the device has made since the last one received, by its clock: 1 if none was lost.
std::optional<std::uint64_t> VectorNavAccelerometer::steps_since_last_reading(
    std::optional<std::uint64_t> time_startup_ns) {
  const auto last_time_ns = std::exchange(last_time_ns_, time_startup_ns);
  if (!time_startup_ns || !last_time_ns) return std::nullopt;
  if (*time_startup_ns <= *last_time_ns) {
    end_and_fail(Fault::kNotReady,
                 fmt::format("its time went from {} ns to {} ns: it was restarted and has lost its settings",
                             *last_time_ns, *time_startup_ns));
  }
  const double period_s = 1e-9 * static_cast<double>(*time_startup_ns - *last_time_ns);
  check_period(period_s);
  return static_cast<std::uint64_t>(std::max(1.0, std::round(period_s * rate_hz_)));
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
  end_and_fail(Fault::kImplausible, fmt::format("its time stamps are {:.6g} s apart, but {:.6g} s were "
                                                "configured: its IMU rate is not {} Hz; report the model",
                                                shortest_period_s_, 1.0 / rate_hz_, imu_rate_hz_));
}

}  // namespace abcal
