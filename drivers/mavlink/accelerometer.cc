#include "drivers/mavlink/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using mavlink::Frame;
using Exchange = wire::PacketExchange<mavlink::FrameParser>;

/// A heartbeat is sent once a second.
constexpr std::chrono::milliseconds kAnswerTime{1500};
constexpr std::uint64_t kHeartbeatLostMicroseconds = 5'000'000;
/// Bytes of a HIGHRES_IMU, version 2; other messages may share the link.
constexpr double kMessageBytes = 75.0;
constexpr double kScaledResolution = 9.80665e-3;  // m/s2

/// Names of the parameters that correct the first accelerometer, and of those that turn its axes.
struct ParameterNames {
  std::array<std::string, 3> offset, scale;
  std::vector<std::string> rotations;  ///< 0: none; -1 for an accelerometer: the rotation of the board.
  std::string identity;  ///< Parameter that identifies the sensor they belong to; empty: the first sensor.
};

const ParameterNames* names_of(std::uint8_t autopilot) {
  static const ParameterNames px4{{"CAL_ACC0_XOFF", "CAL_ACC0_YOFF", "CAL_ACC0_ZOFF"},
                                  {"CAL_ACC0_XSCALE", "CAL_ACC0_YSCALE", "CAL_ACC0_ZSCALE"},
                                  {"CAL_ACC0_ROT", "SENS_BOARD_ROT"},
                                  "CAL_ACC0_ID"};
  static const ParameterNames ardupilot{{"INS_ACCOFFS_X", "INS_ACCOFFS_Y", "INS_ACCOFFS_Z"},
                                        {"INS_ACCSCAL_X", "INS_ACCSCAL_Y", "INS_ACCSCAL_Z"},
                                        {"AHRS_ORIENTATION"},
                                        ""};
  if (autopilot == mavlink::kPx4) return &px4;
  return autopilot == mavlink::kArduPilot ? &ardupilot : nullptr;
}

/// Limits within which ArduPilot accepts a scale (AP_InertialSensor, accel_cal); PX4 has no such limits.
constexpr double kLeastScale = 0.8;
constexpr double kMostScale = 1.2;
constexpr double kFloatStep = 1.2e-7;        // Resolution of a float near a scale of 1.
constexpr double kLargestOffsetMps2 = 20.0;  // Beyond it the accelerometer is broken.

std::string float_text(double value) {
  return fmt::format("{:.9g}", value);
}

/// The controller's acknowledgement of a command, from any of its components.
std::optional<wire::PacketAnswer> acknowledgement_of(const Frame& frame, std::uint16_t command) {
  constexpr unsigned kInProgress = 5;
  const auto said = mavlink::decode_acknowledgement(frame);
  if (!said || said->command != command || said->result == kInProgress) return std::nullopt;
  if (said->result == 0) return wire::PacketAnswer{{}, std::nullopt};
  return wire::PacketAnswer{{}, said->result};
}

/// Always answered, if only with "not supported", and asked for nothing else.
Exchange::Command barrier() {
  return {mavlink::command_long(0, 0, mavlink::kGetMessageInterval, {0.0F, 0.0F}),
          "\"message interval\" (510)", [](const Frame& frame) -> std::optional<wire::PacketAnswer> {
            if (!acknowledgement_of(frame, mavlink::kGetMessageInterval)) return std::nullopt;
            return wire::PacketAnswer{};
          }};
}

Exchange::Manner manner() {
  return {.packet = "MAVLink frame",
          .damaged = "with a wrong checksum",
          .show = wire::bytes_in_hex,
          .answer_time = kAnswerTime,
          .barrier = barrier()};
}

}  // namespace

MavlinkAccelerometer::MavlinkAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                           const AccelerometerSettings& settings)
    : PacketAccelerometer("mavlink", std::move(stream), clock, settings, manner()) {}

/// An error in an acknowledgement names its command, but not which of two like it.
MavlinkAccelerometer::Command MavlinkAccelerometer::command(std::uint16_t number, float first, float second,
                                                            std::string_view name) const {
  return {mavlink::command_long(system_, component_, number, {first, second}),
          fmt::format("\"{}\" ({})", name, number), [this, number](const Frame& frame) {
            return frame.system == system_ ? acknowledgement_of(frame, number) : std::nullopt;
          }};
}

