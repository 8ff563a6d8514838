#include "sim/firmware/weiss_firmware.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdlib>
#include <sstream>
#include <utility>

namespace abcal::sim {
namespace {

constexpr char kPilcrow = '\xB6';
constexpr const char* kUnknown = "-5";
constexpr const char* kTooFew = "-6";
constexpr int kStart = 1;
constexpr std::size_t kLongest = 4096;

std::vector<std::string> cut(const std::string& line, char at) {
  std::vector<std::string> words;
  std::istringstream text(line);
  for (std::string word; std::getline(text, word, at);) words.push_back(word);
  return words;
}

std::optional<double> number_of(const std::string& word) {
  char* end = nullptr;
  const double value = std::strtod(word.c_str(), &end);
  if (word.empty() || end != word.c_str() + word.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

/// simserv counts the start as 1 and output n as n + 1, ASCII-2 has the start as DO01. Output 1 has a place
/// of its own.
std::size_t channel_of(int simserv) {
  return simserv == 1 ? 1U : simserv == 2 ? 31U : static_cast<std::size_t>(simserv - 1);
}

std::string with_value(const std::string& value) {
  return std::string("1") + kPilcrow + value;
}
std::string with_number(double value) {
  return with_value(fmt::format("{:.1f}", value));
}
std::string fixed(double value) {
  return fmt::format("{:06.1f}", value);
}

}  // namespace

WeissFirmware::WeissFirmware(std::shared_ptr<SimBench> bench, WeissSettings settings)
    : bench_(std::move(bench)), settings_(std::move(settings)), state_(std::make_shared<State>()) {}

std::shared_ptr<Firmware> WeissFirmware::another_session() {
  auto other = std::make_shared<WeissFirmware>(bench_, settings_);
  other->state_ = state_;
  return other;
}

void WeissFirmware::session_starts() {
  received_.clear();
  replies_.clear();
}

void WeissFirmware::power(bool on, Clock::Instant now) {
  session_starts();
  if (on) return;
  state_->channels.assign(32, '0');
  command(now);
}

void WeissFirmware::receive(std::string_view bytes, Clock::Instant now) {
  received_ += bytes;
  for (std::size_t end = received_.find('\r'); end != std::string::npos; end = received_.find('\r')) {
    std::string line = received_.substr(0, end);
    received_.erase(0, end + 1);
    while (!line.empty() && line[0] == '\n') line.erase(0, 1);
    if (line.empty()) continue;
    const std::string reply = answer(line, now);
    if (!reply.empty()) replies_.push(reply, now + settings_.reply_delay);
  }
  if (received_.size() > kLongest) received_.clear();
}

std::string WeissFirmware::answer(const std::string& line, Clock::Instant now) {
  if (line[0] == '$') return settings_.ascii2 ? ascii2(line, now) : std::string();
  if (!settings_.simserv) return {};
  return simserv(cut(line, kPilcrow), now) + "\r\n";
}

std::string WeissFirmware::simserv(const Words& words, Clock::Instant now) {
  const auto number = number_of(words.at(0));
  if (!number) return kUnknown;
  if (words.size() < 2 || words[1] != "1") return kTooFew;
  const int command = static_cast<int>(*number);
  if (command == 11001 || command == 11068 || command == 11072 || command == 14001)
    return words.size() < 4 ? kTooFew : set_simserv(command, words, now);
  const auto which = words.size() > 2 ? number_of(words[2]) : std::optional(1.0);
  if (!which) return kTooFew;
  std::string reply = ask_simserv(command, static_cast<int>(*which), now);
  if (reply.empty()) {
    unserved().note(fmt::format("{}", command), "-5");
    return kUnknown;
  }
  return reply;
}

std::string WeissFirmware::ask_simserv(int number, int which, Clock::Instant now) const {
  const bool temperature = which == 1;
  if (number >= 11000 && number < 12000 && number != 11018 && which != 1 && which != 2) return kTooFew;
  switch (number) {
    case 99997:
      return with_value(which == 1 ? settings_.model : which == 2 ? "2019" : settings_.serial_number);
    case 10012:
      return with_value(std::to_string((is_on(kStart) ? 3 : 1) +
                                       (bench_->fault_at(FaultKind::kChamberAlarm, now) ? 8 : 0)));
    case 11018:
      return with_value("2");
    case 11023:
      return with_value(temperature ? "\xB0"
                                      "C"
                                    : "%rH");
    case 11026:
      return with_value(temperature ? "Temperature" : "Humidity");
    case 11004:
      return with_number(temperature ? bench_->chamber_air(now) : bench_->chamber_humidity_percent(now));
    case 11002:
      return with_number(temperature ? state_->set_degc : state_->set_humidity);
    case 11007:
      return with_number(temperature ? settings_.least_set_degc : 0.0);
    case 11009:
      return with_number(temperature ? settings_.most_set_degc : 100.0);
    case 11066:
      return with_number(state_->up);
    case 11070:
      return with_number(state_->down);
    case 14003:
      return which >= 1 && which <= 31 ? with_value(state_->channels.at(channel_of(which)) == '1' ? "1" : "0")
                                       : std::string(kTooFew);
    case 17002:
      return with_value("2");
    case 17009:
      return with_value(
          bench_->fault_at(which == 1 ? FaultKind::kChamberAlarm : FaultKind::kChamberDoor, now) ? "1" : "0");
    case 17005:
      return with_value(which == 1 ? "1" : "2");
    case 17007:
      return with_value(which == 1 ? "Thermal limiter temperature" : "Door open");
    default:
      return {};
  }
}

std::string WeissFirmware::set_simserv(int number, const Words& words, Clock::Instant now) {
  const auto which = number_of(words[2]), value = number_of(words[3]);
  if (!which || !value) return kTooFew;
  if (!settings_.external_mode) return "-8";
  if (number == 14001) {
    if (*which < 1 || *which > 31) return kTooFew;
    state_->channels.at(channel_of(static_cast<int>(*which))) = *value != 0.0 ? '1' : '0';
  } else if (*which == 2.0) {
    state_->set_humidity = *value;
  } else if (number == 11001) {
    if (*value < settings_.least_set_degc || *value > settings_.most_set_degc) return kTooFew;
    state_->set_degc = *value;
  } else {
    if (*value < 0.0) return kTooFew;
    (number == 11068 ? state_->up : state_->down) = *value;
    return "1";
  }
  command(now);
  return "1";
}

std::string WeissFirmware::ascii2(const std::string& line, Clock::Instant now) {
  if (line.size() < 4 || line.substr(1, 2) != fmt::format("{:02}", settings_.address)) return {};
  switch (line[3]) {
    case '?':
      return description();
    case 'I': {
      std::string text = fixed(is_on(kStart) ? bench_->chamber_set_point(now) : state_->set_degc) + " " +
                         fixed(bench_->chamber_air(now)) + " " + fixed(state_->set_humidity) + " " +
                         fixed(bench_->chamber_humidity_percent(now)) + " " + fixed(90.0) + " " +
                         fixed(90.0) + " " + fixed(0.0) + " " + fixed(bench_->temperature_degc(now)) + " ";
      return text + state_->channels + "\r";
    }
    case 'E':
    case 'U':
      return settings_.external_mode ? set_ascii2(line, now) : std::string();
    default:
      unserved().note(line, "no answer");
      return {};
  }
}

std::string WeissFirmware::set_ascii2(const std::string& line, Clock::Instant now) {
  const Words words = cut(line, ' ');
  std::vector<double> numbers;
  for (std::size_t n = 1; n < words.size() && n < 5; ++n) {
    const auto number = number_of(words[n]);
    if (!number) return {};
    numbers.push_back(*number);
  }
  if (numbers.size() != 4) return {};
  if (line[3] == 'U') {
    if (words.size() != 5 || (numbers[0] != 0.0 && numbers[1] != 0.0)) return {};
    state_->up = numbers[0];
    state_->down = numbers[1];
    return "0\r";
  }
  if (words.size() != 6 || words[5].size() != 32 || words[5].find_first_not_of("01") != std::string::npos)
    return {};
  if (numbers[0] < settings_.least_set_degc || numbers[0] > settings_.most_set_degc) return {};
  state_->set_degc = numbers[0];
  state_->set_humidity = numbers[1];
  state_->channels = words[5];
  command(now);
  return "0\r";
}

std::string WeissFirmware::description() const {
  std::string channels;
  for (int n = 0; n < 32; ++n) channels += fmt::format(" DO{:02}", n);
  std::string names;
  for (int n = 0; n < 32; ++n)
    names += fmt::format("DO{:02}  {}\r\n", n,
                         n == 1    ? "Start"
                         : n == 2  ? "Humidity"
                         : n == 11 ? "Dryer"
                                   : "unused");
  const std::string ranges = fmt::format(
      "CV01  value min: {:6.1f}   Value max: {:6.1f}   Temperature\r\nCV02  value min:    0.0   Value max:  "
      "100.0   "
      "Humidity\r\nSV01  value min:   50.0   Value max:  100.0   Fan speed\r\nMV01  0000.0 unused\r\n",
      settings_.least_set_degc, settings_.most_set_degc);
  return "STANDARD ASCII 2 PROTOCOL FOR E-STRING AND CHAMBERS WITH 2 CONTROLLED VALUES\r\n"
         "EXAMPLE OF AN ASCII E-STRING\r\n$01E CV01 CV02 SV01 MV01" +
         channels + " <CR>\r\n\r\nDESCRIPTION:\r\n" + ranges + names +
         "\r\nSTANDARD ASCII 2 PROTOCOL FOR I-STRING AND CHAMBERS WITH 2 CONTROLLED VALUES\r\n"
         "EXAMPLE OF AN ASCII I-STRING\r\n$01I<CR>\r\nCV01 CV01 CV02 CV02 SV01 SV01 MV01 MV01" +
         channels +
         "\r\nDESCRIPTION:\r\nCV01  nominal value Temperature\r\nCV01  actual value  Temperature\r\n";
}

void WeissFirmware::command(Clock::Instant now) {
  ChamberCommand wanted;
  wanted.target_degc = state_->set_degc;
  wanted.running = is_on(kStart);
  wanted.paused = settings_.pause_output > 0 && is_on(settings_.pause_output);
  const double rate = state_->set_degc > bench_->chamber_air(now) ? state_->up : state_->down;
  if (rate > 0.0) wanted.rate_k_per_min = rate;
  bench_->command_chamber(wanted, now);
}

}  // namespace abcal::sim
