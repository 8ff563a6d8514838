#include "sim/firmware/zaber_ascii_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "sim/firmware/reply_queue.h"
#include "sim/firmware/zaber_settings.h"

namespace abcal::sim {
namespace {

constexpr std::size_t kLongestPacket = 80;  // With its line end; longer text is continued.
constexpr std::size_t kLongestCommand = 2048;
constexpr double kSpeedFactor = 1.6384;
constexpr double kAccelerationFactor = 1.6384 / 10000.0;
constexpr double kLargestAcceleration = 1e5;  // deg/s2
constexpr double kAbruptDeceleration = 1e5;   // deg/s2: estop does not use the ramp.
constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);
constexpr Clock::Duration kStallDetection = std::chrono::milliseconds(20);
constexpr std::size_t kSettingsOfAGet = 10;  // get.settings.max
constexpr int kStoredPositions = 16;

using Words = std::vector<std::string>;

/// Thrown by a command that is rejected.
struct Rejection {
  std::string_view reason;
};

Words split(std::string_view text) {
  const std::vector<std::string_view> words = pieces::words(text, " ");
  return {words.begin(), words.end()};
}

std::optional<int> whole_number(std::string_view text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error == std::errc::result_out_of_range) return std::numeric_limits<int>::max();
  if (text.empty() || error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

/// Digits, perhaps with a sign and a point: neither "1e3" nor "+1" nor "inf" is a number to a device.
double number(std::string_view text) {
  if (text.find_first_not_of("-.0123456789") != std::string_view::npos) throw Rejection{"BADDATA"};
  const auto value = pieces::number<double>(text);
  if (!value || !std::isfinite(*value)) throw Rejection{"BADDATA"};
  return *value;
}

/// Positions, speeds and the like are whole numbers.
double whole(std::string_view text) {
  const double value = number(text);
  if (value != std::floor(value)) throw Rejection{"BADDATA"};
  return value;
}

bool flag(std::string_view text) {
  if (text != "0" && text != "1") throw Rejection{"BADDATA"};
  return text == "1";
}

const std::string& only(const Words& arguments) {
  if (arguments.size() != 1) throw Rejection{"BADDATA"};
  return arguments.front();
}

std::string integer(double value) {
  return fmt::format("{}", std::llround(value));
}

/// The number that makes the sum of the bytes 0 modulo 256.
unsigned lrc(std::string_view bytes) {
  unsigned sum = 0;
  for (const char c : bytes) sum += static_cast<unsigned char>(c);
  return ((sum ^ 0xFFU) + 1U) & 0xFFU;
}

/// Whether ":CC" behind `content` is its checksum.
bool checksum_holds(std::string_view content, std::string_view digits) {
  return digits.size() == 2 && pieces::number<unsigned>(digits, 16) == lrc(content);
}

std::string joined(const Words& words, std::size_t first = 0) {
  std::string text;
  for (std::size_t n = first; n < words.size(); ++n) text += (n == first ? "" : " ") + words[n];
  return text;
}

}  // namespace

class ZaberAsciiFirmware::Chain final : public Firmware {
 public:
  Chain(std::shared_ptr<SimBench> bench, ZaberAsciiSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  void session_starts() override {
    line_.clear();
    continued_.reset();
    replies_.clear();
  }
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override { return settings_.baud; }

 private:
  struct Axis {
    bool driver_on = true;
    bool parked = false;
    bool knob = true;
    bool referenced = false;
    bool moving = false;  ///< BUSY: from the command until the motion is over.
    bool stalled = false;
    bool interrupted = false;
    Clock::Instant moving_since;
    std::optional<Clock::Instant> homing_until;
    double offset_deg = 0.0;  ///< Controller angle = zero + sign * protocol angle + offset.
    double limit_min_deg = 0.0;
    double limit_max_deg = 0.0;
    int resolution = 64;
    std::map<int, double> stored_deg;  ///< Positions of "tools storepos".
    std::map<std::string, std::string, std::less<>> kept;
  };
  struct Device {
    int number = 1;
    std::string serial;
    bool alerts = false;
    bool checksums = false;
    std::map<std::string, std::string, std::less<>> kept{};  ///< Settings that were written and do nothing.
    std::vector<std::optional<std::size_t>> axes;  ///< X or Z for each of its axes; absent: not connected.
  };
  /// One command for one device.
  struct Command {
    Device* device;
    int axis;  ///< Axis number in the command; 0: all.
    std::optional<int> id;
    bool with_checksum;  ///< The reply then has one, too.
    Words arguments;     ///< Without the name.

    /// Connected axes that the command addresses.
    std::vector<std::size_t> axes() const;
    /// "01 2 07": how its replies begin.
    std::string place() const;
  };
  struct Method {
    bool device_only;
    std::string (Chain::*run)(Command& command);
  };
  struct AxisSetting {
    std::string (Chain::*get)(std::size_t k) const;
    void (Chain::*set)(std::size_t k, const std::string& value);  ///< Null: it can only be read.
  };
  struct DeviceSetting {
    std::string (Chain::*get)(const Device& device) const;
    void (Chain::*set)(Device& device, const std::string& value);
  };

  static const std::map<std::string, Method, std::less<>>& commands();
  static const std::map<std::string, AxisSetting, std::less<>>& axis_settings();
  static const std::map<std::string, DeviceSetting, std::less<>>& device_settings();

  // Lines.
  void take_line(std::string line);
  void run(const Words& words, bool with_checksum);
  void run_on(Command command);
  void reply(const Command& command, bool accepted, const std::string& data);
  void list_commands(const Command& command);
  void put(const std::string& head, const std::string& continued_head, const std::string& text,
           bool with_checksum, Clock::Instant due);
  Words flags(const std::vector<std::size_t>& axes) const;
  std::string status(const std::vector<std::size_t>& axes) const;

  // Axes.
  void power_on(std::size_t k);
  void advance(Clock::Instant now);
  std::optional<Clock::Instant> done_at(std::size_t k, Clock::Instant now) const;
  void finish(std::size_t k, Clock::Instant t);
  bool stands_still(std::size_t k, Clock::Instant t) const;
  Device& device_of(std::size_t k, int* axis);
  bool cut_off(const Device& device, Clock::Instant t) const;
  const AxisTruth& truth(std::size_t k) const { return bench_->stage().axis(kStageAxes[k]); }
  double steps_per_turn(std::size_t k) const {
    return settings_.full_steps_per_turn[k] * axes_[k].resolution;
  }
  double to_steps(std::size_t k, double degrees) const { return degrees * steps_per_turn(k) / 360.0; }
  double to_degrees(std::size_t k, double steps) const { return steps * 360.0 / steps_per_turn(k); }
  double controller_deg(std::size_t k, Angle protocol) const;
  Angle protocol_angle(std::size_t k, double controller) const;
  void require_ready(std::size_t k) const;
  void require_idle(std::size_t k) const;
  double checked_target(std::size_t k, double steps) const;
  void start_motion(std::size_t k, double controller);
  void stop_axis(std::size_t k, bool abruptly);

  // Commands: the data of their reply.
  std::string home(Command& c);
  std::string move(Command& c);
  std::string stop(Command& c);
  std::string estop(Command& c);
  std::string get(Command& c);
  std::string get_one(const Command& c, const std::string& name);
  std::optional<std::string> get_kept(const Command& c, const std::string& name) const;
  bool set_kept(Command& c, const std::string& name, const Words& values);
  [[noreturn]] void reject_unknown(const std::string& command) const;
  std::string io(Command& c);
  std::string store_position(Command& c);
  std::string set(Command& c);
  std::string driver(Command& c);
  std::string warnings(Command& c);
  std::string tools(Command& c);
  std::string system(Command& c);
  std::string renumber(Command& c);
  std::string help(Command& c);

  // Settings of an axis.
  std::string position(std::size_t k) const;
  void set_position(std::size_t k, const std::string& value);
  std::string encoder_position(std::size_t k) const;
  std::string limit_min(std::size_t k) const { return integer(to_steps(k, axes_[k].limit_min_deg)); }
  std::string limit_max(std::size_t k) const { return integer(to_steps(k, axes_[k].limit_max_deg)); }
  void set_limit_min(std::size_t k, const std::string& value);
  void set_limit_max(std::size_t k, const std::string& value);
  std::string cycle_distance(std::size_t k) const { return integer(steps_per_turn(k)); }
  std::string home_triggered(std::size_t k) const;
  std::string speed(std::size_t k) const;
  void set_speed(std::size_t k, const std::string& value);
  std::string acceleration(std::size_t k) const;
  std::string deceleration(std::size_t k) const;
  void set_accelerations(std::size_t k, const std::string& value, bool speeding_up, bool slowing_down);
  void set_acceleration(std::size_t k, const std::string& v) { set_accelerations(k, v, true, true); }
  void set_acceleration_only(std::size_t k, const std::string& v) { set_accelerations(k, v, true, false); }
  void set_deceleration_only(std::size_t k, const std::string& v) { set_accelerations(k, v, false, true); }
  std::string resolution(std::size_t k) const { return std::to_string(axes_[k].resolution); }
  void set_resolution(std::size_t k, const std::string& value);
  std::string knob(std::size_t k) const { return axes_[k].knob ? "1" : "0"; }
  void set_knob(std::size_t k, const std::string& value) { axes_[k].knob = flag(value); }
  std::string driver_enabled(std::size_t k) const { return axes_[k].driver_on ? "1" : "0"; }
  std::string driver_temperature(std::size_t) const { return temperature(); }

  std::string busy(std::size_t k) const { return axes_[k].moving ? "1" : "0"; }
  std::string velocity(std::size_t k) const;
  std::string parked(std::size_t k) const { return axes_[k].parked ? "1" : "0"; }
  std::string encoder_count(std::size_t k) const;

  // Settings of a device.
  std::string build(const Device&) const { return settings_.build; }
  std::string uptime(const Device&) const {
    return fmt::format("{:.3f}", to_seconds(now_ - bench_->start()));
  }
  std::string device_id(const Device& d) const;
  std::string version(const Device&) const { return settings_.version; }
  std::string serial(const Device& d) const { return d.serial; }
  std::string axis_count(const Device& d) const { return std::to_string(d.axes.size()); }
  std::string device_temperature(const Device&) const { return temperature(); }
  std::string alerts(const Device& d) const { return d.alerts ? "1" : "0"; }
  void set_alerts(Device& d, const std::string& value) { d.alerts = flag(value); }
  std::string checksums(const Device& d) const { return d.checksums ? "1" : "0"; }
  void set_checksums(Device& d, const std::string& value) { d.checksums = flag(value); }
  std::string address(const Device& d) const { return std::to_string(d.number); }
  void set_address(Device& d, const std::string& value);

  std::string temperature() const { return fmt::format("{:.1f}", bench_->temperature_degc(now_)); }
  bool old_firmware() const { return settings_.version < "7"; }

  std::shared_ptr<SimBench> bench_;
  ZaberAsciiSettings settings_;
  UnservedCommands& unserved_;
  std::array<Axis, 2> axes_;
  std::vector<Device> devices_;  ///< In the order of the chain.
  ReplyQueue replies_;
  std::string line_;
  std::optional<Words> continued_;  ///< A command that is continued in the next message.
  int continuations_ = 0;
  Clock::Instant now_;
};

ZaberAsciiFirmware::Chain::Chain(std::shared_ptr<SimBench> bench, ZaberAsciiSettings settings,
                                 UnservedCommands& unserved)
    : bench_(std::move(bench)), settings_(std::move(settings)), unserved_(unserved), now_(bench_->start()) {
  std::map<int, std::vector<std::optional<std::size_t>>> found;
  for (std::size_t k = 0; k < 2; ++k) {
    if (settings_.sign[k] != 1 && settings_.sign[k] != -1)
      throw std::invalid_argument(
          fmt::format("simulated Zaber device: sign is {}, required: +1 or -1", settings_.sign[k]));
    const std::string& name = settings_.axis_names[k];
    if (name.empty()) continue;
    const Words words = split(name);
    const int device = words.size() == 2 ? whole_number(words[0]).value_or(0) : settings_.address;
    const int axis = words.size() == 1 || words.size() == 2 ? whole_number(words.back()).value_or(0) : 0;
    if (device < 1 || device > 99 || axis < 1 || axis > 9)
      throw std::invalid_argument(fmt::format(
          "simulated Zaber device: an axis is named \"{}\", required: \"DEVICE AXIS\" or an axis number",
          name));
    auto& axes = found[device];
    const auto at = static_cast<std::size_t>(axis) - 1;
    if (axes.size() <= at) axes.resize(at + 1);
    if (axes[at])
      throw std::invalid_argument(fmt::format(
          "simulated Zaber device: both axes are axis {} of device {}, required: two axes", axis, device));
    axes[at] = k;
  }
  for (const auto& [device_number, axes] : found) {
    const bool has_x = std::find(axes.begin(), axes.end(), std::size_t{0}) != axes.end();
    devices_.push_back({.number = device_number,
                        .serial = has_x ? settings_.serial_number : settings_.z_serial_number,
                        .alerts = settings_.alerts,
                        .checksums = settings_.checksums,
                        .axes = axes});
  }
  for (std::size_t k = 0; k < 2; ++k) {
    axes_[k].resolution = settings_.resolution;
    const double low = settings_.zero[k].deg() + settings_.sign[k] * truth(k).travel_min.deg();
    const double high = settings_.zero[k].deg() + settings_.sign[k] * truth(k).travel_max.deg();
    axes_[k].limit_min_deg = std::min(low, high);
    axes_[k].limit_max_deg = std::max(low, high);
    power_on(k);
  }
}

std::vector<std::size_t> ZaberAsciiFirmware::Chain::Command::axes() const {
  std::vector<std::size_t> found;
  for (std::size_t n = 0; n < device->axes.size(); ++n)
    if (device->axes[n] && (axis == 0 || static_cast<std::size_t>(axis) == n + 1))
      found.push_back(*device->axes[n]);
  return found;
}

const std::map<std::string, ZaberAsciiFirmware::Chain::Method, std::less<>>&
ZaberAsciiFirmware::Chain::commands() {
  using C = Chain;
  static const std::map<std::string, Method, std::less<>> table{
      {"driver", {false, &C::driver}},
      {"estop", {false, &C::estop}},
      {"get", {false, &C::get}},
      {"help", {true, &C::help}},
      {"io", {true, &C::io}},
      {"home", {false, &C::home}},
      {"move", {false, &C::move}},
      {"renumber", {true, &C::renumber}},
      {"set", {false, &C::set}},
      {"stop", {false, &C::stop}},
      {"system", {true, &C::system}},
      {"tools", {false, &C::tools}},
      {"warnings", {false, &C::warnings}},
  };
  return table;
}

const std::map<std::string, ZaberAsciiFirmware::Chain::AxisSetting, std::less<>>&
ZaberAsciiFirmware::Chain::axis_settings() {
  using C = Chain;
  static const std::map<std::string, AxisSetting, std::less<>> table{
      {"accel", {&C::acceleration, &C::set_acceleration}},
      {"driver.enabled", {&C::driver_enabled, nullptr}},
      {"driver.temperature", {&C::driver_temperature, nullptr}},
      {"encoder.count", {&C::encoder_count, nullptr}},
      {"encoder.pos", {&C::encoder_position, nullptr}},
      {"knob.enable", {&C::knob, &C::set_knob}},
      {"limit.cycle.dist", {&C::cycle_distance, nullptr}},
      {"limit.home.triggered", {&C::home_triggered, nullptr}},
      {"limit.max", {&C::limit_max, &C::set_limit_max}},
      {"limit.min", {&C::limit_min, &C::set_limit_min}},
      {"maxspeed", {&C::speed, &C::set_speed}},
      {"motion.accelonly", {&C::acceleration, &C::set_acceleration_only}},
      {"motion.busy", {&C::busy, nullptr}},
      {"motion.decelonly", {&C::deceleration, &C::set_deceleration_only}},
      {"parking.state", {&C::parked, nullptr}},
      {"pos", {&C::position, &C::set_position}},
      {"resolution", {&C::resolution, &C::set_resolution}},
      {"vel", {&C::velocity, nullptr}},
  };
  return table;
}

const std::map<std::string, ZaberAsciiFirmware::Chain::DeviceSetting, std::less<>>&
ZaberAsciiFirmware::Chain::device_settings() {
  using C = Chain;
  static const std::map<std::string, DeviceSetting, std::less<>> table{
      {"comm.address", {&C::address, &C::set_address}},
      {"comm.alert", {&C::alerts, &C::set_alerts}},
      {"comm.checksum", {&C::checksums, &C::set_checksums}},
      {"deviceid", {&C::device_id, nullptr}},
      {"device.id", {&C::device_id, nullptr}},
      {"system.uptime", {&C::uptime, nullptr}},
      {"version.build", {&C::build, nullptr}},
      {"system.axiscount", {&C::axis_count, nullptr}},
      {"system.serial", {&C::serial, nullptr}},
      {"system.temperature", {&C::device_temperature, nullptr}},
      {"version", {&C::version, nullptr}},
  };
  return table;
}

// Lines.

void ZaberAsciiFirmware::Chain::receive(std::string_view bytes, Clock::Instant now) {
  advance(now);
  for (const char c : bytes) {
    if (c == '\n' || c == '\r') {
      take_line(std::exchange(line_, {}));
    } else if (line_.size() <= kLongestCommand) {  // One more than the longest: no command.
      line_.push_back(c);
    }
  }
}

/// A command begins at the first '/'; characters before it are ignored. A damaged command is not answered
/// [unverified against a device].
void ZaberAsciiFirmware::Chain::take_line(std::string line) {
  const std::size_t begin = line.find('/');
  if (begin == std::string::npos || line.size() > kLongestCommand) return;
  if (std::any_of(line.begin(), line.end(), [](char c) { return c < ' ' || c > '~'; })) return;
  std::string content = line.substr(begin + 1);
  const std::size_t colon = content.rfind(':');
  const bool with_checksum = colon != std::string::npos;
  if (with_checksum) {
    if (!checksum_holds(std::string_view(content).substr(0, colon),
                        std::string_view(content).substr(colon + 1)))
      return;
    content.resize(colon);
  }
  const bool continues = content.ends_with('\\');
  if (continues) content.pop_back();
  Words words = split(content);
  const auto cont = std::find(words.begin(), words.end(), "cont");
  if (continued_ && words.end() - cont >= 2) {
    // "1 cont 2 more words": follows the command that it continues.
    if (whole_number(*(cont + 1)) != ++continuations_) return continued_.reset();
    continued_->insert(continued_->end(), cont + 2, words.end());
    words = *continued_;
  } else {
    continuations_ = 0;
  }
  continued_.reset();
  if (continues) {
    continued_ = std::move(words);
  } else {
    run(words, with_checksum);
  }
}

/// [device [axis [id]]] data. A word that is not a number ends the header.
void ZaberAsciiFirmware::Chain::run(const Words& words, bool with_checksum) {
  std::array<int, 3> header{};
  std::size_t at = 0;
  while (at < 3 && at < words.size() && whole_number(words[at])) {
    header[at] = *whole_number(words[at]);
    ++at;
  }
  const auto id = at == 3 ? std::optional(header[2]) : std::nullopt;
  if (at == 2 && at < words.size() && words[at] == "--") ++at;  // No id [unverified against a device].
  const Words data(words.begin() + static_cast<std::ptrdiff_t>(at), words.end());
  for (Device& device : devices_)
    if ((header[0] == 0 || header[0] == device.number) && !cut_off(device, now_))
      run_on({&device, header[1], id, with_checksum, data});
}

void ZaberAsciiFirmware::Chain::run_on(Command command) {
  try {
    if (command.id && (*command.id < 0 || *command.id > 99)) {
      command.id.reset();
      throw Rejection{"BADMESSAGEID"};
    }
    if (command.axis < 0 || static_cast<std::size_t>(command.axis) > command.device->axes.size())
      throw Rejection{"BADAXIS"};
    if (command.arguments.empty()) return reply(command, true, "0");
    const auto method = commands().find(command.arguments.front());
    if (method == commands().end()) reject_unknown(command.arguments.front());
    if (method->second.device_only && command.axis != 0) throw Rejection{"DEVICEONLY"};
    command.arguments.erase(command.arguments.begin());
    reply(command, true, (this->*method->second.run)(command));
    if (method->first == "help") list_commands(command);
  } catch (const Rejection& rejection) {
    reply(command, false, std::string(rejection.reason));
  }
}

std::string ZaberAsciiFirmware::Chain::Command::place() const {
  const int digit = axis >= 0 && axis <= 9 ? axis : 0;
  return fmt::format("{:02} {}{}", device->number, digit, id ? fmt::format(" {:02}", *id) : "");
}

void ZaberAsciiFirmware::Chain::reply(const Command& command, bool accepted, const std::string& data) {
  put(fmt::format("@{} {} {}", command.place(), accepted ? "OK" : "RJ", status(command.axes())),
      '#' + command.place(), data, command.with_checksum || command.device->checksums,
      now_ + settings_.reply_delay);
}

void ZaberAsciiFirmware::Chain::list_commands(const Command& command) {
  const std::string head = '#' + command.place();
  for (const auto& [name, method] : commands())
    if (!(old_firmware() && name == "driver"))
      put(head, head, name + (method.device_only ? " (device)" : " (device or axis)"),
          command.with_checksum || command.device->checksums, now_ + settings_.reply_delay);
}

/// One message, continued in info messages where it is too long for a packet.
void ZaberAsciiFirmware::Chain::put(const std::string& head, const std::string& continued_head,
                                    const std::string& text, bool with_checksum, Clock::Instant due) {
  const auto finished = [&](const std::string& line) {
    return (with_checksum ? fmt::format("{}:{:02X}", line, lrc(std::string_view(line).substr(1))) : line) +
           "\r\n";
  };
  constexpr std::size_t kRoom = kLongestPacket - std::string_view("\\:CC\r\n").size();
  std::string line = head;
  int continuations = 0;
  for (const std::string& word : split(text)) {
    if (line.size() + 1 + word.size() > kRoom) {
      replies_.push(finished(line + '\\'), due);
      line = fmt::format("{} cont {}", continued_head, ++continuations);
    }
    line += ' ' + word;
  }
  replies_.push(finished(line), due);
}

/// Highest first.
Words ZaberAsciiFirmware::Chain::flags(const std::vector<std::size_t>& axes) const {
  const bool warm = settings_.keeps_position_without_power;
  Words found;
  const auto add = [&](std::string_view flag, auto is_up) {
    if (std::any_of(axes.begin(), axes.end(), [&](std::size_t k) { return is_up(axes_[k]); }))
      found.emplace_back(flag);
  };
  add("FD", [](const Axis& a) { return !a.driver_on; });
  add("FS", [](const Axis& a) { return a.stalled; });
  add("WH", [&](const Axis& a) { return !a.referenced && warm; });
  add("WR", [&](const Axis& a) { return !a.referenced && !warm; });
  add("NI", [](const Axis& a) { return a.interrupted; });
  return found;
}

/// "BUSY WR" of some axes.
std::string ZaberAsciiFirmware::Chain::status(const std::vector<std::size_t>& axes) const {
  const Words found = flags(axes);
  const bool busy = std::any_of(axes.begin(), axes.end(), [&](std::size_t k) { return axes_[k].moving; });
  return fmt::format("{} {}", busy ? "BUSY" : "IDLE", found.empty() ? "--" : found.front());
}

// Axes.

void ZaberAsciiFirmware::Chain::power_on(std::size_t k) {
  Axis& a = axes_[k];
  const Axis before = std::exchange(a, Axis{});
  a.limit_min_deg = before.limit_min_deg;
  a.limit_max_deg = before.limit_max_deg;
  a.resolution = before.resolution;
  a.knob = before.knob;
  a.stored_deg = before.stored_deg;
  a.kept = before.kept;
  a.offset_deg = settings_.keeps_position_without_power
                     ? before.offset_deg
                     : -controller_deg(k, bench_->target(kStageAxes[k], now_));  // Reads 0 until homed.
}

/// Switches the whole line.
void ZaberAsciiFirmware::Chain::power(bool on, Clock::Instant now) {
  advance(now);
  session_starts();
  for (const Device& device : devices_) {
    for (const auto k : device.axes) {
      if (!k) continue;
      if (!on) stop_axis(*k, true);
      if (on) power_on(*k);
    }
  }
}

/// Applies all changes up to `now`, each at its time.
void ZaberAsciiFirmware::Chain::advance(Clock::Instant now) {
  for (;;) {
    std::optional<std::pair<Clock::Instant, std::size_t>> next;
    for (std::size_t k = 0; k < 2; ++k) {
      const auto done = done_at(k, now);
      if (done && *done <= now && (!next || *done < next->first)) next.emplace(*done, k);
    }
    if (!next) break;
    finish(next->second, next->first);
  }
  now_ = std::max(now_, now);
  for (std::size_t k = 0; k < 2; ++k)
    if (bench_->fault_at(FaultKind::kLostReference, now_, kStageAxes[k])) axes_[k].referenced = false;
}

/// When the motion under way ends; absent: there is none, or its end is not known.
std::optional<Clock::Instant> ZaberAsciiFirmware::Chain::done_at(std::size_t k, Clock::Instant now) const {
  const Axis& a = axes_[k];
  if (!a.moving) return std::nullopt;
  const Clock::Instant end = bench_->motion_end(kStageAxes[k], now);
  if (end == Clock::Instant::max())
    return settings_.detects_stalls && stands_still(k, now) ? std::optional(now) : std::nullopt;
  return a.homing_until ? std::max(*a.homing_until, end) : end;
}

bool ZaberAsciiFirmware::Chain::stands_still(std::size_t k, Clock::Instant t) const {
  if (t - axes_[k].moving_since < kStallDetection) return false;
  const StageAxis axis = kStageAxes[k];
  return bench_->commanded_angle(axis, t) == bench_->commanded_angle(axis, t - kStallDetection);
}

void ZaberAsciiFirmware::Chain::finish(std::size_t k, Clock::Instant t) {
  Axis& a = axes_[k];
  const StageAxis axis = kStageAxes[k];
  a.moving = false;
  const bool homed = std::exchange(a.homing_until, std::nullopt).has_value();
  if (bench_->moving(axis, t)) {  // Stalled.
    a.stalled = true;
    bench_->halt(axis, t);
  } else if (homed) {
    a.offset_deg = 0.0;
    a.referenced = true;
    a.stalled = false;
  }
  int number_of_axis = 0;
  const Device& device = device_of(k, &number_of_axis);
  if (device.alerts && !cut_off(device, t))
    put(fmt::format("!{:02} {} {}", device.number, number_of_axis, status({k})), "", "", device.checksums, t);
}

ZaberAsciiFirmware::Chain::Device& ZaberAsciiFirmware::Chain::device_of(std::size_t k, int* axis) {
  for (Device& device : devices_) {
    const auto found = std::find(device.axes.begin(), device.axes.end(), k);
    if (found == device.axes.end()) continue;
    *axis = static_cast<int>(found - device.axes.begin()) + 1;
    return device;
  }
  throw std::logic_error("simulated Zaber device: an axis that is not on the line has moved");
}

/// From the daisy chain, by a scripted fault of one of its axes.
bool ZaberAsciiFirmware::Chain::cut_off(const Device& device, Clock::Instant t) const {
  return std::any_of(device.axes.begin(), device.axes.end(), [&](const auto& k) {
    return k && bench_->fault_at(FaultKind::kLostController, t, kStageAxes[*k]);
  });
}

double ZaberAsciiFirmware::Chain::controller_deg(std::size_t k, Angle protocol) const {
  return settings_.zero[k].deg() + axes_[k].offset_deg + settings_.sign[k] * protocol.deg();
}

Angle ZaberAsciiFirmware::Chain::protocol_angle(std::size_t k, double controller) const {
  return Angle::degrees(settings_.sign[k] * (controller - settings_.zero[k].deg() - axes_[k].offset_deg));
}

void ZaberAsciiFirmware::Chain::require_ready(std::size_t k) const {
  if (!axes_[k].driver_on) throw Rejection{"DRIVERDISABLED"};
  if (axes_[k].parked || bench_->fault_at(FaultKind::kRefusedMove, now_, kStageAxes[k]))
    throw Rejection{"PARKED"};
}

void ZaberAsciiFirmware::Chain::require_idle(std::size_t k) const {
  if (axes_[k].moving) throw Rejection{"STATUSBUSY"};
}

double ZaberAsciiFirmware::Chain::checked_target(std::size_t k, double steps) const {
  const double least = std::round(to_steps(k, axes_[k].limit_min_deg));
  const double most = std::round(to_steps(k, axes_[k].limit_max_deg));
  if (steps < least || steps > most) throw Rejection{"BADDATA"};
  return to_degrees(k, steps);
}

void ZaberAsciiFirmware::Chain::start_motion(std::size_t k, double controller) {
  Axis& a = axes_[k];
  a.interrupted = a.moving;
  a.homing_until.reset();
  a.moving = true;
  a.moving_since = now_;
  bench_->move(kStageAxes[k], protocol_angle(k, controller), now_);
}

void ZaberAsciiFirmware::Chain::stop_axis(std::size_t k, bool abruptly) {
  Axis& a = axes_[k];
  if (!a.moving) return;
  const StageAxis axis = kStageAxes[k];
  const MotionLimits limits = bench_->motion_limits(axis);
  MotionLimits abrupt = limits;
  if (abruptly) abrupt.deceleration_deg_per_s2 = kAbruptDeceleration;
  bench_->set_motion_limits(axis, abrupt);
  bench_->halt(axis, now_);
  bench_->set_motion_limits(axis, limits);
  a.interrupted = true;
  a.homing_until.reset();  // A search cut short finds nothing.
}

// Commands.

std::string ZaberAsciiFirmware::Chain::home(Command& c) {
  if (!c.arguments.empty()) throw Rejection{"BADDATA"};
  if (c.axes().empty()) throw Rejection{"INACTIVE"};
  for (const std::size_t k : c.axes()) require_ready(k);
  for (const std::size_t k : c.axes()) {
    start_motion(k, axes_[k].offset_deg);  // The sensor is where a homed axis reads 0.
    axes_[k].referenced = false;
    axes_[k].homing_until = now_ + kShortestHoming;
  }
  return "0";
}

std::string ZaberAsciiFirmware::Chain::move(Command& c) {
  if (c.arguments.empty()) throw Rejection{"BADCOMMAND"};
  const std::string how = c.arguments.front();
  const Words rest(c.arguments.begin() + 1, c.arguments.end());
  const bool takes_number = how == "abs" || how == "rel" || how == "vel";
  const bool stored = how == "stored";
  if (!takes_number && !stored && how != "min" && how != "max") reject_unknown("move " + how);
  if (!takes_number && !stored && !rest.empty()) throw Rejection{"BADDATA"};
  const double value = takes_number || stored ? whole(only(rest)) : 0.0;
  if (stored && (value < 1.0 || value > kStoredPositions)) throw Rejection{"BADDATA"};
  if (c.axes().empty()) throw Rejection{"INACTIVE"};
  // All of them move, or none does.
  std::map<std::size_t, double> targets;
  for (const std::size_t k : c.axes()) {
    require_ready(k);
    const double here =
        std::round(to_steps(k, controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_))));
    const double speed_deg_per_s = std::abs(to_degrees(k, value / kSpeedFactor));
    if (how == "vel" && speed_deg_per_s > settings_.max_speed_deg_per_s) throw Rejection{"BADDATA"};
    targets[k] =
        how == "abs"   ? checked_target(k, value)
        : how == "rel" ? checked_target(k, here + value)
        : stored ? checked_target(k, std::round(to_steps(k, axes_[k].stored_deg[static_cast<int>(value)])))
        : how == "min" || (how == "vel" && value < 0.0) ? axes_[k].limit_min_deg
                                                        : axes_[k].limit_max_deg;
  }
  for (const auto& [k, target] : targets) {
    const StageAxis axis = kStageAxes[k];
    if (how == "vel" && value == 0.0) {
      stop_axis(k, false);
      continue;
    }
    const MotionLimits limits = bench_->motion_limits(axis);
    MotionLimits now = limits;
    if (how == "vel") now.speed_deg_per_s = std::abs(to_degrees(k, value / kSpeedFactor));
    bench_->set_motion_limits(axis, now);
    start_motion(k, target);
    bench_->set_motion_limits(axis, limits);
  }
  return "0";
}