/// The next one of the controller. It sends its heartbeat without a request; some begin once they have
/// received one.
mavlink::Heartbeat MavlinkAccelerometer::await_heartbeat() {
  mavlink::Heartbeat found;
  exchange_.ask({mavlink::our_heartbeat(), "a heartbeat",
                 [this, &found](const Frame& frame) -> std::optional<wire::PacketAnswer> {
                   const auto heartbeat = mavlink::decode_heartbeat(frame);
                   if (!heartbeat || !heartbeat->is_vehicle()) return std::nullopt;
                   system_ = frame.system;
                   component_ = frame.component;
                   found = *heartbeat;
                   return wire::PacketAnswer{};
                 }});
  return found;
}

AccelerometerInfo MavlinkAccelerometer::interrogate() {
  exchange_.restart(mavlink::FrameParser());
  autopilot_ = await_heartbeat().autopilot;
  mavlink::Version version;
  Command ask_version = command(mavlink::kRequestMessage, static_cast<float>(mavlink::kAutopilotVersion),
                                0.0F, "request autopilot version");
  ask_version.match = [this, &version](const Frame& frame) -> std::optional<wire::PacketAnswer> {
    if (frame.system != system_) return std::nullopt;
    if (const auto told = mavlink::decode_version(frame)) {
      version = *told;
      return wire::PacketAnswer{};
    }
    // Accepted: the message itself follows.
    const auto said = acknowledgement_of(frame, mavlink::kRequestMessage);
    return said && said->error ? said : std::nullopt;
  };
  exchange_.ask(ask_version);  // An old one does not know it: then it has no serial number.
  const std::string model = mavlink::autopilot_name(autopilot_);
  name_it(model, version.serial_number);
  return AccelerometerInfo{
      .maker = "MAVLink",
      .model = model,
      .serial_number = version.serial_number,
      .firmware = version.firmware,
      .output_unit = "m/s2",
      .full_scale = settings_.full_scale,  // It does not report it.
      .resolution = message_ == mavlink::kScaledImu ? std::optional(kScaledResolution) : std::nullopt,
      .rate_hz = settings_.rate_hz,
  };
}

// Parameters.

mavlink::Parameter MavlinkAccelerometer::ask_parameter(const std::string& name, const std::string& bytes,
                                                       std::string_view verb) {
  mavlink::Parameter told;
  exchange_.ask({bytes, fmt::format("\"{} parameter {}\"", verb, name),
                 [&](const Frame& frame) -> std::optional<wire::PacketAnswer> {
                   if (frame.system != system_) return std::nullopt;
                   auto parameter = mavlink::decode_parameter(frame, autopilot_);
                   if (!parameter || parameter->name != name) return std::nullopt;
                   told = *std::move(parameter);
                   return wire::PacketAnswer{};
                 }});
  return told;
}

std::map<std::string, std::string> MavlinkAccelerometer::correction_registers() {
  const ParameterNames* names = names_of(autopilot_);
  if (names == nullptr) return {};
  std::map<std::string, std::string> registers;
  const auto read = [&](const std::string& name) {
    registers[name] =
        float_text(ask_parameter(name, mavlink::param_request_read(system_, component_, name), "read").value);
  };
  try {
    read(names->offset[0]);
  } catch (const InstrumentError& error) {
    // It does not answer if it lacks the parameter, or reports no parameters at all.
    if (error.fault() == Fault::kNoReply) return {};
    throw;
  }
  for (std::size_t j = 0; j < 3; ++j) {
    if (j > 0) read(names->offset[j]);
    read(names->scale[j]);
  }
  for (const std::string& rotation : names->rotations) read(rotation);
  if (!names->identity.empty()) read(names->identity);
  return registers;
}

