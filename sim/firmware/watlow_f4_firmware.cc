#include "sim/firmware/watlow_f4_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <utility>

#include "sim/firmware/big_endian.h"

namespace abcal::sim {
namespace {

constexpr Clock::Duration kPartialKept = std::chrono::milliseconds(50);
constexpr int kBadFunction = 1, kBadAddress = 2, kBadValue = 3;
constexpr const char* kPartNumber = "F4T1L1EAA1D1AAA";

/// Words of the F4T for states.
enum F4tWord : std::uint16_t {
  kAuto = 10,
  kErrorState = 28,
  kManual = 54,
  kNone = 61,
  kOff = 62,
  kOn = 63,
  kOk = 138,
  kPause = 146,
  kTerminate = 148,
  kKeyDown = 1457,
  kAbsoluteTemperature = 1540,
};
constexpr unsigned kModeWanted = 2730, kModeActive = 2814;
constexpr unsigned kPowerByHand = 2784;
constexpr unsigned kF4Clock = 1916, kF4tClock = 14664;
constexpr std::size_t kClockParts = 6;
constexpr unsigned kAlarms = 8;

/// A controller whose clock was never set begins here [unverified against a device].
constexpr std::chrono::sys_days kFirstDay{std::chrono::year{2000} / 1 / 1};
/// The heaters give their full power this far from the set point [unverified against a device].
constexpr double kProportionalBandK = 10.0;

unsigned byte_at(const std::string& bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes.at(at));
}
unsigned word_at(const std::string& bytes, std::size_t at) {
  return byte_at(bytes, at) << 8U | byte_at(bytes, at + 1);
}
std::string word(unsigned value) {
  return {static_cast<char>(value >> 8U & 0xFFU), static_cast<char>(value & 0xFFU)};
}

/// The maker's table method, here bit by bit.
unsigned checksum(const std::string& bytes) {
  unsigned crc = 0xFFFFU;
  for (const char c : bytes) {
    crc = crc ^ static_cast<unsigned char>(c);
    for (int shift = 8; shift > 0; --shift) {
      const bool carry = (crc & 0x0001U) == 1U;
      crc = crc >> 1U;
      if (carry) crc = crc ^ 0xA001U;
    }
  }
  return crc;
}

/// How long a request is, from its function code on; 0: more bytes are needed to know; npos: not known.
std::size_t request_length(const std::string& bytes, std::size_t at) {
  if (bytes.size() <= at) return 0;
  const unsigned function = byte_at(bytes, at);
  if (function == 3 || function == 4 || function == 6 || function == 8) return 5;
  if (function != 16) return std::string::npos;
  if (bytes.size() <= at + 5) return 0;
  return 6 + byte_at(bytes, at + 5);
}

unsigned float_word(double value, bool high) {
  const auto bits = std::bit_cast<std::uint32_t>(static_cast<float>(value));
  return high ? bits >> 16U : bits & 0xFFFFU;
}

}  // namespace

WatlowF4Firmware::WatlowF4Firmware(std::shared_ptr<SimBench> bench, WatlowF4Settings settings)
    : bench_(std::move(bench)), settings_(settings), state_(std::make_shared<State>()) {}

std::shared_ptr<Firmware> WatlowF4Firmware::another_session() {
  if (!settings_.tcp) return nullptr;
  auto other = std::make_shared<WatlowF4Firmware>(bench_, settings_);
  other->state_ = state_;
  return other;
}

void WatlowF4Firmware::session_starts() {
  received_.clear();
  replies_.clear();
}

void WatlowF4Firmware::power(bool on, Clock::Instant now) {
  session_starts();
  if (on) return;
  for (int n = 1; n <= 4; ++n) state_->kept.erase(event_register(n));
  command(now);
}

void WatlowF4Firmware::receive(std::string_view bytes, Clock::Instant now) {
  if (!received_.empty() && now - last_byte_ > kPartialKept) received_.clear();
  last_byte_ = now;
  received_ += bytes;
  take_frames(now);
}