std::string ZaberAsciiFirmware::Chain::stop(Command& c) {
  if (!c.arguments.empty()) throw Rejection{"BADDATA"};
  for (const std::size_t k : c.axes()) stop_axis(k, false);
  return "0";
}

std::string ZaberAsciiFirmware::Chain::estop(Command& c) {
  if (!c.arguments.empty()) throw Rejection{"BADDATA"};
  for (const std::size_t k : c.axes()) stop_axis(k, true);
  return "0";
}

void ZaberAsciiFirmware::Chain::reject_unknown(const std::string& command) const {
  unserved_.note(command, "not emulated: RJ BADCOMMAND");
  throw Rejection{"BADCOMMAND"};
}

/// One setting; from firmware 7 on several, their values behind each other with "; " between them
/// [unverified against a device].
std::string ZaberAsciiFirmware::Chain::get(Command& c) {
  if (c.arguments.empty()) throw Rejection{"BADCOMMAND"};
  if (c.arguments.size() > (old_firmware() ? 1 : kSettingsOfAGet)) throw Rejection{"BADDATA"};
  std::string values;
  for (const std::string& name : c.arguments) values += (values.empty() ? "" : "; ") + get_one(c, name);
  return values;
}

/// One value for each axis, NA for axes that are not connected.
std::string ZaberAsciiFirmware::Chain::get_one(const Command& c, const std::string& name) {
  const bool peripheral = name == "peripheralid" || (name == "peripheral.id" && !old_firmware());
  const bool new_name =
      name == "driver.enabled" || name == "device.id" || name == "motion.busy" || name == "version.build";
  if (old_firmware() && new_name) throw Rejection{"BADCOMMAND"};
  if (const auto found = device_settings().find(name); found != device_settings().end()) {
    if (c.axis != 0) throw Rejection{"DEVICEONLY"};
    return (this->*found->second.get)(*c.device);
  }
  if (const auto kept = get_kept(c, name)) return *kept;
  const auto found = axis_settings().find(name);
  if (found == axis_settings().end() && !peripheral) reject_unknown("get " + name);
  // A unit whose motor is built in has no peripheral.
  if (peripheral && c.device->axes.size() == 1) throw Rejection{"BADCOMMAND"};
  Words values;
  for (std::size_t n = 0; n < c.device->axes.size(); ++n) {
    if (c.axis != 0 && static_cast<std::size_t>(c.axis) != n + 1) continue;
    const auto k = c.device->axes[n];
    if (peripheral) {
      values.push_back(std::to_string(k ? settings_.peripheral_ids[*k] : 0U));
    } else {
      values.push_back(k ? (this->*found->second.get)(*k) : "NA");
    }
  }
  return joined(values);
}

