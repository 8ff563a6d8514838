#include "sim/firmware/vectornav_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/names.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "sim/firmware/reply_queue.h"
#include "sim/firmware/sample_grid.h"
#include "sim/firmware/vectornav_registers.h"

namespace abcal::sim {
namespace {

// Codes, registers and layouts as in docs/protocols/vectornav.md.
enum ErrorCode : unsigned {
  kBufferOverflow = 2,
  kBadChecksum = 3,
  kBadCommand = 4,
  kTooFewParameters = 5,
  kTooManyParameters = 6,
  kBadParameter = 7,
  kBadRegister = 8,
  kNotAuthorised = 9,
  kInsufficientBaud = 0x0C,
};

constexpr unsigned kImuRateHz = 800;
constexpr std::size_t kLongestCommand = 256;
constexpr std::array<unsigned, 9> kBaudRates{9600,   19200,  38400,  57600, 115200,
                                             128000, 230400, 460800, 921600};
constexpr std::array<unsigned, 11> kAsyncRates{1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200};
constexpr std::array<unsigned, 13> kAsyncTypes{0, 1, 2, 8, 10, 11, 12, 13, 14, 16, 17, 19, 20};

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
constexpr double kPressureKpa = 101.325;

/// Thrown by a command that is refused.
struct Refusal {
  ErrorCode code;
};

/// Which of its two checksums a message carries.
enum class Check { kXor, kCrc };

std::uint8_t xor_of(std::string_view text) {
  unsigned value = 0;
  for (const char c : text) value ^= static_cast<unsigned char>(c);
  return static_cast<std::uint8_t>(value);
}

/// CRC-16 CCITT, initial value 0.
std::uint16_t crc_of(std::string_view bytes) {
  unsigned crc = 0;
  for (const char c : bytes) {
    crc = ((crc >> 8U) | (crc << 8U)) & 0xFFFFU;
    crc ^= static_cast<unsigned char>(c);
    crc ^= (crc & 0xFFU) >> 4U;
    crc = (crc ^ (crc << 12U)) & 0xFFFFU;
    crc = (crc ^ ((crc & 0xFFU) << 5U)) & 0xFFFFU;
  }
  return static_cast<std::uint16_t>(crc);
}

std::string sentence(std::string_view text, Check check) {
  return check == Check::kXor ? fmt::format("${}*{:02X}\r\n", text, xor_of(text))
                              : fmt::format("${}*{:04X}\r\n", text, crc_of(text));
}

std::vector<std::string> split(std::string_view text) {
  const std::vector<std::string_view> parts = pieces::split(text, ',');
  return {parts.begin(), parts.end()};
}

unsigned number(std::string_view text, int base = 10) {
  const auto value = pieces::number<unsigned>(text, base);
  if (!value) throw Refusal{kBadParameter};
  return *value;
}

double real_number(std::string_view text) {
  const auto value = pieces::number<double>(text.starts_with('+') ? text.substr(1) : text);
  if (!value || !std::isfinite(*value)) throw Refusal{kBadParameter};
  return *value;
}

template <typename Array, typename Value>
bool contains(const Array& values, const Value& value) {
  return std::find(values.begin(), values.end(), value) != values.end();
}

template <typename Unsigned>
void put(std::string& out, Unsigned value) {
  for (std::size_t n = 0; n < sizeof(Unsigned); ++n)
    out.push_back(static_cast<char>((value >> (8U * n)) & 0xFFU));
}
void put_float(std::string& out, double value) {
  put(out, std::bit_cast<std::uint32_t>(static_cast<float>(value)));
}

using vn::Content;
using vn::fields_of_group;
using vn::Part;

struct BinaryOutput {
  unsigned mode = 0;  ///< Bit 0: serial port 1, bit 1: serial port 2.
  unsigned divisor = 1;
  unsigned groups = 0;
  std::vector<std::uint16_t> masks;

  bool on_port(unsigned port) const { return (mode >> (port - 1U) & 1U) != 0 && groups != 0; }

  std::size_t payload_size() const {
    std::size_t size = 0;
    each_part([&](const Part& part) { size += part.bytes; });
    return size;
  }
  std::size_t packet_size() const { return 2 + 2 * masks.size() + payload_size() + 2; }