void WatlowF4Firmware::take_frames(Clock::Instant now) {
  if (settings_.tcp)
    take_tcp_frames(now);
  else
    take_rtu_frames(now);
}

/// The head of a frame gives its length, independent of its contents; frames of another protocol are skipped.
void WatlowF4Firmware::take_tcp_frames(Clock::Instant now) {
  constexpr std::size_t kBeforeUnit = 6, kShortest = 2, kLongest = 254;
  while (received_.size() >= kBeforeUnit) {
    const std::size_t length = word_at(received_, 4);
    if (length < kShortest || length > kLongest) {
      received_.clear();  // Where the next frame begins is not known.
      return;
    }
    if (received_.size() < kBeforeUnit + length) return;
    const std::string frame = received_.substr(0, kBeforeUnit + length);
    received_.erase(0, kBeforeUnit + length);
    if (word_at(frame, 2) != 0 || static_cast<int>(byte_at(frame, kBeforeUnit)) != settings_.address)
      continue;
    const std::string answer = frame.substr(kBeforeUnit, 1) + answer_to(frame.substr(kBeforeUnit + 1), now);
    replies_.push(frame.substr(0, 4) + word(static_cast<unsigned>(answer.size())) + answer,
                  now + settings_.reply_delay);
  }
}

void WatlowF4Firmware::take_rtu_frames(Clock::Instant now) {
  while (received_.size() > 1) {
    const std::size_t length = request_length(received_, 1);
    if (length == 0) return;
    if (length == std::string::npos) {
      // Bytes that are perhaps no frame are not answered.
      unserved().note(fmt::format("function {}", byte_at(received_, 1)), "no answer", received_);
      received_.clear();
      return;
    }
    const std::size_t total = 1 + length + 2;
    if (received_.size() < total) return;
    const std::string frame = received_.substr(0, total);
    if (checksum(frame.substr(0, total - 2)) !=
        (byte_at(frame, total - 2) | byte_at(frame, total - 1) << 8U)) {
      received_.erase(0, 1);
      continue;
    }
    received_.erase(0, total);
    if (static_cast<int>(byte_at(frame, 0)) != settings_.address) continue;
    const std::string answer = frame.substr(0, 1) + carry_out(frame.substr(1, length), now);
    const unsigned crc = checksum(answer);
    const std::string sum{static_cast<char>(crc & 0xFFU), static_cast<char>(crc >> 8U)};
    replies_.push(answer + sum, now + settings_.reply_delay);
  }
}

/// A request whose length the frame gives: it need not be that of its function (exception 3: "the implied
/// length is incorrect").
std::string WatlowF4Firmware::answer_to(const std::string& pdu, Clock::Instant now) {
  const std::size_t length = request_length(pdu, 0);
  if (length == pdu.size()) return carry_out(pdu, now);
  const unsigned function = byte_at(pdu, 0);
  const int code = length == std::string::npos ? kBadFunction : kBadValue;
  unserved().note(fmt::format("function {} in {} bytes", function, pdu.size()),
                  fmt::format("exception {}", code), pdu);
  return {static_cast<char>(function | 0x80U), static_cast<char>(code)};
}

std::string WatlowF4Firmware::carry_out(const std::string& pdu, Clock::Instant now) {
  request_ = pdu;
  const unsigned function = byte_at(pdu, 0);
  const auto exception = [&](int code) {
    return std::string{static_cast<char>(function | 0x80U), static_cast<char>(code)};
  };
  if (function == 8) return pdu;  // The loop-back repeats the request.
  if (function == 3 || function == 4) {
    const unsigned count = word_at(pdu, 3);
    if (count == 0 || count > 125) return exception(kBadValue);
    const std::string words = read(word_at(pdu, 1), count, now);
    if (words.empty()) return exception(kBadAddress);
    return std::string{static_cast<char>(function), static_cast<char>(words.size())} + words;
  }
  const std::string words = function == 6 ? pdu.substr(3, 2) : pdu.substr(6);
  if (function == 16 && words.size() != 2 * word_at(pdu, 3)) return exception(kBadValue);
  if (const int code = write(word_at(pdu, 1), words, now); code != 0) return exception(code);
  return pdu.substr(0, 5);
}