std::optional<std::string> ZaberAsciiFirmware::Chain::get_kept(const Command& c,
                                                               const std::string& name) const {
  const ZaberSetting* setting = zaber_setting(name);
  if (setting == nullptr || (setting->since_7 && old_firmware())) return std::nullopt;
  const auto value = [&](const auto& kept) {
    const auto found = kept.find(name);
    return found == kept.end() ? std::string(setting->initial) : found->second;
  };
  if (setting->of_device) {
    if (c.axis != 0) throw Rejection{"DEVICEONLY"};
    return value(c.device->kept);
  }
  Words values;
  for (std::size_t n = 0; n < c.device->axes.size(); ++n) {
    if (c.axis != 0 && static_cast<std::size_t>(c.axis) != n + 1) continue;
    const auto k = c.device->axes[n];
    values.push_back(k ? value(axes_[*k].kept) : "NA");
  }
  return joined(values);
}

/// Whether this setting exists.
bool ZaberAsciiFirmware::Chain::set_kept(Command& c, const std::string& name, const Words& values) {
  const ZaberSetting* setting = zaber_setting(name);
  if (setting == nullptr || (setting->since_7 && old_firmware())) return false;
  if (!setting->writable) throw Rejection{"BADCOMMAND"};
  const double value = number(only(values));
  if (value < setting->lowest || value > setting->highest) throw Rejection{"BADDATA"};
  if (setting->of_device) {
    if (c.axis != 0) throw Rejection{"DEVICEONLY"};
    c.device->kept.insert_or_assign(name, values.front());
  } else {
    for (const std::size_t k : c.axes()) axes_[k].kept.insert_or_assign(name, values.front());
  }
  return true;
}

