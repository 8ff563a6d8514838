#include "drivers/watlow_f4/chamber.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal::watlow_f4 {
namespace {

constexpr Clock::Duration kPatience = std::chrono::milliseconds(700);
constexpr std::uint16_t kToken = 0xA5C3;
/// Transaction of the recipe, which runs after all others.
constexpr std::uint16_t kRestTransaction = 0xFFFF;

// Registers of the F4 (map 2).
constexpr std::uint16_t kF4Air = 100, kF4AirError = 101, kF4Second = 104, kF4Set = 300, kF4Least = 602,
                        kF4Decimals = 606, kF4SecondDecimals = 616, kF4Unit = 901, kF4Output = 2000,
                        kF4Input = 201;
constexpr int kF4Celsius = 1;

// Registers of the F4T (map 1); the second loop is 160 further.
constexpr std::uint16_t kPart = 16, kAir = 2820, kSet = 2782, kWorkingSet = 2810, kLeast = 2774, kMost = 2776,
                        kRampAction = 2794, kRampScale = 2796, kRampRate = 2798, kUnit = 1328, kAlarm = 1356,
                        kSecondLoop = 160, kLimitState = 11250, kDevice = 90;
constexpr std::uint16_t kPartLength = 15;
constexpr std::uint16_t kCelsius = 15, kFahrenheit = 30, kRampOff = 62, kRampAtSetPoint = 85, kPerMinute = 57,
                        kEventOff = 62, kEventOn = 63, kAlarmNone = 61, kAlarmStartup = 88, kAlarmQuiet = 12,
                        kLimitError = 28, kDeviceFailed = 32;
constexpr int kAlarms = 4;
constexpr std::array<std::uint16_t, 7> kEvents{16594, 16596, 16598, 16600, 16822, 16824, 16826};
constexpr int kF4Outputs = 8;

/// Set points that the controller stores as equal.
constexpr double kSame = 0.05;
/// Larger values mean swapped register words.
constexpr double kPlausibleDegc = 1000.0;

}  // namespace

WatlowChamber::WatlowChamber(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                             const ChamberSettings& settings)
    : settings_(settings),
      framing_(settings.tcp_framing ? Framing::kTcp : Framing::kRtu),
      exchange_(stream ? std::move(stream) : throw std::invalid_argument("WatlowChamber: no stream"), clock,
                {.who = "chamber watlow_f4", .patience = kPatience, .check = [this](std::string_view bytes) {
                   return check_reply(framing_, bytes);
                 }}) {
  if (!settings.model.empty() && settings.model != "F4" && settings.model != "F4T")
    throw std::invalid_argument("watlow_f4: model is \"" + settings.model +
                                "\"; required: \"F4\", \"F4T\", or nothing");
  if (settings.address < 1 || settings.address > 247)
    throw std::invalid_argument(
        fmt::format("watlow_f4: address is {}; required: 1 to 247", settings.address));
  exchange_.manner().who = fmt::format("chamber watlow_f4 on {}", exchange_.stream().name());
  if (framing_ == Framing::kRtu) {
    // Its answer is known to the letter. An F4T has a part number instead.
    exchange_.manner().sync_request = frame(framing_, settings.address, 0, loop_back(kToken));
    exchange_.manner().is_sync = [expected = exchange_.manner().sync_request](const std::string& frame) {
      return frame == expected;
    };
  }
}

InstrumentError WatlowChamber::failure(Fault fault, std::string_view detail) const {
  std::string who = is_f4t_ ? "chamber Watlow F4T" : "chamber Watlow F4";
  if (!info_) who = "chamber watlow_f4";
  return {who, fault, detail};
}

Reply WatlowChamber::exchange(std::string_view pdu, std::string_view shown) {
  ++transaction_;
  const int function = static_cast<unsigned char>(pdu[0]);
  const std::string bytes = frame(framing_, settings_.address, transaction_, pdu);
  std::size_t expected = 0;
  if (function == 3)
    expected = static_cast<unsigned char>(pdu[3]) * 256U + static_cast<unsigned char>(pdu[4]);
  return exchange_.ask(bytes, shown, [&](const std::string& received) -> std::optional<Reply> {
    auto reply = parse_reply(framing_, received);
    if (!reply || reply->unit != settings_.address || reply->function != function) return std::nullopt;
    if (framing_ == Framing::kTcp && reply->transaction != transaction_) return std::nullopt;
    if (reply->exception != 0) return reply;
    if (reply->registers.size() != expected) return std::nullopt;
    // The answer to a write repeats the address, and for one register also its value.
    if (function != 3 && reply->data != pdu.substr(1, 4)) return std::nullopt;
    return reply;
  });
}