std::string WatlowF4Firmware::read(unsigned first, unsigned count, Clock::Instant now) {
  std::string words;
  for (unsigned n = 0; n < count; ++n) {
    const Registers value = value_of(first + n, now);
    if (!value) {
      unserved().note(fmt::format("read register {}", first + n), "exception 2", request_);
      return {};
    }
    words += word(*value);
  }
  return words;
}

WatlowF4Firmware::Registers WatlowF4Firmware::value_of(unsigned address, Clock::Instant now) const {
  return settings_.f4t ? f4t_value(address, now) : f4_value(address, now);
}

std::uint16_t WatlowF4Firmware::kept(unsigned address, std::uint16_t otherwise) const {
  const auto found = state_->kept.find(address);
  return found == state_->kept.end() ? otherwise : found->second;
}

double WatlowF4Firmware::shown(double degc) const {
  return settings_.fahrenheit ? degc * 1.8 + 32.0 : degc;
}
double WatlowF4Firmware::degc_of(double shown) const {
  return settings_.fahrenheit ? (shown - 32.0) / 1.8 : shown;
}

namespace {

using ClockParts = std::array<unsigned, kClockParts>;  // hour, minute, second, month, day, year

ClockParts clock_parts(std::chrono::sys_seconds time) {
  const auto day = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss of_day(time - day);
  return {static_cast<unsigned>(of_day.hours().count()),
          static_cast<unsigned>(of_day.minutes().count()),
          static_cast<unsigned>(of_day.seconds().count()),
          static_cast<unsigned>(date.month()),
          static_cast<unsigned>(date.day()),
          static_cast<unsigned>(static_cast<int>(date.year()))};
}

std::chrono::sys_seconds time_of(const ClockParts& parts) {
  const std::chrono::year_month_day date{std::chrono::year(static_cast<int>(parts[5])),
                                         std::chrono::month(parts[3]), std::chrono::day(parts[4])};
  return std::chrono::sys_days(date) + std::chrono::hours(parts[0]) + std::chrono::minutes(parts[1]) +
         std::chrono::seconds(parts[2]);
}

std::chrono::sys_seconds unset_clock(Clock::Instant start, Clock::Instant now) {
  return kFirstDay + std::chrono::floor<std::chrono::seconds>(now - start);
}

}  // namespace

std::uint16_t WatlowF4Firmware::clock_part(std::size_t which, Clock::Instant now) const {
  const auto time = unset_clock(bench_->start(), now) + std::chrono::seconds(state_->clock_ahead_s);
  return static_cast<std::uint16_t>(clock_parts(time).at(which));
}

/// The parts of a date are set one after the other: an invalid date in between (31 February) is continued
/// into the next month, as no host reads it before it has set all parts.
int WatlowF4Firmware::set_clock_part(std::size_t which, unsigned value, Clock::Instant now) {
  constexpr std::array<std::array<unsigned, 2>, kClockParts> kRanges{
      {{0, 23}, {0, 59}, {0, 59}, {1, 12}, {1, 31}, {1970, 2099}}};
  if (value < kRanges.at(which)[0] || value > kRanges.at(which)[1]) return kBadValue;
  const auto without = unset_clock(bench_->start(), now);
  ClockParts parts = clock_parts(without + std::chrono::seconds(state_->clock_ahead_s));
  parts.at(which) = value;
  state_->clock_ahead_s = (time_of(parts) - without).count();
  return 0;
}

bool WatlowF4Firmware::controls_air() const {
  return event_is_on(settings_.run_output) && kept(kModeWanted, kAuto) != kOff;
}

double WatlowF4Firmware::power_percent(Clock::Instant now) const {
  if (!controls_air()) return 0.0;
  const double away = bench_->chamber_set_point(now) - bench_->chamber_air(now);
  return std::clamp(100.0 * away / kProportionalBandK, -100.0, 100.0);
}

