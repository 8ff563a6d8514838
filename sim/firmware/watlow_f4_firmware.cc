#include "sim/firmware/watlow_f4_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "sim/firmware/big_endian.h"

namespace abcal::sim {
namespace {

constexpr Clock::Duration kPartialKept = std::chrono::milliseconds(50);
constexpr int kBadFunction = 1, kBadAddress = 2, kBadValue = 3;
constexpr const char* kPartNumber = "F4T1L1EAA1D1AAA";

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

/// The head of a frame gives its length, whatever it contains; frames of another protocol are skipped.
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
      unserved().note(fmt::format("function {}", byte_at(received_, 1)), "no answer");
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
                  fmt::format("exception {}", code));
  return {static_cast<char>(function | 0x80U), static_cast<char>(code)};
}

std::string WatlowF4Firmware::carry_out(const std::string& pdu, Clock::Instant now) {
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
      unserved().note(fmt::format("read register {}", first + n), "exception 2");
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
  switch (address) {
    case 100:
      return scaled(bench_->chamber_air(now));
    case 101:
      return bench_->fault_at(FaultKind::kChamberAlarm, now) ? 1 : 0;
    case 104:
      return static_cast<std::uint16_t>(std::lround(10.0 * bench_->chamber_humidity_percent(now)));
    case 200:
      return 0;
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
  const auto part_of = [&](unsigned first, double value) -> Registers {
    return static_cast<std::uint16_t>(float_word(value, address != first));
  };
  if (address >= 16 && address < 16 + 15)
    return static_cast<std::uint16_t>(static_cast<unsigned char>(kPartNumber[address - 16]));
  if (address >= 1356 && address <= 1656 && (address - 1356) % 100 == 0)
    return address == 1356 && bench_->fault_at(FaultKind::kChamberAlarm, now) ? 10 : 61;
  if (address == 1456 + 1000) return std::nullopt;
  for (int n = 1; n <= 7; ++n)
    if (address == event_register(n)) return kept(address, 62);
  switch (address) {
    case 90:
      return 138;
    case 1328:
      return settings_.fahrenheit ? 30 : 15;
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
    case 11250:
      return bench_->fault_at(FaultKind::kChamberDoor, now) ? 28 : 61;
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
    unserved().note(fmt::format("write register {}", address), fmt::format("exception {}", code));
  return code;
}

int WatlowF4Firmware::write_f4(unsigned address, std::uint16_t value, Clock::Instant now) {
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
  const bool event = (address >= 16594 && address <= 16600) || (address >= 16822 && address <= 16826);
  if (event && value != 62 && value != 63) return kBadValue;
  if (address == 2794 && value != 62 && value != 85 && value != 88 && value != 13) return kBadValue;
  if (address == 2796 && value != 57 && value != 39) return kBadValue;
  if (!event && address != 2794 && address != 2796) return kBadAddress;
  state_->kept[address] = value;
  if (event) command(now);
  return 0;
}

/// Sets the state of the air to the controller's commands.
void WatlowF4Firmware::command(Clock::Instant now) {
  ChamberCommand wanted;
  wanted.target_degc = state_->set_degc;
  wanted.running = event_is_on(settings_.run_output);
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
