#include "sim/firmware/iio_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <deque>
#include <map>
#include <sstream>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/firmware/reply_queue.h"

namespace abcal::sim {
namespace {

constexpr const char* kDevice = "iio:device0";
constexpr const char* kTrigger = "trigger0";
constexpr double kAccelerationScale = 3.7409e-8;  // m/s2; 80 m/s2 over 31 bits
constexpr double kRateScale = 5.326e-9;           // rad/s
constexpr std::size_t kMostBytes = std::size_t{1} << 24U;

// Errors of the system, as iiod answers them.
constexpr int kNoEntry = -2;
constexpr int kNoAddress = -6;
constexpr int kBadFile = -9;
constexpr int kBusy = -16;
constexpr int kNoDevice = -19;
constexpr int kInvalid = -22;

struct ChannelOfScan {
  std::string_view id;
  bool signed64 = false;
};
constexpr std::array<ChannelOfScan, 7> kScan{{{"anglvel_x"},
                                              {"anglvel_y"},
                                              {"anglvel_z"},
                                              {"accel_x"},
                                              {"accel_y"},
                                              {"accel_z"},
                                              {"timestamp", true}}};

void put(std::string& bytes, std::uint64_t value, int size, bool big_endian) {
  for (int n = 0; n < size; ++n)
    bytes.push_back(static_cast<char>(value >> static_cast<unsigned>(8 * (big_endian ? size - 1 - n : n))));
}

std::vector<std::string> words_of(const std::string& line) {
  std::istringstream stream(line);
  std::vector<std::string> words;
  for (std::string word; stream >> word;) words.push_back(word);
  return words;
}

}  // namespace

/// State that all clients share.
class IioFirmware::Machine {
 public:
  Machine(std::shared_ptr<SimBench> bench, const IioSettings& settings)
      : bench_(std::move(bench)), settings_(settings), rate_hz_(settings.rate_hz) {
    set_rate(settings.rate_hz, bench_->start());
    for (const std::string axis : {"x", "y", "z"}) {
      values_["anglvel_" + axis + " scale"] = fmt::format("{:.12f}", kRateScale);
      values_["accel_" + axis + " scale"] = fmt::format("{:.12f}", kAccelerationScale);
      values_["accel_" + axis + " calibbias"] = "0";
      values_["accel_" + axis + " calibscale"] = "1.000000";
    }
    values_["temp0 scale"] = "5.650000";
    values_["temp0 offset"] = "4424.778761";
    debug_["serial_number"] = settings_.serial_number;
    debug_["product_id"] = "16485";
    debug_["firmware_revision"] = "1.2";
  }

  std::string description() const;
  std::optional<std::string> read(const std::string& channel, const std::string& attribute,
                                  Clock::Instant now) const;
  std::optional<std::string> read_debug(const std::string& attribute) const {
    const auto found = debug_.find(attribute);
    return found == debug_.end() ? std::nullopt : std::optional(found->second);
  }
  int write(const std::string& channel, const std::string& attribute, const std::string& value,
            Clock::Instant now);

  double rate_hz() const { return rate_hz_; }
  Clock::Instant time(std::uint64_t tick) const {
    return from_ + from_seconds(static_cast<double>(tick) / rate_hz_);
  }
  std::uint64_t first_after(Clock::Instant t) const {
    auto tick = static_cast<std::uint64_t>(std::max(0.0, std::floor(to_seconds(t - from_) * rate_hz_)));
    while (time(tick) <= t) ++tick;
    return tick;
  }
  bool silent_at(Clock::Instant t) const { return bench_->fault_at(FaultKind::kNoOutput, t).has_value(); }
  std::string scan(std::uint64_t tick, std::uint32_t mask) const;

  std::string trigger = "adis16485-dev0";
  UnservedCommands unserved;
  const IioSettings& settings() const { return settings_; }

 private:
  void set_rate(double rate_hz, Clock::Instant now) {
    rate_hz_ = rate_hz;
    from_ = now;
  }
  std::int64_t raw_acceleration(const SimOutput& output, int j) const;