std::uint16_t WatlowF4Firmware::scaled(double degc) const {
  const double value = std::round(shown(degc) * std::pow(10.0, settings_.decimals));
  return static_cast<std::uint16_t>(static_cast<std::int16_t>(std::clamp(value, -31999.0, 32767.0)));
}

unsigned WatlowF4Firmware::event_register(int number) const {
  const auto n = static_cast<unsigned>(number);
  if (!settings_.f4t) return 2000U + 10U * (n - 1U);
  return n <= 4 ? 16594U + 2U * (n - 1U) : 16822U + 2U * (n - 5U);
}

bool WatlowF4Firmware::event_is_on(int number) const {
  return number > 0 && kept(event_register(number), 0) == (settings_.f4t ? 63 : 1);
}

WatlowF4Firmware::Registers WatlowF4Firmware::f4_value(unsigned address, Clock::Instant now) const {
  const std::uint16_t absent = static_cast<std::uint16_t>(-32000);
  if (address >= 2000 && address <= 2070 && address % 10 == 0) return kept(address, 0);
  if (address == 201U + 12U * static_cast<unsigned>(settings_.door_input - 1))
    return bench_->fault_at(FaultKind::kChamberDoor, now) ? 1 : 0;
  if (address >= kF4Clock && address < kF4Clock + kClockParts) return clock_part(address - kF4Clock, now);
  // Condition at which a digital input is active: closed.
  if (address >= 1061 && address <= 1067 && address % 2 == 1) return 1;
  switch (address) {
    case 100:
      return scaled(bench_->chamber_air(now));
    case 101:
      return bench_->fault_at(FaultKind::kChamberAlarm, now) ? 1 : 0;
    case 104:
      return static_cast<std::uint16_t>(std::lround(10.0 * bench_->chamber_humidity_percent(now)));
    case 103:  // in 0.01 %
      return static_cast<std::uint16_t>(
          static_cast<std::int16_t>(std::lround(100.0 * std::max(0.0, power_percent(now)))));
    case 107:
      return static_cast<std::uint16_t>(
          static_cast<std::int16_t>(std::lround(100.0 * std::min(0.0, power_percent(now)))));
    case 200:
      return 0;
    case 319:
      return settings_.second_loop ? kept(319, 0) : absent;
    case 1218:  // profiles and steps that can still be stored: none is
      return 40;
    case 1219:
      return 256;
    case 300:
      return scaled(state_->set_degc);
    case 602:
      return scaled(settings_.least_set_degc);
    case 603:
      return scaled(settings_.most_set_degc);
    case 606:
      return static_cast<std::uint16_t>(settings_.decimals);
    case 608:
      return 0;
    case 616:
      return 1;
    case 901:
      return settings_.fahrenheit ? 0 : 1;
    case 1925:
      return 0;
    default:
      // Reading an inactive register gives no exception.
      return address < 5000 ? Registers(absent) : std::nullopt;
  }
}

