#include "drivers/xsens_mti/accelerometer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "drivers/text/text.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::seconds;

// A device answers within milliseconds; its output buffer, full at 9600 baud, takes 1 s to empty [unverified
// against a device].
constexpr seconds kAnswerTime{2};

constexpr double kRateTolerance = 0.01;
constexpr seconds kTemperatureHold{10};

using xbus::kFrameBytes;
constexpr std::size_t kItemHeader = 3;
// Packet counter 2, sample time 4, acceleration 3 float32, status word 4.
constexpr std::size_t kPacketBytes = kFrameBytes + 4 * kItemHeader + 2 + 4 + 12 + 4;
constexpr std::size_t kTemperatureBytes = kItemHeader + 4;  // Once a second.

constexpr std::string_view kPadding(" \0", 2);

using Exchange = wire::PacketExchange<xbus::MessageParser>;

/// An answer is recognised by its message id; an error names no command.
Exchange::Command command_of(std::uint8_t id, std::string_view data, std::string_view name) {
  return {xbus::make_message(id, data), fmt::format("\"{}\" ({:02X})", name, id),
          [id](const xbus::Message& message) -> std::optional<wire::PacketAnswer> {
            if (message.id == id + 1) return wire::PacketAnswer{std::string(message.data), std::nullopt};
            if (message.id != xbus::kError || message.data.size() != 1) return std::nullopt;
            return wire::PacketAnswer{{}, static_cast<unsigned char>(message.data.front())};
          }};
}

Exchange::Manner manner() {
  return {.packet = "Xbus message",
          .damaged = "damaged",
          .show = wire::bytes_in_hex,
          .answer_time = kAnswerTime,
          .barrier = command_of(xbus::kReqHardware, {}, "hardware version")};
}

/// Errors that a device reports only to a command: none is outstanding while it streams.
bool is_of_a_command(unsigned error) {
  return error == 0x03 || error == 0x04 || error == 0x20 || error == 0x21;
}

}  // namespace

XsensMtiAccelerometer::XsensMtiAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                             const AccelerometerSettings& settings)
    : PacketAccelerometer("xsens_mti", std::move(stream), clock, settings, manner()) {}

void XsensMtiAccelerometer::start() {
  interrogate();
  configure_output();

  // All answers have arrived, so remaining bytes are not part of the stream that begins now.
  readings_.listen(xbus::MessageParser());
  last_packet_counter_.reset();
  last_sample_time_.reset();
  lost_packets_ = 0;
  temperature_degc_.reset();
  exchange({xbus::kGotoMeasurement, {}, "go to measurement"});
  readings_.start();
}

// Commands.

/// Sends a command and returns the data of its answer. @throws InstrumentError kRefused.
std::string XsensMtiAccelerometer::exchange(const Request& request) {
  wire::PacketAnswer answer = try_exchange(request);
  if (answer.error) {
    fail(Fault::kRefused, fmt::format("error {:02X} ({}) to \"{}\" ({:02X})", *answer.error,
                                      xbus::error_in_words(*answer.error), request.name, request.id));
  }
  return std::move(answer.data);
}

/// Sends a command, again if no answer arrives, and returns its answer or refusal.
wire::PacketAnswer XsensMtiAccelerometer::try_exchange(const Request& request) {
  return exchange_.ask(command_of(request.id, request.data, request.name));
}

void XsensMtiAccelerometer::make_quiet() {
  exchange_.restart(xbus::MessageParser());
  exchange({xbus::kGotoConfig, {}, "go to config"});
}

AccelerometerInfo XsensMtiAccelerometer::interrogate() {
  make_quiet();
  const std::string device_id = exchange({xbus::kReqDeviceId, {}, "device id"});
  // Eight of the MTi-600 series [unverified against a device].
  if (device_id.size() != 4 && device_id.size() != 8) {
    fail(Fault::kBadFrame,
         fmt::format("the answer to \"device id\" has {} bytes; required: 4 or 8", device_id.size()));
  }
  std::string serial_number;
  for (const char byte : device_id) serial_number += fmt::format("{:02X}", static_cast<unsigned char>(byte));
  const std::string product_code = exchange({xbus::kReqProductCode, {}, "product code"});
  const std::string model(pieces::trimmed(product_code, kPadding));
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
  name_it(model, serial_number);
  return AccelerometerInfo{
      .maker = "Xsens",
      .model = model,
      .serial_number = serial_number,
      .firmware = fmt::format("{}.{}.{}", part(0), part(1), part(2)),
      .output_unit = "m/s2",
      .full_scale = settings_.full_scale,  // The device does not report it.
      .resolution = std::nullopt,
      .rate_hz = rate_hz_ > 0.0 ? rate_hz_ : std::round(settings_.rate_hz),
  };
}