  template <typename Visit>
  void each_part(Visit visit) const {
    std::size_t which = 0;
    for (unsigned group = 0; group < vn::kGroups; ++group) {
      if ((groups >> group & 1U) == 0) continue;
      const auto& fields = fields_of_group(group);
      for (std::size_t bit = 0; bit < fields.size(); ++bit)
        if ((masks[which] >> bit & 1U) != 0)
          for (const Part& part : fields[bit]) visit(part);
      ++which;
    }
  }
};

constexpr unsigned kPorts = 2;

/// Registers 5, 6 and 7.
struct SerialSettings {
  unsigned baud = 115200;
  unsigned async_type = 0;
  unsigned async_rate_hz = 40;
};

/// Settings that VNWNV saves.
struct Stored {
  std::string user_tag;
  std::array<SerialSettings, kPorts> serial;
  std::array<BinaryOutput, 3> binary;
  std::array<unsigned, 7> protocol{0, 0, 0, 0, 1, 0, 1};  ///< Register 30.
  std::map<unsigned, std::vector<double>> vectors;        ///< Values of vectornav_registers().
};

Eigen::Vector3d yaw_pitch_roll_deg(const BodyMotion& body) {
  return roll_pitch_yaw_of(body.to_ned()).reverse() * kDegreesPerRadian;
}

/// Over a period of the IMU.
Eigen::Vector3d delta_angle_deg(const BodyMotion& body, double period_s) {
  return body.rate_B_radps * period_s * kDegreesPerRadian;
}

constexpr auto kAsyncNames = names<unsigned>({{1, "VNYPR"},
                                              {2, "VNQTN"},
                                              {8, "VNQMR"},
                                              {10, "VNMAG"},
                                              {11, "VNACC"},
                                              {12, "VNGYR"},
                                              {13, "VNMAR"},
                                              {14, "VNYMR"},
                                              {16, "VNYBA"},
                                              {17, "VNYIA"}});

std::string_view async_name(unsigned type) {
  return kAsyncNames.of(type, "VNIMU");
}

}  // namespace

class VectorNavFirmware::Device final : public Firmware {
 public:
  Device(std::shared_ptr<SimBench> bench, VectorNavSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  void power(bool on, Clock::Instant now) override;
  void session_starts() override {
    in_command_ = false;
    replies_.clear();
  }
  std::optional<unsigned> line_speed() const override { return line_speed_; }
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;

 private:
  using Words = std::vector<std::string>;

  void take_line(std::string_view line);
  std::string run(const Words& words);
  std::string read_register(const Words& words) const;
  std::string write_register(const Words& words);
  void write_serial(unsigned reg, const Words& values);
  void write_binary(BinaryOutput& output, const Words& values);
  void write_numbers(unsigned reg, const Words& values);
  const VectorNavRegister& number_register(unsigned reg) const;
  std::string values_of(unsigned reg, unsigned port) const;
  unsigned port_of(const Words& words, std::size_t place) const;
  void require_link(const Stored& wanted, unsigned port) const;
  const SerialSettings& wired() const { return current_.serial[settings_.serial_port - 1]; }
  bool on_wired_port(const BinaryOutput& output) const { return output.on_port(settings_.serial_port); }
  void note_other_port(std::string_view line);
  Stored factory() const;
  void restart();

  void stream_from(Clock::Instant t);
  void advance_tick();
  bool ascii_on() const { return streaming_ && wired().async_type != 0; }
  unsigned ascii_decimation() const { return kImuRateHz / wired().async_rate_hz; }
  bool streams() const;

  struct Sample {
    std::uint64_t tick = 0;
    Eigen::Vector3d uncompensated = Eigen::Vector3d::Zero();
    Eigen::Vector3d acceleration = Eigen::Vector3d::Zero();
    double temperature_degc = 0.0;
    BodyMotion body{Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  };
  Sample sample(std::uint64_t tick) const;
  static std::string vector_text(std::string_view what, const Sample& sample);
  std::string async_text(unsigned type, const Sample& sample) const;
  static std::string delta_text(const Sample& sample);
  std::string async_sentence(const Sample& sample) const;
  std::string binary_packet(const BinaryOutput& output, const Sample& sample) const;
  void put_part(std::string& packet, const Part& part, const Sample& sample) const;

  std::shared_ptr<SimBench> bench_;
  VectorNavSettings settings_;
  UnservedCommands& unserved_;
  SampleGrid grid_;
  Stored current_;
  Stored saved_;
  bool streaming_ = true;  ///< VNASY, on the port that is wired.
  std::uint64_t next_tick_ = 0;
  mutable std::optional<Sample> last_sample_;
  std::string input_;
  bool in_command_ = false;
  unsigned line_speed_;
  ReplyQueue replies_;
  Clock::Instant now_;
  Clock::Instant started_;       ///< Switched on or reset.
  Clock::Instant silent_until_;  ///< After a reset.
};

VectorNavFirmware::Device::Device(std::shared_ptr<SimBench> bench, VectorNavSettings settings,
                                  UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      grid_(bench_->start(), kImuRateHz),
      line_speed_(settings_.baud),
      now_(bench_->start()),
      started_(now_),
      silent_until_(now_) {
  if (!contains(kBaudRates, settings_.baud))
    throw std::invalid_argument(fmt::format("simulated VectorNav: baud rate {}; required: {}", settings_.baud,
                                            "one from 9600 to 921600 that the maker lists"));
  if (settings_.serial_port < 1 || settings_.serial_port > kPorts)
    throw std::invalid_argument(
        fmt::format("simulated VectorNav: serial port {}; required: 1 or 2", settings_.serial_port));
  if (!contains(kAsyncTypes, settings_.async_type) || !contains(kAsyncRates, settings_.async_rate_hz))
    throw std::invalid_argument(fmt::format("simulated VectorNav: output type {} at {} Hz; it has no such",
                                            settings_.async_type, settings_.async_rate_hz));
  current_ = saved_ = factory();
  stream_from(now_);
}

Stored VectorNavFirmware::Device::factory() const {
  Stored stored;
  stored.user_tag = settings_.user_tag;
  stored.serial.fill({settings_.baud, settings_.async_type, settings_.async_rate_hz});
  for (const VectorNavRegister& reg : vectornav_registers()) stored.vectors[reg.id] = factory_values(reg);
  return stored;
}

void VectorNavFirmware::Device::restart() {
  current_ = saved_;
  streaming_ = true;
  started_ = silent_until_ = now_ + settings_.reset_time;
  stream_from(silent_until_);
}

void VectorNavFirmware::Device::power(bool on, Clock::Instant now) {
  now_ = now;
  session_starts();
  streaming_ = false;
  if (!on) return;
  restart();
  line_speed_ = wired().baud;
}

// Commands.

void VectorNavFirmware::Device::receive(std::string_view bytes, Clock::Instant now) {
  now_ = now;
  for (const char c : bytes) {
    if (now_ < silent_until_) continue;  // It is starting, and does not listen.
    if (c == '$') {                      // Earlier bytes were no command.
      in_command_ = true;
      input_.clear();
    } else if (c == '\r' || c == '\n') {
      if (std::exchange(in_command_, false)) take_line(input_);
    } else if (in_command_) {
      input_ += c;
      if (input_.size() > kLongestCommand) {
        in_command_ = false;
        replies_.push(
            sentence(fmt::format("VNERR,{:02X}", static_cast<unsigned>(kBufferOverflow)), Check::kXor),
            now_ + settings_.reply_delay);
      }
    }
  }
}

void VectorNavFirmware::Device::take_line(std::string_view line) {
  const std::size_t star = line.find('*');
  const std::string_view text = line.substr(0, star);
  const std::string_view sum = star == std::string_view::npos ? std::string_view() : line.substr(star + 1);
  Check check = sum.size() == 4 ? Check::kCrc : Check::kXor;
  std::string answer;
  try {
    const bool unchecked = sum == "XX" || sum == "xx" || sum == "XXXX" || sum == "xxxx";
    if (!unchecked) {
      const auto found = pieces::number<unsigned>(sum, 16);
      const unsigned expected = check == Check::kXor ? xor_of(text) : crc_of(text);
      if ((sum.size() != 2 && sum.size() != 4) || found != expected) throw Refusal{kBadChecksum};
    }
    answer = run(split(text));
    note_other_port(text);
  } catch (const Refusal& refusal) {
    answer = fmt::format("VNERR,{:02X}", static_cast<unsigned>(refusal.code));
    constexpr std::array kGaps{kBadCommand, kBadRegister, kBadParameter, kInsufficientBaud};
    if (contains(kGaps, refusal.code))
      unserved_.note(text,
                     refusal.code == kInsufficientBaud
                         ? fmt::format("more output than {} Bd carry: {}", wired().baud, answer)
                         : "refused: " + answer,
                     fmt::format("${}\r\n", line));
  }
  replies_.push(sentence(answer, check), now_ + settings_.reply_delay);
}

std::string VectorNavFirmware::Device::run(const Words& words) {
  const std::string& name = words[0];
  const auto plain = [&] {
    if (words.size() > 1) throw Refusal{kTooManyParameters};
  };
  if (name == "VNRRG") return read_register(words);
  if (name == "VNWRG") return write_register(words);
  if (name == "VNASY") {
    if (words.size() < 2) throw Refusal{kTooFewParameters};
    if (words.size() > 3) throw Refusal{kTooManyParameters};  // A third names the port.
    const unsigned on = number(words[1]);
    if (on > 1) throw Refusal{kBadParameter};
    if (port_of(words, 2) == settings_.serial_port) {
      streaming_ = on == 1;
      stream_from(now_);
    }
    return fmt::format("VNASY,{}", on);
  }
  if (name == "VNBOM") {  // One binary output, asked for.
    if (words.size() < 2) throw Refusal{kTooFewParameters};
    const unsigned which = number(words[1]);
    if (which < 1 || which > 3) throw Refusal{kBadParameter};
    const BinaryOutput& output = current_.binary[which - 1];
    const std::uint64_t next = grid_.first_after(now_);
    if (output.groups != 0)
      replies_.push(binary_packet(output, sample(next > 0 ? next - 1 : 0)), now_ + settings_.reply_delay);
    return fmt::format("VNBOM,{}", which);
  }
  if (name == "VNTAR" || name == "VNSGB") {  // Commands for attitude and gyro; nothing here depends on them.
    plain();
    return name;
  }
  if (name == "VNKMD" || name == "VNKAD") {  // A known disturbance, for its filter.
    if (words.size() < 2) throw Refusal{kTooFewParameters};
    if (words.size() > 2) throw Refusal{kTooManyParameters};
    if (number(words[1]) > 1) throw Refusal{kBadParameter};
    return name + "," + words[1];
  }
  if (name == "VNWNV") {
    plain();
    saved_ = current_;
    return "VNWNV";
  }
  if (name == "VNRFS") {
    plain();
    saved_ = factory();
    restart();
    return "VNRFS";
  }
  if (name == "VNRST") {
    plain();
    restart();
    return "VNRST";
  }
  throw Refusal{kBadCommand};
}

std::string VectorNavFirmware::Device::read_register(const Words& words) const {
  if (words.size() < 2) throw Refusal{kTooFewParameters};
  const unsigned reg = number(words[1]);
  // Registers 5 to 7 take a port.
  if (words.size() > (reg >= 5 && reg <= 7 ? 3U : 2U)) throw Refusal{kTooManyParameters};
  return fmt::format("VNRRG,{:02},{}", reg, values_of(reg, port_of(words, 2)));
}

/// The port that a command names, otherwise the one on which it arrived.
unsigned VectorNavFirmware::Device::port_of(const Words& words, std::size_t place) const {
  if (words.size() <= place) return settings_.serial_port;
  const unsigned port = number(words[place]);
  if (port < 1 || port > kPorts) throw Refusal{kBadParameter};
  return port;
}

/// Outputs that a host sets on the port that is not wired never arrive.
void VectorNavFirmware::Device::note_other_port(std::string_view line) {
  if (!line.starts_with("VNWRG")) return;
  const unsigned other = kPorts + 1 - settings_.serial_port;
  const Words words = split(line);
  const unsigned reg = number(words[1]);
  const bool ascii = reg == 6 && port_of(words, 3) == other && number(words[2]) != 0;
  const bool binary = reg >= 75 && reg <= 77 && current_.binary[reg - 75].on_port(other);
  if (ascii || binary)
    unserved_.note(line,
                   fmt::format("accepted; serial port {} is not wired ([emulator] serial_port)", other));
}

std::string VectorNavFirmware::Device::values_of(unsigned reg, unsigned port) const {
  const std::uint64_t next = grid_.first_after(now_);
  const auto measured = [&](unsigned type) { return async_text(type, sample(next > 0 ? next - 1 : 0)); };
  switch (reg) {
    case 0:
      return current_.user_tag;
    case 1:
      return settings_.model;
    case 2:
      return fmt::format("{}", settings_.hardware_revision);
    case 3:
      return settings_.serial_number;
    case 4:
      return settings_.firmware_version;
    case 5:
      return fmt::format("{}", current_.serial[port - 1].baud);
    case 6:
      return fmt::format("{}", current_.serial[port - 1].async_type);
    case 7:
      return fmt::format("{}", current_.serial[port - 1].async_rate_hz);
    case 8:
      return measured(1);
    case 9:
      return measured(2);
    case 15:
      return measured(8);
    case 17:
      return measured(10);
    case 18:
      return measured(11);
    case 19:
      return measured(12);
    case 20:
      return measured(13);
    case 27:
      return measured(14);
    case 30: {
      std::string text;
      for (const unsigned value : current_.protocol)
        text += fmt::format("{}{}", text.empty() ? "" : ",", value);
      return text;
    }
    case 54:
      return measured(19);
    case 80:  // Over one period of the IMU, as it integrates them.
      return delta_text(sample(next > 0 ? next - 1 : 0));
    case 239:
      return measured(16);
    case 240:
      return measured(17);
    case 75:
    case 76:
    case 77: {
      const BinaryOutput& output = current_.binary[reg - 75];
      std::string text = fmt::format("{},{},{:02X}", output.mode, output.divisor, output.groups);
      for (const std::uint16_t mask : output.masks) text += fmt::format(",{:04X}", mask);
      return text;
    }
    default: {
      const VectorNavRegister& known = number_register(reg);
      return register_text(known, current_.vectors.at(reg));
    }
  }
}

/// @throws Refusal if there is none
const VectorNavRegister& VectorNavFirmware::Device::number_register(unsigned reg) const {
  const VectorNavRegister* found = vectornav_register(reg);
  if (found != nullptr && found->gnss && settings_.model.starts_with("VN-1")) throw Refusal{kBadRegister};
  if (found != nullptr) return *found;
  throw Refusal{kBadRegister};
}

std::string VectorNavFirmware::Device::write_register(const Words& words) {
  if (words.size() < 3) throw Refusal{kTooFewParameters};
  const unsigned reg = number(words[1]);
  const Words values(words.begin() + 2, words.end());
  switch (reg) {
    case 0:
      if (values.size() > 1) throw Refusal{kTooManyParameters};
      if (values[0].size() > 20) throw Refusal{kBadParameter};
      current_.user_tag = values[0];
      break;
    case 5:
    case 6:
    case 7:
      write_serial(reg, values);
      break;
    case 30: {
      if (values.size() < current_.protocol.size()) throw Refusal{kTooFewParameters};
      if (values.size() > current_.protocol.size()) throw Refusal{kTooManyParameters};
      std::array<unsigned, 7> protocol{};
      for (std::size_t n = 0; n < protocol.size(); ++n) protocol[n] = number(values[n]);
      // Checksum of the asynchronous messages: 1 is XOR, 3 the CRC [unverified against a device].
      if (protocol[4] != 1 && protocol[4] != 3) throw Refusal{kBadParameter};
      current_.protocol = protocol;
      break;
    }
    case 75:
    case 76:
    case 77:
      write_binary(current_.binary[reg - 75], values);
      break;
    default:
      write_numbers(reg, values);
  }
  last_sample_.reset();
  std::string echo = fmt::format("VNWRG,{:02}", reg);
  for (const std::string& value : values) echo += "," + value;
  return echo;
}

void VectorNavFirmware::Device::write_numbers(unsigned reg, const Words& values) {
  if (vectornav_register(reg) == nullptr) {
    values_of(reg, settings_.serial_port);  // Unknown altogether: bad register.
    throw Refusal{kNotAuthorised};          // It can be read only [unverified against a device].
  }
  const VectorNavRegister& known = number_register(reg);
  if (!known.writable) throw Refusal{kNotAuthorised};
  if (values.size() < known.cells.size()) throw Refusal{kTooFewParameters};
  if (values.size() > known.cells.size()) throw Refusal{kTooManyParameters};
  std::vector<double> numbers;
  for (std::size_t n = 0; n < values.size(); ++n)
    numbers.push_back(known.cells[n] == 'u' ? number(values[n]) : real_number(values[n]));
  current_.vectors[reg] = std::move(numbers);
}

void VectorNavFirmware::Device::write_serial(unsigned reg, const Words& values) {
  if (values.size() > 2) throw Refusal{kTooManyParameters};
  const unsigned value = number(values[0]);
  const bool known = reg == 5   ? contains(kBaudRates, value)
                     : reg == 6 ? contains(kAsyncTypes, value)
                                : contains(kAsyncRates, value);
  if (!known) throw Refusal{kBadParameter};
  const unsigned port = port_of(values, 1);
  Stored wanted = current_;
  SerialSettings& serial = wanted.serial[port - 1];
  (reg == 5 ? serial.baud : reg == 6 ? serial.async_type : serial.async_rate_hz) = value;
  require_link(wanted, port);
  current_ = wanted;
  stream_from(now_);
}

void VectorNavFirmware::Device::write_binary(BinaryOutput& output, const Words& values) {
  if (values.size() < 3) throw Refusal{kTooFewParameters};
  BinaryOutput wanted;
  wanted.mode = number(values[0]);
  wanted.divisor = number(values[1]);
  wanted.groups = number(values[2], 16);
  if (wanted.mode > 3 || wanted.divisor == 0 || wanted.divisor > 0xFFFF || wanted.groups > 0x7F)
    throw Refusal{kBadParameter};
  const auto masks = static_cast<std::size_t>(std::popcount(wanted.groups));
  if (values.size() < 3 + masks) throw Refusal{kTooFewParameters};
  if (values.size() > 3 + masks) throw Refusal{kTooManyParameters};
  std::size_t which = 0;
  for (unsigned group = 0; group < vn::kGroups; ++group) {
    if ((wanted.groups >> group & 1U) == 0) continue;
    const unsigned mask = number(values[3 + which++], 16);
    const std::size_t fields = fields_of_group(group).size();
    if (mask == 0 || mask >= 1U << fields) throw Refusal{kBadParameter};
    wanted.masks.push_back(static_cast<std::uint16_t>(mask));
  }
  const BinaryOutput before = std::exchange(output, wanted);
  try {
    for (unsigned port = 1; port <= kPorts; ++port) require_link(current_, port);
  } catch (const Refusal&) {
    output = before;
    throw;
  }
  stream_from(now_);
}

/// Refuses outputs that exceed the capacity of the line.
void VectorNavFirmware::Device::require_link(const Stored& wanted, unsigned port) const {
  const SerialSettings& serial = wanted.serial[port - 1];
  double bytes_per_s = 0.0;
  if (serial.async_type != 0) {
    const Sample typical{};
    const std::size_t length = async_name(serial.async_type).size() +
                               async_text(serial.async_type, typical).size() +
                               std::string_view("$,*00\r\n").size();
    bytes_per_s += static_cast<double>(length) * serial.async_rate_hz;
  }
  for (const BinaryOutput& output : wanted.binary)
    if (output.on_port(port))
      bytes_per_s += static_cast<double>(output.packet_size()) * kImuRateHz / output.divisor;
  if (bytes_per_s > serial.baud / 10.0) throw Refusal{kInsufficientBaud};
}

// Output.

bool VectorNavFirmware::Device::streams() const {
  return ascii_on() ||
         (streaming_ && std::any_of(current_.binary.begin(), current_.binary.end(),
                                    [this](const BinaryOutput& o) { return on_wired_port(o); }));
}

void VectorNavFirmware::Device::stream_from(Clock::Instant t) {
  if (!streams()) return;
  next_tick_ = grid_.first_after(std::max(t, silent_until_)) - 1;
  advance_tick();
}

/// To the next tick at which something is due.
void VectorNavFirmware::Device::advance_tick() {
  std::uint64_t next = std::numeric_limits<std::uint64_t>::max();
  const auto consider = [&](std::uint64_t decimation) {
    next = std::min(next, (next_tick_ / decimation + 1) * decimation);
  };
  if (ascii_on()) consider(ascii_decimation());
  for (const BinaryOutput& output : current_.binary)
    if (on_wired_port(output)) consider(output.divisor);
  next_tick_ = next;
}

VectorNavFirmware::Device::Sample VectorNavFirmware::Device::sample(std::uint64_t tick) const {
  if (last_sample_ && last_sample_->tick == tick) return *last_sample_;
  const SimOutput output = bench_->output(grid_.time(tick), tick, grid_.period());
  Sample made{tick, output.value, Eigen::Vector3d::Zero(), output.temperature_degc,
              bench_->body_motion(grid_.time(tick))};
  // Register 25: matrix times (measured - offset), as the maker applies it.
  const std::vector<double>& c = current_.vectors.at(25);
  const Eigen::Vector3d centred = output.value - Eigen::Vector3d(c[9], c[10], c[11]);
  for (std::size_t row = 0; row < 3; ++row) {
    const auto r = static_cast<Eigen::Index>(row);
    made.acceleration[r] =
        c[3 * row] * centred[0] + c[3 * row + 1] * centred[1] + c[3 * row + 2] * centred[2];
  }
  last_sample_ = made;
  return made;
}

std::string VectorNavFirmware::Device::vector_text(std::string_view what, const Sample& sample) {
  const auto three = [](const Eigen::Vector3d& v, std::string_view form) {
    return fmt::format(fmt::runtime(form), v[0], v[1], v[2]);
  };
  if (what == "acc") return three(sample.acceleration, "{:+07.3f},{:+07.3f},{:+07.3f}");
  if (what == "acc_ned")
    return three(sample.body.to_ned() * sample.acceleration, "{:+07.3f},{:+07.3f},{:+07.3f}");
  if (what == "mag") return three(sample.body.field_B_gauss, "{:+08.4f},{:+08.4f},{:+08.4f}");
  if (what == "ypr") return three(yaw_pitch_roll_deg(sample.body), "{:+08.3f},{:+08.3f},{:+08.3f}");
  return three(sample.body.rate_B_radps, "{:+010.6f},{:+010.6f},{:+010.6f}");  // gyro
}

std::string VectorNavFirmware::Device::async_text(unsigned type, const Sample& sample) const {
  const auto join = [&](std::initializer_list<std::string_view> parts) {
    std::string text;
    for (const std::string_view part : parts) {
      if (!text.empty()) text += ',';
      text += vector_text(part, sample);
    }
    return text;
  };
  const auto quaternion = [&] {  // The scalar last.
    const Eigen::Quaterniond q = quaternion_of(sample.body.to_ned());
    return fmt::format("{:+.6f},{:+.6f},{:+.6f},{:+.6f}", q.x(), q.y(), q.z(), q.w());
  };
  switch (type) {
    case 1:
      return join({"ypr"});
    case 2:
      return quaternion();
    case 8:
      return fmt::format("{},{}", quaternion(), join({"mag", "acc", "gyr"}));
    case 10:
      return join({"mag"});
    case 11:
      return join({"acc"});
    case 12:
      return join({"gyr"});
    case 13:
      return join({"mag", "acc", "gyr"});
    case 14:
      return join({"ypr", "mag", "acc", "gyr"});
    case 16:
      return join({"ypr", "acc", "gyr"});
    case 17:  // The acceleration along north, east, down.
      return join({"ypr", "acc_ned", "gyr"});
    default:
      return fmt::format("{},{:+05.1f},{:+08.3f}", join({"mag", "acc", "gyr"}), sample.temperature_degc,
                         kPressureKpa);
  }
}

/// Time, angle and velocity of one period.
std::string VectorNavFirmware::Device::delta_text(const Sample& sample) {
  constexpr double kPeriodS = 1.0 / kImuRateHz;
  const Eigen::Vector3d angle = delta_angle_deg(sample.body, kPeriodS);
  const Eigen::Vector3d velocity = sample.acceleration * kPeriodS;
  return fmt::format("{:+09.6f},{:+011.6f},{:+011.6f},{:+011.6f},{:+011.6f},{:+011.6f},{:+011.6f}", kPeriodS,
                     angle[0], angle[1], angle[2], velocity[0], velocity[1], velocity[2]);
}

std::string VectorNavFirmware::Device::async_sentence(const Sample& sample) const {
  std::string text(async_name(wired().async_type));
  text += "," + async_text(wired().async_type, sample);
  // Register 30 appends a count and a status [M: what it counts].
  if (current_.protocol[0] != 0) text += fmt::format(",T{:010}", sample.tick / ascii_decimation());
  if (current_.protocol[1] != 0) text += ",S0000";
  return sentence(text, current_.protocol[4] == 3 ? Check::kCrc : Check::kXor);
}

std::string VectorNavFirmware::Device::binary_packet(const BinaryOutput& output, const Sample& sample) const {
  std::string packet;
  put(packet, static_cast<std::uint8_t>(output.groups));
  for (const std::uint16_t mask : output.masks) put(packet, mask);
  output.each_part([&](const Part& part) { put_part(packet, part, sample); });
  const std::uint16_t crc = crc_of(packet);
  packet.push_back(static_cast<char>(crc >> 8U));
  packet.push_back(static_cast<char>(crc & 0xFFU));
  return '\xFA' + packet;
}

void VectorNavFirmware::Device::put_part(std::string& packet, const Part& part, const Sample& sample) const {
  constexpr double kPeriodS = 1.0 / kImuRateHz;
  const BodyMotion& body = sample.body;
  const auto put_vector = [&](const Eigen::Vector3d& v) {
    for (const double value : v) put_float(packet, value);
  };
  switch (part.content) {
    case Content::kTime:
      return put(packet, static_cast<std::uint64_t>(
                             std::max<std::int64_t>(0, (grid_.time(sample.tick) - started_).count())));
    case Content::kAcceleration:
      return put_vector(sample.acceleration);
    case Content::kUncompensated:
      return put_vector(sample.uncompensated);
    case Content::kMagnetic:
      return put_vector(body.field_B_gauss);
    case Content::kTemperature:
      return put_float(packet, sample.temperature_degc);
    case Content::kPressure:
      return put_float(packet, kPressureKpa);
    case Content::kYawPitchRoll:
      return put_vector(yaw_pitch_roll_deg(body));
    case Content::kQuaternion: {  // The scalar last.
      const Eigen::Quaterniond q = quaternion_of(body.to_ned());
      for (const double value : {q.x(), q.y(), q.z(), q.w()}) put_float(packet, value);
      return;
    }
    case Content::kRate:
      return put_vector(body.rate_B_radps);
    case Content::kDeltaTime:
      return put_float(packet, kPeriodS);
    case Content::kDeltaAngle:
      return put_vector(delta_angle_deg(body, kPeriodS));
    case Content::kDeltaVelocity:
      return put_vector(sample.acceleration * kPeriodS);
    case Content::kRotationMatrix: {  // Row by row, north, east, down to the body [unverified against a
                                      // device].
      const Eigen::Matrix3d R_BN = body.to_ned().transpose();
      for (Eigen::Index row = 0; row < 3; ++row) put_vector(R_BN.row(row).transpose());
      return;
    }
    case Content::kMagneticNed:
      return put_vector(body.to_ned() * body.field_B_gauss);
    case Content::kAccelerationNed:
      return put_vector(body.to_ned() * sample.acceleration);
    case Content::kZero:
      packet.append(part.bytes, '\0');
  }
}

std::string VectorNavFirmware::Device::transmit(Clock::Instant now) {
  std::string out;
  while (streams() && grid_.time(next_tick_) <= now) {
    const Clock::Instant t = grid_.time(next_tick_);
    out += replies_.take(t);
    if (!bench_->fault_at(FaultKind::kNoOutput, t)) {
      const Sample made = sample(next_tick_);
      if (ascii_on() && next_tick_ % ascii_decimation() == 0) out += async_sentence(made);
      for (const BinaryOutput& output : current_.binary)
        if (on_wired_port(output) && next_tick_ % output.divisor == 0) out += binary_packet(output, made);
    }
    advance_tick();
  }
  out += replies_.take(now);
  // The answer to a change of the baud rate goes at the old one.
  if (!replies_.next_due()) line_speed_ = wired().baud;
  return out;
}

std::optional<Clock::Instant> VectorNavFirmware::Device::next_due() const {
  std::optional<Clock::Instant> due = replies_.next_due();
  if (streams()) due = due ? std::min(*due, grid_.time(next_tick_)) : grid_.time(next_tick_);
  return due;
}

VectorNavFirmware::VectorNavFirmware(std::shared_ptr<SimBench> bench, VectorNavSettings settings) {
  encase(std::make_unique<Device>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