std::string ZaberAsciiFirmware::Chain::set(Command& c) {
  if (c.arguments.empty()) throw Rejection{"BADCOMMAND"};
  const std::string name = c.arguments.front();
  const Words rest(c.arguments.begin() + 1, c.arguments.end());
  if (const auto found = device_settings().find(name); found != device_settings().end()) {
    if (c.axis != 0) throw Rejection{"DEVICEONLY"};
    if (found->second.set == nullptr) throw Rejection{"BADCOMMAND"};
    (this->*found->second.set)(*c.device, only(rest));
    return "0";
  }
  if (set_kept(c, name, rest)) return "0";
  const auto found = axis_settings().find(name);
  if (found == axis_settings().end()) reject_unknown("set " + name);
  if (found->second.set == nullptr) throw Rejection{"BADCOMMAND"};
  if (c.axes().empty()) throw Rejection{"INACTIVE"};
  for (const std::size_t k : c.axes()) (this->*found->second.set)(k, only(rest));
  return "0";
}

std::string ZaberAsciiFirmware::Chain::driver(Command& c) {
  if (old_firmware() || c.arguments.empty()) throw Rejection{"BADCOMMAND"};
  const std::string& what = only(c.arguments);
  if (what != "enable" && what != "disable") throw Rejection{"BADCOMMAND"};
  if (c.axes().empty()) throw Rejection{"INACTIVE"};
  for (const std::size_t k : c.axes()) {
    if (what == "disable") stop_axis(k, true);
    axes_[k].driver_on = what == "enable";
  }
  return "0";
}