std::optional<std::vector<std::uint16_t>> WatlowChamber::try_read(std::uint16_t first, std::uint16_t count) {
  Reply reply = exchange(read_registers(first, count), fmt::format("read register {}", first));
  if (reply.exception != 0) return std::nullopt;
  return std::move(reply.registers);
}

std::vector<std::uint16_t> WatlowChamber::read_at(std::uint16_t first, std::uint16_t count) {
  Reply reply = exchange(read_registers(first, count), fmt::format("read register {}", first));
  if (reply.exception != 0)
    throw failure(Fault::kRefused, fmt::format("exception {} ({}) to reading register {}", reply.exception,
                                               exception_text(reply.exception), first));
  return std::move(reply.registers);
}

float WatlowChamber::float_at(std::uint16_t first) {
  const std::vector<std::uint16_t> words = read_at(first, 2);
  return float_of(words.at(0), words.at(1));
}

double WatlowChamber::decimal_at(std::uint16_t address, std::string_view what) {
  if (const auto value = decimal_of(read_at(address, 1).at(0), decimals_)) return *value;
  throw failure(Fault::kImplausible,
                fmt::format("{} (register {}) has no value: is its sensor connected?", what, address));
}

void WatlowChamber::write(std::uint16_t address, std::uint16_t value) {
  const Reply reply = exchange(write_register(address, value), fmt::format("write register {}", address));
  if (reply.exception != 0)
    throw failure(Fault::kRefused,
                  fmt::format("exception {} ({}) to writing {} to register {}", reply.exception,
                              exception_text(reply.exception), value, address));
}

void WatlowChamber::write_float(std::uint16_t address, float value) {
  const Reply reply = exchange(write_registers(address, registers_of(value)),
                               fmt::format("write {} to register {}", value, address));
  if (reply.exception != 0)
    throw failure(Fault::kRefused,
                  fmt::format("exception {} ({}) to writing {} to register {}", reply.exception,
                              exception_text(reply.exception), value, address));
}

void WatlowChamber::find_family() {
  is_f4t_ = settings_.model == "F4T";
  if (settings_.model.empty()) {
    const auto part = try_read(kPart, kPartLength);
    is_f4t_ = part && text_of(*part).starts_with("F4T");
  }
}

void WatlowChamber::verify_unit() {
  const std::uint16_t at = is_f4t_ ? kUnit : kF4Unit;
  const std::uint16_t found = read_at(at, 1).at(0);
  if (found == (is_f4t_ ? kCelsius : kF4Celsius)) return;
  const bool fahrenheit = found == (is_f4t_ ? kFahrenheit : 0);
  throw failure(
      Fault::kWrongIdentity,
      fmt::format("its unit is {} (register {} is {}); required: degC. Set it at the controller: {}",
                  fahrenheit ? "degF" : "not known", at, found,
                  is_f4t_ ? "Settings, Global, Display Units, C" : "Setup, System, Units of degrees, C"));
}

void WatlowChamber::read_limits(ChamberInfo& info) {
  if (is_f4t_) {
    info.least_set_degc = float_at(kLeast);
    info.most_set_degc = float_at(kMost);
  } else {
    decimals_ = read_at(kF4Decimals, 1).at(0);
    if (decimals_ > 3)
      throw failure(Fault::kWrongIdentity,
                    fmt::format("register 606 (decimals) is {}; required: 0 to 3 of an F4", decimals_));
    const std::vector<std::uint16_t> raw = read_at(kF4Least, 2);
    info.least_set_degc = decimal_of(raw.at(0), decimals_).value_or(0.0);
    info.most_set_degc = decimal_of(raw.at(1), decimals_).value_or(0.0);
  }
  const bool plausible = std::abs(info.least_set_degc) < kPlausibleDegc &&
                         std::abs(info.most_set_degc) < kPlausibleDegc &&
                         info.least_set_degc < info.most_set_degc;
  if (plausible) return;
  throw failure(Fault::kWrongIdentity,
                fmt::format("its limits of the set point read {:g} to {:g}; required: a range in degC. On an "
                            "F4T the word order must be low-high (Settings, Communications)",
                            info.least_set_degc, info.most_set_degc));
}