WatlowF4Firmware::Registers WatlowF4Firmware::f4t_value(unsigned address, Clock::Instant now) const {
  if (address >= 16 && address < 16 + 15)
    return static_cast<std::uint16_t>(static_cast<unsigned char>(kPartNumber[address - 16]));
  if (address >= 1356 && address < 1356 + 100 * kAlarms && (address - 1356) % 100 == 0)
    return address == 1356 && bench_->fault_at(FaultKind::kChamberAlarm, now) ? kAuto : kNone;
  for (int n = 1; n <= 8; ++n)
    if (address == event_register(n)) return kept(address, kOff);
  if (address >= kF4tClock && address < kF4tClock + 2 * kClockParts)
    return (address - kF4tClock) % 2 == 0 ? clock_part((address - kF4tClock) / 2, now) : std::uint16_t{0};
  // Limit cards in slots 1 and 5: state, status, error. Slot 1 watches the door.
  for (const unsigned slot : {0U, 4U}) {
    const bool open = slot == 0 && bench_->fault_at(FaultKind::kChamberDoor, now);
    if (address == 11250 + 60 * slot) return open ? kErrorState : kNone;
    if (address == 11264 + 60 * slot) return kOk;
    if (address == 11288 + 60 * slot) return kNone;
  }
  // Names of the 40 profiles: none is stored.
  if (address >= 16886 && address < 16886 + 40 * 40) return 0;
  if (const Registers value = f4t_loop_value(address, now)) return value;
  switch (address) {
    case 90:
      return kOk;
    case 1328:
    case 6730:  // the same for the network and for the serial line
    case 14080:
      return settings_.fahrenheit ? 30 : 15;
    case kModeWanted:
    case kModeActive:
      return kept(kModeWanted, kAuto);
    case kPowerByHand:
    case kPowerByHand + 1:
      return kept(address, 0);
    case 6844:  // key 1
      return event_is_on(settings_.run_output) ? kOn : kOff;
    case 16536:
      return kAbsoluteTemperature;
    case 16568:  // state of the profile; its number, step and times
      return kOff;
    case 16570:
    case 16571:
    case 16572:
    case 16588:
    case 16590:
    case 18920:
      return 0;
    case 18888:
      return kept(18888, 1);
    case 33718:  // the output "chamber running"
      return controls_air() ? kOn : kOff;
    default:
      if (address >= 16622 && address < 16622 + 5) return 0;
      return std::nullopt;
  }
}

/// Registers of the control loop and of its inputs.
WatlowF4Firmware::Registers WatlowF4Firmware::f4t_loop_value(unsigned address, Clock::Instant now) const {
  const auto part_of = [&](unsigned first, double value) -> Registers {
    return static_cast<std::uint16_t>(float_word(value, address != first));
  };
  switch (address) {
    case 2774:
    case 2775:
      return part_of(2774, shown(settings_.least_set_degc));
    case 2776:
    case 2777:
      return part_of(2776, shown(settings_.most_set_degc));
    case 2782:
    case 2783:
      return part_of(2782, shown(state_->set_degc));
    case 2794:
      return kept(2794, 62);
    case 2796:
      return kept(2796, 57);
    case 2798:
    case 2799:
      return kept(address, static_cast<std::uint16_t>(float_word(1.0, address != 2798)));
    case 2808:
    case 2809:
      return part_of(2808, power_percent(now));
    case 2810:
    case 2811:
      return part_of(
          2810, shown(event_is_on(settings_.run_output) ? bench_->chamber_set_point(now) : state_->set_degc));
    case 2820:
    case 2821:
      return part_of(2820, shown(bench_->chamber_air(now)));
    case 2980:
    case 2981:
      return part_of(2980, bench_->chamber_humidity_percent(now));
    default:
      return std::nullopt;
  }
}

int WatlowF4Firmware::write(unsigned address, const std::string& words, Clock::Instant now) {
  int code = kBadAddress;
  if (settings_.f4t) {
    code = write_f4t(address, words, now);
  } else {
    for (std::size_t n = 0; n + 1 < words.size(); n += 2) {
      code = write_f4(address + static_cast<unsigned>(n / 2), static_cast<std::uint16_t>(word_at(words, n)),
                      now);
      if (code != 0) break;
    }
  }
  if (code != 0)
    unserved().note(fmt::format("write register {}", address), fmt::format("exception {}", code), request_);
  return code;
}

int WatlowF4Firmware::write_f4(unsigned address, std::uint16_t value, Clock::Instant now) {
  if (address >= kF4Clock && address < kF4Clock + kClockParts)
    return set_clock_part(address - kF4Clock, value, now);
  if (address == 319 && settings_.second_loop) {
    state_->kept[319] = value;
    return 0;
  }
  // Settings are kept without being saved; of the profiles, of which none runs, only the end is served.
  if (address == 25) return value == 0 ? 0 : kBadValue;
  if (address == 1217) return value == 1 ? 0 : kBadValue;
  if (address == 300) {
    const double set = degc_of(static_cast<std::int16_t>(value) * std::pow(10.0, -settings_.decimals));
    constexpr double kRounding = 1e-9;
    if (set < settings_.least_set_degc - kRounding || set > settings_.most_set_degc + kRounding)
      return kBadValue;
    state_->set_degc = set;
    command(now);
    return 0;
  }
  if (address < 2000 || address > 2070 || address % 10 != 0) return kBadAddress;
  if (value > 1) return kBadValue;
  state_->kept[address] = value;
  command(now);
  return 0;
}