/// The present flags; "clear" then forgets those that no longer apply.
std::string ZaberAsciiFirmware::Chain::warnings(Command& c) {
  const bool clear = !c.arguments.empty();
  if (clear && only(c.arguments) != "clear") throw Rejection{"BADDATA"};
  const Words found = flags(c.axes());
  for (const std::size_t k : c.axes())
    if (clear) axes_[k].stalled = axes_[k].interrupted = false;
  return fmt::format("{:02}{}{}", found.size(), found.empty() ? "" : " ", joined(found));
}

std::string ZaberAsciiFirmware::Chain::tools(Command& c) {
  if (c.arguments.empty()) throw Rejection{"BADCOMMAND"};
  if (c.arguments.front() == "echo") return c.arguments.size() > 1 ? joined(c.arguments, 1) : "0";
  if (c.arguments.front() == "storepos") return store_position(c);
  if (c.arguments.front() != "parking") reject_unknown("tools " + c.arguments.front());
  if (c.arguments.size() != 2) throw Rejection{"BADCOMMAND"};
  const std::string& what = c.arguments[1];
  if (what == "state") {
    Words values;
    for (const std::size_t k : c.axes()) values.emplace_back(axes_[k].parked ? "1" : "0");
    return joined(values);
  }
  if (what != "park" && what != "unpark") throw Rejection{"BADCOMMAND"};
  for (const std::size_t k : c.axes()) require_idle(k);
  for (const std::size_t k : c.axes()) axes_[k].parked = what == "park";
  return "0";
}