  std::shared_ptr<SimBench> bench_;
  const IioSettings settings_;
  double rate_hz_;
  Clock::Instant from_{};
  std::map<std::string, std::string> values_;  ///< "CHANNEL ATTRIBUTE"
  std::map<std::string, std::string> debug_;
};

std::string IioFirmware::Machine::description() const {
  std::string xml =
      "<?xml version=\"1.0\" encoding=\"utf-8\"?><!DOCTYPE context [<!ELEMENT context (device | "
      "context-attribute)*><!ELEMENT context-attribute EMPTY><!ELEMENT device (channel | attribute | "
      "debug-attribute | buffer-attribute)*><!ELEMENT channel (scan-element?, attribute*)><!ELEMENT "
      "attribute EMPTY><!ELEMENT scan-element EMPTY><!ELEMENT debug-attribute EMPTY><!ELEMENT "
      "buffer-attribute EMPTY><!ATTLIST context name CDATA #REQUIRED version-major CDATA #REQUIRED "
      "version-minor CDATA #REQUIRED version-git CDATA #REQUIRED description CDATA #IMPLIED><!ATTLIST "
      "context-attribute name CDATA #REQUIRED value CDATA #REQUIRED><!ATTLIST device id CDATA #REQUIRED name "
      "CDATA #IMPLIED label CDATA #IMPLIED><!ATTLIST channel id CDATA #REQUIRED type (input|output) "
      "#REQUIRED name CDATA #IMPLIED><!ATTLIST scan-element index CDATA #REQUIRED format CDATA #REQUIRED "
      "scale CDATA #IMPLIED><!ATTLIST attribute name CDATA #REQUIRED filename CDATA #IMPLIED><!ATTLIST "
      "debug-attribute name CDATA #REQUIRED><!ATTLIST buffer-attribute name CDATA #REQUIRED>]><context "
      "name=\"local\" version-major=\"0\" version-minor=\"24\" version-git=\"v0.24\" description=\"Linux "
      "emulated 6.1.0 #1 SMP aarch64\"><context-attribute name=\"local,kernel\" value=\"6.1.0\" />";
  xml += fmt::format("<device id=\"{}\" name=\"{}\" >", kDevice, settings_.name);
  for (std::size_t n = 0; n < kScan.size(); ++n) {
    const std::string id(kScan[n].id);
    xml += fmt::format("<channel id=\"{}\" type=\"input\" ><scan-element index=\"{}\" format=\"{}\" />", id,
                       n, kScan[n].signed64 ? "le:S64/64&gt;&gt;0" : "be:S32/32&gt;&gt;0");
    if (!kScan[n].signed64) xml += fmt::format("<attribute name=\"raw\" filename=\"in_{}_raw\" />", id);
    for (const auto& [key, value] : values_)
      if (key.starts_with(id + " "))
        xml +=
            fmt::format("<attribute name=\"{0}\" filename=\"in_{1}_{0}\" />", key.substr(id.size() + 1), id);
    xml += "</channel>";
  }
  xml +=
      "<channel id=\"temp0\" type=\"input\" ><attribute name=\"offset\" filename=\"in_temp0_offset\" "
      "/><attribute name=\"raw\" filename=\"in_temp0_raw\" /><attribute name=\"scale\" "
      "filename=\"in_temp0_scale\" /></channel><attribute name=\"sampling_frequency\" />";
  for (const auto& [name, value] : debug_) xml += fmt::format("<debug-attribute name=\"{}\" />", name);
  xml += fmt::format("</device><device id=\"{}\" name=\"{}-dev0\" ></device></context>", kTrigger,
                     settings_.name);
  return xml;
}

/// Raw value as the part outputs it: with its own corrections, limited to its range.
std::int64_t IioFirmware::Machine::raw_acceleration(const SimOutput& output, int j) const {
  const std::string axis = std::string("accel_") + "xyz"[j];
  const double bias = std::strtod(values_.at(axis + " calibbias").c_str(), nullptr);
  const double factor = std::strtod(values_.at(axis + " calibscale").c_str(), nullptr);
  const double raw = output.value[j] * factor / kAccelerationScale + bias;
  return std::isfinite(raw) ? std::llround(std::clamp(raw, -2147483648.0, 2147483647.0)) : -2147483648LL;
}

std::string IioFirmware::Machine::scan(std::uint64_t tick, std::uint32_t mask) const {
  const Clock::Instant t = time(tick);
  const SimOutput output = bench_->output(t, tick, from_seconds(1.0 / rate_hz_));
  const BodyMotion motion = bench_->body_motion(t);
  std::string bytes;
  for (std::size_t n = 0; n < kScan.size(); ++n) {
    if ((mask >> n & 1U) == 0) continue;
    if (kScan[n].signed64) {
      bytes.resize((bytes.size() + 7) / 8 * 8, '\0');
      put(bytes, static_cast<std::uint64_t>((t - bench_->start()).count() + 1'000'000'000), 8, false);
      continue;
    }
    const int j = static_cast<int>(n % 3);
    const std::int64_t raw =
        n < 3 ? std::llround(std::clamp(motion.rate_B_radps[j] / kRateScale, -2147483648.0, 2147483647.0))
              : raw_acceleration(output, j);
    put(bytes, static_cast<std::uint64_t>(raw), 4, true);
  }
  return bytes;
}

std::optional<std::string> IioFirmware::Machine::read(const std::string& channel,
                                                      const std::string& attribute,
                                                      Clock::Instant now) const {
  if (channel.empty())
    return attribute == "sampling_frequency" ? std::optional(fmt::format("{:.6f}", rate_hz_)) : std::nullopt;
  const auto found = values_.find(channel + " " + attribute);
  if (found != values_.end()) return found->second;
  if (attribute != "raw") return std::nullopt;
  if (channel == "temp0")
    return fmt::format("{}", std::lround((bench_->temperature_degc(now) - 25.0) / 0.00565));
  for (int j = 0; j < 3; ++j) {
    if (channel == std::string("accel_") + "xyz"[j])
      return fmt::format(
          "{}", raw_acceleration(bench_->output(now, first_after(now), from_seconds(1.0 / rate_hz_)), j));
    if (channel == std::string("anglvel_") + "xyz"[j])
      return fmt::format("{}", std::llround(bench_->body_motion(now).rate_B_radps[j] / kRateScale));
  }
  return std::nullopt;
}

int IioFirmware::Machine::write(const std::string& channel, const std::string& attribute,
                                const std::string& value, Clock::Instant now) {
  char* end = nullptr;
  const double number = std::strtod(value.c_str(), &end);
  if (end == value.c_str() || !std::isfinite(number)) return kInvalid;
  if (channel.empty() && attribute == "sampling_frequency") {
    if (!(number > 0.0) || number > settings_.highest_rate_hz) return kInvalid;
    set_rate(number, now);
    return static_cast<int>(value.size());
  }
  const auto found = values_.find(channel + " " + attribute);
  if (found == values_.end()) return kNoEntry;
  if (!attribute.starts_with("calib")) return kInvalid;
  // Kernel drivers take calibbias in whole counts and calibscale in millionths.
  found->second =
      attribute == "calibbias" ? fmt::format("{:.0f}", std::trunc(number)) : fmt::format("{:.6f}", number);
  return static_cast<int>(value.size());
}

/// State of one connection.
class IioFirmware::Client {
 public:
  explicit Client(std::shared_ptr<Machine> machine) : machine_(std::move(machine)) {}

  void receive(std::string_view bytes, Clock::Instant now) {
    received_ += bytes;
    serve(now);
  }
  std::string transmit(Clock::Instant now) {
    serve(now);
    return replies_.take(now);
  }
  std::optional<Clock::Instant> next_due() const {
    auto due = replies_.next_due();
    if (wanted_scans_ > kept_.size()) {
      const Clock::Instant block = machine_->time(next_tick_ + wanted_scans_ - kept_.size() - 1);
      due = due ? std::min(*due, block) : block;
    }
    return due;
  }

 private:
  void serve(Clock::Instant now);
  void sample(Clock::Instant now);
  bool serve_block(Clock::Instant now);
  void take_line(const std::string& line, Clock::Instant now);
  void read(const std::vector<std::string>& words, Clock::Instant now);
  void begin_write(const std::vector<std::string>& words, const std::string& line, Clock::Instant now);
  int open(const std::vector<std::string>& words, Clock::Instant now);
  void read_block(const std::vector<std::string>& words, Clock::Instant now);
  void say(std::string bytes, Clock::Instant now) {
    replies_.push(std::move(bytes), now + machine_->settings().reply_delay);
  }
  void say_number(std::int64_t number, Clock::Instant now) { say(fmt::format("{}\n", number), now); }
  void say_text(const std::string& text, Clock::Instant now) {
    say(fmt::format("{}\n{}\n", text.size(), text), now);
  }
  void refuse(const std::string& line, int error, Clock::Instant now) {
    machine_->unserved.note(line, fmt::format("error {}", error));
    say_number(error, now);
  }

  std::shared_ptr<Machine> machine_;
  std::string received_;
  ReplyQueue replies_;

  bool writing_ = false;  ///< The bytes of a value follow.
  std::string channel_, attribute_;
  std::size_t value_size_ = 0;

  // The buffer.
  std::uint32_t mask_ = 0;  ///< 0: closed.
  std::size_t block_scans_ = 0;
  std::size_t blocks_ = 4;
  std::deque<std::uint64_t> kept_;  ///< Ticks.
  std::uint64_t next_tick_ = 0;
  std::size_t wanted_scans_ = 0;  ///< Scans wanted by a READBUF that waits,
  Clock::Instant asked_{};        ///< since then.
};

/// Fills the kernel's buffer up to now: the oldest samples are kept, the newest are dropped.
void IioFirmware::Client::sample(Clock::Instant now) {
  if (mask_ == 0) return;
  const std::size_t room = block_scans_ * blocks_;
  while (kept_.size() < room && machine_->time(next_tick_) <= now) {
    if (!machine_->silent_at(machine_->time(next_tick_))) kept_.push_back(next_tick_);
    ++next_tick_;
  }
  if (machine_->time(next_tick_) <= now) next_tick_ = machine_->first_after(now);
}

/// False: its samples are not complete yet.
bool IioFirmware::Client::serve_block(Clock::Instant now) {
  if (wanted_scans_ == 0) return true;
  sample(now);
  if (kept_.size() < wanted_scans_) return false;
  std::string scans;
  Clock::Instant made{};
  for (std::size_t n = 0; n < wanted_scans_; ++n) {
    made = machine_->time(kept_.front());
    scans += machine_->scan(kept_.front(), mask_);
    kept_.pop_front();
  }
  wanted_scans_ = 0;
  say(fmt::format("{}\n{:08x}\n", scans.size(), mask_) + scans, std::max(made, asked_));
  return true;
}

/// Commands in their order; none while one waits for samples.
void IioFirmware::Client::serve(Clock::Instant now) {
  while (serve_block(now)) {
    sample(now);
    if (writing_) {
      if (received_.size() < value_size_) return;
      const std::string value = received_.substr(0, value_size_);
      received_.erase(0, value_size_);
      writing_ = false;
      say_number(machine_->write(channel_, attribute_, value, now), now);
      continue;
    }
    const std::size_t end = received_.find('\n');
    if (end == std::string::npos) return;
    const std::string line = received_.substr(0, end);
    received_.erase(0, end + 1);
    take_line(line, now);
  }
}

void IioFirmware::Client::take_line(const std::string& line, Clock::Instant now) {
  const auto words = words_of(line);
  if (words.empty()) return;
  const std::string& command = words[0];
  const bool has_device = words.size() > 1 && words[1] == kDevice;
  if (command == "VERSION") return say(machine_->settings().version + "\n", now);
  if (command == "PRINT") return say_text(machine_->description(), now);
  if (command == "EXIT") return;  // The client closes the connection.
  if (command == "TIMEOUT" && words.size() == 2) return say_number(0, now);
  if (command == "READ" && words.size() > 2) return read(words, now);
  if (command == "WRITE" && words.size() > 3) return begin_write(words, line, now);
  if ((command == "GETTRIG" || command == "SETTRIG") && !machine_->settings().knows_triggers)
    return say_number(kNoEntry, now);
  if (command == "GETTRIG" && words.size() == 2) {
    if (!has_device) return say_number(words[1] == kTrigger ? kNoEntry : kNoDevice, now);
    if (machine_->trigger.empty()) return say_number(0, now);
    return say_text(machine_->trigger, now);
  }
  if (command == "SETTRIG" && has_device) {
    machine_->trigger = words.size() > 2 ? machine_->settings().name + "-dev0" : "";
    return say_number(words.size() > 2 && words[2] != kTrigger ? kNoEntry : 0, now);
  }
  if (command == "SET" && words.size() == 4 && has_device && words[2] == "BUFFERS_COUNT") {
    if (mask_ != 0) return say_number(kBusy, now);
    blocks_ = std::clamp<std::size_t>(std::strtoul(words[3].c_str(), nullptr, 10), 1, 4096);
    return say_number(0, now);
  }
  if (command == "OPEN" && words.size() >= 4) return say_number(open(words, now), now);
  if (command == "READBUF" && words.size() == 3) return read_block(words, now);
  if (command == "CLOSE" && words.size() == 2) {
    const int said = !has_device ? kNoDevice : (mask_ == 0 ? kNoAddress : 0);
    mask_ = 0;
    kept_.clear();
    return say_number(said, now);
  }
  refuse(line, kInvalid, now);
}

void IioFirmware::Client::read(const std::vector<std::string>& words, Clock::Instant now) {
  std::string line;
  for (const std::string& word : words) line += (line.empty() ? "" : " ") + word;
  if (words[1] != kDevice) return refuse(line, words[1] == kTrigger ? kNoEntry : kNoDevice, now);
  std::optional<std::string> value;
  if (words[2] == "DEBUG" && words.size() == 4)
    value = machine_->read_debug(words[3]);
  else if (words[2] == "INPUT" && words.size() == 5)
    value = machine_->read(words[3], words[4], now);
  else if (words.size() == 3)
    value = machine_->read("", words[2], now);
  if (!value) return refuse(line, kNoEntry, now);
  say_text(*value + '\0', now);
}

void IioFirmware::Client::begin_write(const std::vector<std::string>& words, const std::string& line,
                                      Clock::Instant now) {
  channel_ = words[2] == "INPUT" && words.size() == 6 ? words[3] : "";
  attribute_ = words[words.size() - 2];
  value_size_ = std::strtoul(words.back().c_str(), nullptr, 10);
  if (words[1] != kDevice || value_size_ > kMostBytes) return refuse(line, kInvalid, now);
  writing_ = true;
}

int IioFirmware::Client::open(const std::vector<std::string>& words, Clock::Instant now) {
  if (words[1] != kDevice) return kNoDevice;
  const auto scans = std::strtoul(words[2].c_str(), nullptr, 10);
  const auto mask = std::strtoul(words[3].c_str(), nullptr, 16);
  const bool usable = scans > 0 && scans < 100'000 && mask != 0 && mask < (1U << kScan.size());
  if (words[3].size() != 8 || !usable || machine_->trigger.empty()) return kInvalid;
  if (mask_ != 0) return kBusy;
  mask_ = static_cast<std::uint32_t>(mask);
  block_scans_ = scans;
  kept_.clear();
  next_tick_ = machine_->first_after(now);
  return 0;
}

void IioFirmware::Client::read_block(const std::vector<std::string>& words, Clock::Instant now) {
  if (words[1] != kDevice) return say_number(kNoDevice, now);
  if (mask_ == 0) return say_number(kBadFile, now);
  const std::size_t size = machine_->scan(next_tick_, mask_).size();
  const auto wanted = std::strtoul(words[2].c_str(), nullptr, 10);
  if (wanted < size) return say_number(0, now);
  wanted_scans_ = std::min(wanted / size, block_scans_);
  asked_ = now;
}

IioFirmware::IioFirmware(std::shared_ptr<SimBench> bench, const IioSettings& settings)
    : IioFirmware(std::make_shared<Machine>(std::move(bench), settings)) {}
IioFirmware::IioFirmware(std::shared_ptr<Machine> machine)
    : machine_(std::move(machine)), client_(std::make_unique<Client>(machine_)) {}
IioFirmware::~IioFirmware() = default;

void IioFirmware::receive(std::string_view bytes, Clock::Instant now) {
  client_->receive(bytes, now);
}
std::string IioFirmware::transmit(Clock::Instant now) {
  return client_->transmit(now);
}
std::optional<Clock::Instant> IioFirmware::next_due() const {
  return client_->next_due();
}
void IioFirmware::session_starts() {
  client_ = std::make_unique<Client>(machine_);
}
/// The computer restarts; the settings of its devices remain, as the defaults of their drivers.
void IioFirmware::power(bool on, Clock::Instant /*now*/) {
  if (on) session_starts();
}
std::shared_ptr<Firmware> IioFirmware::another_session() {
  return std::shared_ptr<Firmware>(new IioFirmware(machine_));
}
UnservedCommands& IioFirmware::unserved() {
  return machine_->unserved;
}

}  // namespace abcal::sim