void XsensMtiAccelerometer::configure_output() {
  // A rate is a whole number of hertz, FFFF excepted.
  const double rate_hz = std::clamp(std::round(settings_.rate_hz), 1.0, 65534.0);
  if (std::abs(rate_hz - settings_.rate_hz) > kRateTolerance * settings_.rate_hz) {
    fail(Fault::kRefused,
         fmt::format(
             "rate_hz is {}; the device supports whole numbers of readings per second; the nearest is {}",
             settings_.rate_hz, rate_hz));
  }
  const auto packet_bytes = static_cast<double>(kPacketBytes);
  const double for_packets =
      std::max(0.0, settings_.link_bytes_per_s.value_or(0.0) - static_cast<double>(kTemperatureBytes));
  check_link(rate_hz, rate_hz * packet_bytes + static_cast<double>(kTemperatureBytes),
             settings_.link_bytes_per_s, for_packets / packet_bytes);
  const xbus::Output counter{xbus::kPacketCounter, xbus::kEveryPacket};
  const xbus::Output acceleration{xbus::kAcceleration, static_cast<std::uint16_t>(rate_hz)};
  const std::vector<xbus::Output> all{counter,
                                      {xbus::kSampleTimeFine, xbus::kEveryPacket},
                                      acceleration,
                                      {xbus::kTemperature, 1},
                                      {xbus::kStatusWord, xbus::kEveryPacket}};
  constexpr std::string_view kName = "set output configuration";
  wire::PacketAnswer answer =
      try_exchange({xbus::kSetOutputConfiguration, xbus::output_configuration(all), kName});
  if (answer.error) {
    // Not every model has all of them; these two are needed.
    answer.data =
        exchange({xbus::kSetOutputConfiguration, xbus::output_configuration({counter, acceleration}), kName});
  }
  const auto outputs = xbus::decode_output_configuration(answer.data);
  if (!outputs) fail(Fault::kBadFrame, "the answer to \"set output configuration\" is not a list of outputs");
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

// Data.

wire::DecodedFrame XsensMtiAccelerometer::decode(const xbus::Message& message) {
  switch (message.id) {
    case xbus::kMtData2:
      return decode_data(message);
    case xbus::kError: {
      const unsigned code = message.data.empty() ? 0U : static_cast<unsigned char>(message.data.front());
      if (is_of_a_command(code)) return {};  // Late.
      end_and_fail(Fault::kRefused,
                   fmt::format("error {:02X} ({}) while it streams {:.6g} readings per second", code,
                               xbus::error_in_words(code), rate_hz_));
    }
    case xbus::kWakeUp:
      end_and_fail(Fault::kNotReady, "it says that it woke up: it was restarted");
    default:
      return {};  // Late answers.
  }
}

wire::DecodedFrame XsensMtiAccelerometer::decode_data(const xbus::Message& message) {
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
  // A repeated packet is not a second reading.
  const bool repeated = packet_counter && packet_counter == last_packet_counter_;
  if (!items || !sound || repeated || (counts_packets_ && !packet_counter)) return {.malformed = true};
  if (sample_time) check_sample_time(*sample_time);
  if (temperature) {
    temperature_degc_ = temperature;
    temperature_arrival_ = readings_.last_arrival();
  }
  if (packet_counter) {
    if (last_packet_counter_) {
      // The counter has 16 bits: FFFF is followed by 0.
      lost_packets_ += static_cast<std::uint16_t>(*packet_counter - *last_packet_counter_ - 1U);
    }
    last_packet_counter_ = packet_counter;
  }
  if (!has_output) return {};  // Counted, and no reading.

  if (readings_.last_arrival() - temperature_arrival_ <= kTemperatureHold)
    reading.temperature_degc = temperature_degc_;
  reading.over_range = status_word && xbus::accelerometer_clipped(*status_word);
  const std::uint64_t steps = 1 + std::exchange(lost_packets_, 0);
  return {.reading = std::move(reading), .steps = packet_counter ? std::optional(steps) : std::nullopt};
}

/// A packet counter that starts again looks like a long gap; the sample time, in 0.1 ms, does not.
void XsensMtiAccelerometer::check_sample_time(std::uint32_t sample_time) {
  const auto last = std::exchange(last_sample_time_, sample_time);
  if (!last) return;
  const std::uint32_t ahead = sample_time - *last;  // Wraps after 5 days.
  if (ahead < 0x8000'0000U) return;
  end_and_fail(
      Fault::kNotReady,
      fmt::format("its sample time went back from {} to {} (0.1 ms): it was restarted", *last, sample_time));
}

}  // namespace abcal