/// "storepos 3 1000" stores, "storepos 3 current" stores the present position; "storepos 3" reports.
std::string ZaberAsciiFirmware::Chain::store_position(Command& c) {
  if (c.arguments.size() < 2 || c.arguments.size() > 3) throw Rejection{"BADDATA"};
  const double which = whole(c.arguments[1]);
  if (which < 1.0 || which > kStoredPositions) throw Rejection{"BADDATA"};
  const int n = static_cast<int>(which);
  Words values;
  for (const std::size_t k : c.axes()) {
    if (c.arguments.size() == 2) {
      values.push_back(integer(to_steps(k, axes_[k].stored_deg[n])));
      continue;
    }
    axes_[k].stored_deg[n] = c.arguments[2] == "current"
                                 ? controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_))
                                 : checked_target(k, whole(c.arguments[2]));
  }
  return values.empty() ? "0" : joined(values);
}

/// Numbers of lines: analogue out, analogue in, digital out, digital in. All are 0.
std::string ZaberAsciiFirmware::Chain::io(Command& c) {
  if (c.arguments.empty() || c.arguments.front() != "info") reject_unknown("io " + joined(c.arguments));
  return "0 0 0 0";
}

std::string ZaberAsciiFirmware::Chain::system(Command& c) {
  if (c.arguments.empty()) throw Rejection{"BADCOMMAND"};
  if (only(c.arguments) != "reset") reject_unknown("system " + c.arguments.front());
  for (const std::size_t k : c.axes()) {
    stop_axis(k, true);
    power_on(k);
  }
  return "0";
}