ChamberInfo WatlowChamber::identify() {
  info_.reset();
  ChamberInfo info;
  info.maker = "Watlow";
  try {
    find_family();
    info.model = is_f4t_ ? "F4T" : "F4";
    if (is_f4t_) {
      const auto part = try_read(kPart, kPartLength);
      if (part) info.model = text_of(*part);
      if (!info.model.starts_with("F4T"))
        throw failure(Fault::kWrongIdentity,
                      fmt::format("its part number is \"{}\"; required: F4T...", info.model));
    }
    verify_unit();
    read_limits(info);
  } catch (const InstrumentError& error) {
    if (error.fault() != Fault::kRefused) throw;
    throw failure(Fault::kWrongIdentity,
                  fmt::format("it speaks Modbus, but is no F4 or F4T: {}", error.detail()));
  }
  info.can_ramp = is_f4t_;
  info.can_pause = settings_.pause_output > 0;
  info.has_humidity = settings_.humidity;
  info_ = info;
  if (is_f4t_ && settings_.door_input > 0)
    throw std::invalid_argument(
        "watlow_f4: door_input is given; required: none for an F4T, whose door is among its alarms");
  return info;
}

void WatlowChamber::set_ramp(std::optional<double> rate_k_per_min) {
  if (!is_f4t_) return;
  write(kRampAction, kRampOff);  // The set point that follows must not be ramped with an old rate.
  if (!rate_k_per_min) return;
  write(kRampScale, kPerMinute);
  write_float(kRampRate, static_cast<float>(*rate_k_per_min));
  write(kRampAction, kRampAtSetPoint);
}

void WatlowChamber::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  if (!info_) throw failure(Fault::kNotReady, "a set point before it was identified");
  if (!(degc >= info_->least_set_degc && degc <= info_->most_set_degc))
    throw failure(Fault::kOutOfTravel,
                  fmt::format("set point {:g} degC; required: {:g} to {:g} degC, the limits of its hardware",
                              degc, info_->least_set_degc, info_->most_set_degc));
  verify_unit();
  set_ramp(rate_k_per_min);
  const auto current = [&] { return is_f4t_ ? double{float_at(kSet)} : decimal_at(kF4Set, "the set point"); };
  if (std::abs(current() - degc) < kSame / 10.0) return;
  if (is_f4t_) {
    write_float(kSet, static_cast<float>(degc));
  } else {
    const auto raw = raw_of(degc, decimals_);
    if (!raw) throw failure(Fault::kOutOfTravel, fmt::format("set point {:g} degC does not fit", degc));
    write(kF4Set, *raw);
  }
  const double step = std::max(kSame, 0.51 * std::pow(10.0, -decimals_));
  if (const double found = current(); !(std::abs(found - degc) < step))
    throw failure(Fault::kRefused, fmt::format("its set point reads {:g} degC after {:g} degC was written; a "
                                               "limit or a running profile of its own may hold it",
                                               found, degc));
}

std::uint16_t WatlowChamber::output_register(int number) const {
  const int most = is_f4t_ ? static_cast<int>(kEvents.size()) : kF4Outputs;
  if (number < 1 || number > most)
    throw std::invalid_argument(fmt::format("watlow_f4: event output {}; required: 1 to {}", number, most));
  if (is_f4t_) return kEvents.at(static_cast<std::size_t>(number - 1));
  return static_cast<std::uint16_t>(kF4Output + 10 * (number - 1));
}

bool WatlowChamber::output_is_on(int number) {
  const std::uint16_t found = read_at(output_register(number), 1).at(0);
  return is_f4t_ ? found == kEventOn : found != 0;
}

void WatlowChamber::switch_output(int number, bool on) {
  if (!info_) throw failure(Fault::kNotReady, "a command before it was identified");
  const std::uint16_t off_word = is_f4t_ ? kEventOff : 0, on_word = is_f4t_ ? kEventOn : 1;
  write(output_register(number), on ? on_word : off_word);
  if (output_is_on(number) != on)
    throw failure(Fault::kRefused, fmt::format("event output {} is {} after it was switched {}", number,
                                               on ? "off" : "on", on ? "on" : "off"));
}

bool WatlowChamber::pause(bool paused) {
  if (settings_.pause_output <= 0) return false;
  switch_output(settings_.pause_output, paused);
  return true;
}

/// A write whose complete answer is known: the address, and for one register also its value.
HaltRecipe::Question WatlowChamber::write_step(std::string_view pdu) const {
  const auto framed = [&](std::string_view bytes) {
    return frame(framing_, settings_.address, kRestTransaction, bytes);
  };
  return {framed(pdu), {pattern::literal(framed(pdu.substr(0, 5)))}, {}};
}