int WatlowF4Firmware::write_f4t(unsigned address, const std::string& words, Clock::Instant now) {
  if (address == kPowerByHand && words.size() == 4) {
    state_->kept[kPowerByHand] = static_cast<std::uint16_t>(word_at(words, 0));
    state_->kept[kPowerByHand + 1] = static_cast<std::uint16_t>(word_at(words, 2));
    return 0;
  }
  if (address == 2782 || address == 2798) {
    if (words.size() != 4) return kBadValue;
    const std::uint32_t bits = word_at(words, 2) << 16U | word_at(words, 0);  // low word first
    const double value = double{std::bit_cast<float>(bits)};
    if (address == 2798) {
      if (!(value > 0.0 && value < 1000.0)) return kBadValue;
      state_->kept[2798] = static_cast<std::uint16_t>(word_at(words, 0));
      state_->kept[2799] = static_cast<std::uint16_t>(word_at(words, 2));
      return 0;
    }
    const double set = degc_of(value);
    if (!(set >= settings_.least_set_degc - 1e-4 && set <= settings_.most_set_degc + 1e-4)) return kBadValue;
    state_->set_degc = set;
    command(now);
    return 0;
  }
  if (words.size() != 2) return kBadAddress;
  const auto value = static_cast<std::uint16_t>(word_at(words, 0));
  if (address >= kF4tClock && address < kF4tClock + 2 * kClockParts && (address - kF4tClock) % 2 == 0)
    return set_clock_part((address - kF4tClock) / 2, value, now);
  if (address == 6850) {  // Key 1 starts and stops the chamber, at each press.
    if (value == kKeyDown)
      state_->kept[event_register(settings_.run_output)] = event_is_on(settings_.run_output) ? kOff : kOn;
    command(now);
    return 0;
  }
  if (address == 16566) return value == kTerminate || value == kPause ? 0 : kBadValue;
  if (address == 18888 && (value < 1 || value > 40)) return kBadValue;
  if (address == kModeWanted && value != kAuto && value != kManual && value != kOff) return kBadValue;
  const bool event = (address >= 16594 && address <= 16600) || (address >= 16822 && address <= 16828);
  if (event && value != kOff && value != kOn) return kBadValue;
  if (address == 2794 && value != 62 && value != 85 && value != 88 && value != 13) return kBadValue;
  if (address == 2796 && value != 57 && value != 39) return kBadValue;
  if (!event && address != 2794 && address != 2796 && address != kModeWanted && address != 18888)
    return kBadAddress;
  state_->kept[address] = value;
  if (event || address == kModeWanted) command(now);
  return 0;
}

/// Sets the state of the air to the controller's commands.
void WatlowF4Firmware::command(Clock::Instant now) {
  ChamberCommand wanted;
  wanted.target_degc = state_->set_degc;
  wanted.running = controls_air();
  wanted.paused = event_is_on(settings_.pause_output);
  const bool ramps = settings_.f4t && (kept(2794, 62) == 85 || kept(2794, 62) == 13);
  if (ramps) {
    const std::uint32_t bits = static_cast<std::uint32_t>(kept(2799, 0x3F80)) << 16U | kept(2798, 0);
    const double per_minute = double{std::bit_cast<float>(bits)} / (kept(2796, 57) == 39 ? 60.0 : 1.0);
    wanted.rate_k_per_min = settings_.fahrenheit ? per_minute / 1.8 : per_minute;
  }
  bench_->command_chamber(wanted, now);
}

}  // namespace abcal::sim