CorrectionAbility MavlinkAccelerometer::ability() {
  const ParameterNames* names = names_of(autopilot_);
  if (names == nullptr)
    fail(Fault::kRefused,
         fmt::format("its autopilot is {}; required: PX4 or ArduPilot, whose parameters are known",
                     mavlink::autopilot_name(autopilot_)));
  return {.shape = CorrectionShape::kDiagonal,
          .rule = fmt::format("output = (a - {}) {}, and so for Y and Z: floats, offsets in m/s2",
                              names->offset[0], names->scale[0]),
          .offset_step = kFloatStep,
          .matrix_step = kFloatStep,
          .keeps_at_once = true};
}

OutputCorrection MavlinkAccelerometer::decode(const RegisterTexts& registers) {
  const ParameterNames* names = names_of(autopilot_);
  if (names == nullptr) throw std::invalid_argument("parameters of an autopilot that is not known");
  for (const std::string& rotation : names->rotations) {
    const double value = register_number(registers, rotation);
    if (value > 0.0)
      throw std::invalid_argument(
          fmt::format("{} is {:g}, so that the axes of the output are not those of the accelerometer; "
                      "required: 0. Set it, calibrate, and set it back afterwards",
                      rotation, value));
  }
  if (!names->identity.empty() && register_number(registers, names->identity) == 0.0)
    throw std::invalid_argument(
        fmt::format("{} is 0: these parameters are for no accelerometer yet; required: one calibration by "
                    "the autopilot itself, which enters it",
                    names->identity));
  OutputCorrection correction;
  for (std::size_t n = 0; n < 3; ++n) {
    const auto j = static_cast<Eigen::Index>(n);
    correction.offset[j] = register_number(registers, names->offset[n]);
    correction.matrix(j, j) = register_number(registers, names->scale[n]);
    if (!(correction.matrix(j, j) > 0.0))
      throw std::invalid_argument(
          fmt::format("{} is {}; required: above 0", names->scale[n], registers.at(names->scale[n])));
  }
  return correction;
}

RegisterTexts MavlinkAccelerometer::encode(const OutputCorrection& wanted, const RegisterTexts& now) {
  const ParameterNames* names = names_of(autopilot_);
  if (names == nullptr) throw std::invalid_argument("parameters of an autopilot that is not known");
  RegisterTexts registers = now;
  for (std::size_t n = 0; n < 3; ++n) {
    const auto j = static_cast<Eigen::Index>(n);
    const double scale = wanted.matrix(j, j);
    const double offset = wanted.offset[j];
    if (!(scale >= kLeastScale && scale <= kMostScale))
      throw std::invalid_argument(fmt::format("{} would be {:.6g}; required: {} to {}", names->scale[n],
                                              scale, kLeastScale, kMostScale));
    if (!(std::abs(offset) <= kLargestOffsetMps2))
      throw std::invalid_argument(fmt::format("{} would be {:.6g} m/s2; required: {} at most",
                                              names->offset[n], offset, kLargestOffsetMps2));
    registers[names->offset[n]] = float_text(static_cast<double>(static_cast<float>(offset)));
    registers[names->scale[n]] = float_text(static_cast<double>(static_cast<float>(scale)));
  }
  return registers;
}

void MavlinkAccelerometer::require_writable() {
  if (!await_heartbeat().is_armed()) return;
  fail(Fault::kRefused, "the vehicle is armed (heartbeat, base mode); required: disarmed, propellers off");
}

void MavlinkAccelerometer::write(const RegisterTexts& registers) {
  const ParameterNames* names = names_of(autopilot_);
  require_writable();
  for (std::size_t j = 0; names != nullptr && j < 3; ++j) {
    for (const std::string& name : {names->offset[j], names->scale[j]}) {
      const auto value = static_cast<float>(register_number(registers, name));
      const double told =
          ask_parameter(name, mavlink::param_set(system_, component_, name, value), "set").value;
      if (static_cast<float>(told) == value) continue;
      fail(Fault::kRefused, fmt::format("{} was set to {:.9g} and is {:.9g}", name, value, told));
    }
  }
}

/// @return the result if it is not accepted
std::optional<unsigned> MavlinkAccelerometer::set_interval(std::uint32_t message, double interval_us) {
  return exchange_
      .ask(command(mavlink::kSetMessageInterval, static_cast<float>(message), static_cast<float>(interval_us),
                   "set message interval"))
      .error;
}