/// Half an RTU frame gets old; its silence is waited for by trying again.
std::optional<HaltRecipe> WatlowChamber::rest_recipe(ChamberPolicy policy) {
  if (!info_) throw failure(Fault::kNotReady, "asked how to leave it before it was identified");
  HaltRecipe recipe{.driver = "watlow_f4",
                    .axes = {},
                    .end_partial = {},
                    .stop = {},
                    .questions = {},
                    .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience),
                    .binary = true,
                    .chamber = "holds its last set point"};
  if (settings_.pause_output > 0) {
    const std::uint16_t off = is_f4t_ ? kEventOff : 0;
    recipe.questions.push_back(write_step(write_register(output_register(settings_.pause_output), off)));
  }
  if (policy != ChamberPolicy::kHold) {
    recipe.chamber = fmt::format("is driven to {:g} degC", kAmbientDegc);
    std::vector<std::uint16_t> words;
    if (is_f4t_) {
      words = registers_of(static_cast<float>(kAmbientDegc));
      recipe.questions.push_back(write_step(write_register(kRampAction, kRampOff)));
      recipe.questions.push_back(write_step(write_registers(kSet, words)));
    } else {
      const auto raw = raw_of(kAmbientDegc, decimals_);
      if (!raw) return std::nullopt;
      recipe.questions.push_back(write_step(write_register(kF4Set, *raw)));
      words = {*raw};
    }
    std::string value;
    for (const std::uint16_t word : words) {
      value += static_cast<char>(word / 256U);
      value += static_cast<char>(word % 256U);
    }
    const std::string pdu = read_registers(is_f4t_ ? kSet : kF4Set, static_cast<std::uint16_t>(words.size()));
    const ReplyPart head = pattern::literal(
        std::string{static_cast<char>(settings_.address), '\x03', static_cast<char>(value.size())});
    recipe.questions.push_back({frame(framing_, settings_.address, kRestTransaction, pdu),
                                {head, pattern::any_bytes(value.size())},
                                {head, pattern::literal(value)}});
  }
  return recipe.questions.empty() ? std::nullopt : std::optional(std::move(recipe));
}

std::vector<std::string> WatlowChamber::alarms() {
  std::vector<std::string> found;
  if (!is_f4t_) {
    if (read_at(kF4AirError, 1).at(0) != 0) found.emplace_back("error of the air sensor (register 101)");
    return found;
  }
  for (int n = 0; n < kAlarms; ++n) {
    const auto state = try_read(static_cast<std::uint16_t>(kAlarm + 100 * n), 1);
    if (!state) continue;
    const std::uint16_t word = state->at(0);
    if (word != kAlarmNone && word != kAlarmStartup && word != kAlarmQuiet)
      found.push_back(fmt::format("alarm {} (state {})", n + 1, word));
  }
  if (const auto limit = try_read(kLimitState, 1); limit && limit->at(0) == kLimitError)
    found.emplace_back("over-temperature limit (register 11250)");
  if (const auto device = try_read(kDevice, 1); device && device->at(0) == kDeviceFailed)
    found.emplace_back("the controller says that it has failed (register 90)");
  return found;
}

ChamberReading WatlowChamber::read() {
  if (!info_) throw failure(Fault::kNotReady, "asked for its temperature before it was identified");
  ChamberReading reading;
  if (is_f4t_) {
    reading.air_degc = float_at(kAir);
    reading.set_degc = float_at(kWorkingSet);
    if (settings_.humidity) reading.humidity_percent = float_at(kAir + kSecondLoop);
  } else {
    reading.air_degc = decimal_at(kF4Air, "the temperature of the air");
    reading.set_degc = decimal_at(kF4Set, "the set point");
    if (settings_.humidity) {
      const int decimals = read_at(kF4SecondDecimals, 1).at(0);
      reading.humidity_percent = decimal_of(read_at(kF4Second, 1).at(0), decimals);
    }
  }
  if (!(std::abs(reading.air_degc) < kPlausibleDegc))
    throw failure(Fault::kImplausible,
                  fmt::format("its temperature reads {:g} degC: is its sensor connected?", reading.air_degc));
  reading.running = output_is_on(settings_.run_output);
  if (!is_f4t_ && settings_.door_input > 0)
    reading.door_open =
        read_at(static_cast<std::uint16_t>(kF4Input + 12 * (settings_.door_input - 1)), 1).at(0) != 0;
  reading.alarms = alarms();
  return reading;
}

}  // namespace abcal::watlow_f4