/// Alone: from 1 along the chain; with a number: this device.
std::string ZaberAsciiFirmware::Chain::renumber(Command& c) {
  for (const std::size_t k : c.axes()) require_idle(k);
  if (c.arguments.empty()) {
    c.device->number = static_cast<int>(c.device - devices_.data()) + 1;
  } else {
    set_address(*c.device, only(c.arguments));
  }
  return "0";
}

std::string ZaberAsciiFirmware::Chain::help(Command& c) {
  if (!c.arguments.empty()) throw Rejection{"BADDATA"};
  return "0";  // The list follows as info.
}

// Settings of an axis.

std::string ZaberAsciiFirmware::Chain::position(std::size_t k) const {
  return integer(to_steps(k, controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_))));
}

void ZaberAsciiFirmware::Chain::set_position(std::size_t k, const std::string& value) {
  require_idle(k);
  const double wanted = to_degrees(k, whole(value));
  axes_[k].offset_deg += wanted - controller_deg(k, bench_->target(kStageAxes[k], now_));
  axes_[k].referenced = true;  // Setting a position does so [unverified against a device].
}

std::string ZaberAsciiFirmware::Chain::encoder_position(std::size_t k) const {
  return fmt::format("{:.2f}", to_steps(k, controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_))));
}

std::string ZaberAsciiFirmware::Chain::encoder_count(std::size_t k) const {
  return integer(to_steps(k, controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_))));
}