void MavlinkAccelerometer::start() {
  message_ = mavlink::kHighresImu;
  interrogate();
  interval_us_ = std::round(1e6 / settings_.rate_hz);
  check_link(settings_.rate_hz, settings_.rate_hz * kMessageBytes, settings_.link_bytes_per_s,
             settings_.link_bytes_per_s.value_or(0.0) / kMessageBytes);
  // A float holds whole microseconds up to 16 s.
  auto refused = set_interval(mavlink::kHighresImu, interval_us_);
  if (refused) {
    message_ = mavlink::kScaledImu;
    refused = set_interval(mavlink::kScaledImu, interval_us_);
  }
  if (refused) {
    fail(Fault::kRefused, fmt::format("it sends neither HIGHRES_IMU nor SCALED_IMU {:.6g} times a second: "
                                      "\"set message interval\" (511) was answered {} ({})",
                                      settings_.rate_hz, *refused, mavlink::result_in_words(*refused)));
  }
  asked_for_ = true;
  readings_.listen(mavlink::FrameParser());
  last_sequence_.reset();
  last_time_us_.reset();
  gap_ = false;
  heartbeat_time_us_.reset();
  readings_.start();
}

void MavlinkAccelerometer::make_quiet() {
  exchange_.restart(mavlink::FrameParser());
  if (!std::exchange(asked_for_, false)) return;
  // Restores its own rate; the answer is not awaited.
  stream_->write(mavlink::command_long(system_, component_, mavlink::kSetMessageInterval,
                                       {static_cast<float>(message_), 0.0F}));
}

// Data.

wire::DecodedFrame MavlinkAccelerometer::decode(const Frame& frame) {
  if (frame.system != system_ || frame.component != component_) return {};
  const auto last = std::exchange(last_sequence_, frame.sequence);
  if (last && static_cast<std::uint8_t>(frame.sequence - *last) != 1) gap_ = true;
  if (mavlink::decode_heartbeat(frame)) {
    heartbeat_time_us_ = last_time_us_;
    return {};
  }
  if (frame.id != message_) return {};
  const auto acceleration = mavlink::decode_acceleration(frame);
  if (!acceleration) return {};
  return decode_acceleration(*acceleration);
}

wire::DecodedFrame MavlinkAccelerometer::decode_acceleration(const mavlink::Acceleration& acceleration) {
  const auto last = std::exchange(last_time_us_, acceleration.time_us);
  std::uint64_t steps = 1;
  if (last) {
    std::uint64_t now = acceleration.time_us;
    // A time of 32 bits in milliseconds begins again after 50 days.
    const bool wrapped = acceleration.time_span_us != 0 && now + acceleration.time_span_us / 2 < *last;
    if (wrapped) now += acceleration.time_span_us;
    if (now == *last) return {.malformed = true};  // A repeated message is not a second reading.
    if (now < *last)
      end_and_fail(Fault::kNotReady, fmt::format("its time went back from {} to {} us: it was restarted",
                                                 *last, acceleration.time_us));
    // Only where messages are missing: the controller's times are not evenly spaced.
    if (gap_) {
      const double passed = std::round(static_cast<double>(now - *last) / interval_us_);
      steps = static_cast<std::uint64_t>(std::max(1.0, passed));
    }
  }
  gap_ = false;
  // The message's own time is used, because messages that waited on the line have no meaningful time of
  // arrival.
  if (!heartbeat_time_us_ || *heartbeat_time_us_ > acceleration.time_us)
    heartbeat_time_us_ = acceleration.time_us;
  if (const std::uint64_t since = acceleration.time_us - *heartbeat_time_us_;
      since > kHeartbeatLostMicroseconds)
    end_and_fail(Fault::kNotReady, fmt::format("no heartbeat for {:.1f} s, although readings come: the "
                                               "autopilot hangs, or another program sends them",
                                               static_cast<double>(since) / 1e6));
  Reading reading;
  reading.output = acceleration.output_mps2;
  reading.temperature_degc = acceleration.temperature_degc;
  reading.over_range = acceleration.clipped;
  return {.reading = std::move(reading), .steps = steps};
}

}  // namespace abcal