/// In the unit of maxspeed, over a millisecond.
std::string ZaberAsciiFirmware::Chain::velocity(std::size_t k) const {
  constexpr Clock::Duration kSpan = std::chrono::milliseconds(1);
  const StageAxis axis = kStageAxes[k];
  const Angle turned = bench_->commanded_angle(axis, now_) -
                       bench_->commanded_angle(axis, std::max(bench_->start(), now_ - kSpan));
  return integer(settings_.sign[k] * to_steps(k, turned.deg()) / to_seconds(kSpan) * kSpeedFactor);
}

void ZaberAsciiFirmware::Chain::set_limit_min(std::size_t k, const std::string& value) {
  require_idle(k);
  const double wanted = to_degrees(k, whole(value));
  if (wanted > axes_[k].limit_max_deg) throw Rejection{"BADDATA"};
  axes_[k].limit_min_deg = wanted;
}

void ZaberAsciiFirmware::Chain::set_limit_max(std::size_t k, const std::string& value) {
  require_idle(k);
  const double wanted = to_degrees(k, whole(value));
  if (wanted < axes_[k].limit_min_deg) throw Rejection{"BADDATA"};
  axes_[k].limit_max_deg = wanted;
}

std::string ZaberAsciiFirmware::Chain::home_triggered(std::size_t k) const {
  const double from_home =
      controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_)) - axes_[k].offset_deg;
  return std::abs(to_steps(k, from_home)) < 1.0 ? "1" : "0";
}

std::string ZaberAsciiFirmware::Chain::speed(std::size_t k) const {
  return integer(to_steps(k, bench_->motion_limits(kStageAxes[k]).speed_deg_per_s) * kSpeedFactor);
}

void ZaberAsciiFirmware::Chain::set_speed(std::size_t k, const std::string& value) {
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  limits.speed_deg_per_s = to_degrees(k, whole(value) / kSpeedFactor);
  if (limits.speed_deg_per_s <= 0.0 || limits.speed_deg_per_s > settings_.max_speed_deg_per_s)
    throw Rejection{"BADDATA"};
  bench_->set_motion_limits(kStageAxes[k], limits);
}

std::string ZaberAsciiFirmware::Chain::acceleration(std::size_t k) const {
  return integer(to_steps(k, bench_->motion_limits(kStageAxes[k]).acceleration_deg_per_s2) *
                 kAccelerationFactor);
}

std::string ZaberAsciiFirmware::Chain::deceleration(std::size_t k) const {
  return integer(to_steps(k, bench_->motion_limits(kStageAxes[k]).deceleration_deg_per_s2) *
                 kAccelerationFactor);
}

void ZaberAsciiFirmware::Chain::set_accelerations(std::size_t k, const std::string& value, bool speeding_up,
                                                  bool slowing_down) {
  const double wanted = to_degrees(k, whole(value) / kAccelerationFactor);
  if (wanted <= 0.0 || wanted > kLargestAcceleration) throw Rejection{"BADDATA"};
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  if (speeding_up) limits.acceleration_deg_per_s2 = wanted;
  if (slowing_down) limits.deceleration_deg_per_s2 = wanted;
  bench_->set_motion_limits(kStageAxes[k], limits);
}

void ZaberAsciiFirmware::Chain::set_resolution(std::size_t k, const std::string& value) {
  require_idle(k);
  const double wanted = whole(value);
  if (wanted < 1.0 || wanted > 256.0) throw Rejection{"BADDATA"};
  axes_[k].resolution = static_cast<int>(wanted);  // All quantities in microsteps follow.
}

// Settings of a device.

std::string ZaberAsciiFirmware::Chain::device_id(const Device& d) const {
  return std::to_string(d.axes.size() > 1 ? settings_.controller_id : settings_.unit_id);
}

void ZaberAsciiFirmware::Chain::set_address(Device& d, const std::string& value) {
  const double wanted = whole(value);
  if (wanted < 1.0 || wanted > 99.0) throw Rejection{"BADDATA"};
  d.number = static_cast<int>(wanted);
}

std::string ZaberAsciiFirmware::Chain::transmit(Clock::Instant now) {
  advance(now);
  return replies_.take(now);
}

std::optional<Clock::Instant> ZaberAsciiFirmware::Chain::next_due() const {
  std::optional<Clock::Instant> due = replies_.next_due();
  const auto consider = [&](Clock::Instant t) { due = due ? std::min(*due, t) : t; };
  for (const Device& device : devices_) {
    if (!device.alerts) continue;  // Without alerts the end of a motion causes no output.
    for (const auto k : device.axes) {
      if (!k || !axes_[*k].moving) continue;
      if (const auto done = done_at(*k, now_)) {
        consider(*done);
      } else if (settings_.detects_stalls) {
        consider(now_ + kStallDetection);  // Looks again then.
      }
    }
  }
  return due;
}

ZaberAsciiFirmware::ZaberAsciiFirmware(std::shared_ptr<SimBench> bench, ZaberAsciiSettings settings) {
  encase(std::make_unique<Chain>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
