#include "sim/firmware/pi_gcs_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "sim/firmware/pi_gcs_parameters.h"
#include "sim/firmware/reply_queue.h"

namespace abcal::sim {
namespace {

// Error codes of GCS 2.0 (docs/protocols/pi_gcs.md).
constexpr int kNoError = 0;
constexpr int kUnknownCommand = 2;
constexpr int kCommandTooLong = 3;
constexpr int kNoReferenceOrServoOff = 5;
constexpr int kPositionOutOfLimits = 7;
constexpr int kVelocityOutOfLimits = 8;
constexpr int kStoppedByCommand = 10;
constexpr int kInvalidAxis = 15;
constexpr int kInvalidStageName = 16;
constexpr int kOutOfRange = 17;
constexpr int kDoubleAxis = 22;
constexpr int kWrongCount = 24;
constexpr int kInvalidNumber = 25;
constexpr int kMissingParameter = 26;
constexpr int kNotAllowed = 34;
constexpr int kUnknownParameter = 54;
constexpr int kWrongPassword = 56;
constexpr int kParameterProtected = 60;

constexpr std::size_t kLongestLine = 1024;
constexpr double kLargestAcceleration = 1e5;  // deg/s2
constexpr double kAbruptDeceleration = 1e5;   // deg/s2: STP and #24 do not use the ramp.
constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);

constexpr std::string_view kMemoryPassword = "100";         // SEP, WPA
constexpr std::string_view kAdvancedPassword = "advanced";  // CCL 1

std::vector<std::string> split(std::string_view line) {
  const std::vector<std::string_view> words = pieces::words(line, " \t");
  return {words.begin(), words.end()};
}

std::string upper(std::string text) {
  for (char& c : text)
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 'a' + 'A');
  return text;
}

bool is_number(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
}

/// Thrown by a command that is refused; ends up in ERR?.
struct Refusal {
  int code;
};

double number(std::string_view text) {
  const auto value = pieces::number<double>(text.starts_with('+') ? text.substr(1) : text);
  if (!value || !std::isfinite(*value)) throw Refusal{kInvalidNumber};
  return *value;
}

bool flag(std::string_view text) {
  if (text == "1") return true;
  if (text == "0") return false;
  throw Refusal{kOutOfRange};
}

unsigned parameter_id(std::string_view text) {
  const bool hex = text.size() > 2 && text[0] == '0' && (text[1] == 'x' || text[1] == 'X');
  const auto id = hex ? pieces::number<unsigned>(text.substr(2), 16) : pieces::number<unsigned>(text);
  if (!id) throw Refusal{kInvalidNumber};
  return *id;
}

std::string decimal(double value) {
  return fmt::format("{:.6f}", value == 0.0 ? 0.0 : value);
}

/// Decimal of a parameter, with no more digits than needed.
std::string short_decimal(double value) {
  return fmt::format("{:.12g}", value == 0.0 ? 0.0 : value);
}

}  // namespace

class PiGcsFirmware::Controller {
 public:
  Controller(std::shared_ptr<SimBench> bench, PiGcsSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now);
  void forget_line() {
    line_.clear();
    line_too_long_ = false;
  }
  void forget_session() {
    forget_line();
    replies.clear();
  }

  void power(bool on, Clock::Instant now);
  unsigned baud() const { return settings_.baud; }

  ReplyQueue replies;

 private:
  using Words = std::vector<std::string>;
  using Lines = std::vector<std::string>;
  struct Command {
    std::string_view help;
    Lines (Controller::*run)(const Words& arguments);
  };
  struct Axis {
    bool enabled = true;
    bool servo = false;
    bool referenced = false;
    bool reference_mode = true;
    std::optional<Clock::Instant> homing_until;
    double offset_deg = 0.0;  ///< Set by POS, on top of zero.
    double target_deg = 0.0;  ///< Controller angle.
    double home_deg = 0.0;    ///< Target of GOH, set by DFH.
    std::map<unsigned, std::string> parameters;
  };

  static const std::map<std::string, Command, std::less<>>& commands();
  bool knows(std::string_view name) const;

  void power_on();
  bool cut_off() const;
  void run_line(std::string line);
  void single_byte(char byte);
  std::optional<std::string> chain_prefix(Words& words) const;
  void reply(const std::string& prefix, const Lines& lines);
  void update();

  // Axes.
  Axis& axis(std::size_t k) { return axes_[k]; }
  std::size_t find(const std::string& name) const;
  std::vector<std::size_t> axes_or_all(const Words& arguments) const;
  std::vector<std::pair<std::size_t, std::string>> pairs(const Words& arguments) const;
  double controller_deg(std::size_t k, Angle protocol) const;
  Angle protocol_angle(std::size_t k, double controller) const;
  std::pair<double, double> travel(std::size_t k) const;
  const AxisTruth& truth(std::size_t k) const { return bench_->stage().axis(kStageAxes[k]); }
  bool in_motion(std::size_t k) const;
  void start_move(std::size_t k, double target_deg);
  void check_move(std::size_t k, double target_deg) const;
  Lines start_reference(const Words& arguments, double (Controller::*where)(std::size_t) const);
  double at_switch(std::size_t) const { return 0.0; }
  double at_negative_limit(std::size_t k) const { return travel(k).first; }
  double at_positive_limit(std::size_t k) const { return travel(k).second; }
  void stop_all(bool abruptly);
  // Parameters.
  std::string parameter(std::size_t k, const PiParameter& parameter) const;
  void check_parameter(const PiParameter& parameter, const std::string& text) const;
  void set_parameter(std::size_t k, const PiParameter& parameter, const std::string& text);
  const PiParameter& known_parameter(std::string_view command, const std::string& axis,
                                     const std::string& id) const;
  struct NamedParameter {
    std::size_t axis;
    const PiParameter* parameter;
    std::string value;  ///< Value in a set command.
  };
  std::vector<NamedParameter> named_parameters(std::string_view command, const Words& arguments,
                                               bool with_values) const;
  template <typename Value>
  Lines parameter_lines(std::string_view command, const Words& arguments, Value value) const;
  template <typename Value>
  Lines each_axis(const Words& arguments, Value value) {
    Lines lines;
    for (const std::size_t k : axes_or_all(arguments))
      lines.push_back(fmt::format("{}={}", settings_.axis_names[k], value(k)));
    return lines;
  }

  // Commands.
  Lines idn(const Words&);
  Lines csv(const Words&);
  Lines sai(const Words& a);
  Lines cst(const Words& a);
  Lines set_cst(const Words& a);
  Lines set_ccl(const Words& a);
  Lines get_ccl(const Words&) { return {std::to_string(command_level_)}; }
  Lines dfh(const Words& a);
  Lines get_dfh(const Words& a);
  Lines goh(const Words& a);
  Lines hpa(const Words&);
  Lines joystick(const Words& a);
  std::size_t joystick_number(const std::string& text) const;
  Lines get_joystick(const Words& a);
  Lines channels(const Words&) { return {"0"}; }  ///< Piezo channels: these controllers drive motors.
  Lines hand_control(const Words& a);
  Lines set_sep(const Words& a);
  Lines get_sep(const Words& a);
  Lines tio(const Words&) { return {"I=4", "O=4"}; }
  Lines tvi(const Words&) { return {"1234567890ABCDEFGHIJKLMNOPQRSTUVWXYZ-_"}; }
  Lines ver(const Words&);
  Lines vst(const Words&);
  Lines wpa(const Words& a);
  Lines hlp(const Words&);
  Lines set_eax(const Words& a);
  Lines get_eax(const Words& a);
  Lines set_svo(const Words& a);
  Lines get_svo(const Words& a);
  Lines frf(const Words& a) { return start_reference(a, &Controller::at_switch); }
  Lines fnl(const Words& a) { return start_reference(a, &Controller::at_negative_limit); }
  Lines fpl(const Words& a) { return start_reference(a, &Controller::at_positive_limit); }
  Lines get_frf(const Words& a);
  Lines yes(const Words& a);
  Lines no(const Words& a);
  Lines set_ron(const Words& a);
  Lines get_ron(const Words& a);
  Lines set_pos(const Words& a);
  Lines get_pos(const Words& a);
  Lines set_vel(const Words& a);
  Lines get_vel(const Words& a);
  Lines set_acc(const Words& a);
  Lines get_acc(const Words& a);
  Lines set_dec(const Words& a);
  Lines get_dec(const Words& a);
  Lines mov(const Words& a);
  Lines mvr(const Words& a);
  Lines get_mov(const Words& a);
  Lines get_ont(const Words& a);
  Lines get_tmn(const Words& a);
  Lines get_tmx(const Words& a);
  Lines get_pun(const Words& a);
  Lines hlt(const Words& a);
  Lines stp(const Words&);
  Lines set_spa(const Words& a);
  Lines get_spa(const Words& a);
  Lines get_err(const Words&);
  Lines rbt(const Words&);
  void start_again();

  std::shared_ptr<SimBench> bench_;
  PiGcsSettings settings_;
  UnservedCommands& unserved_;
  std::array<Axis, 2> axes_;
  std::array<std::map<unsigned, std::string>, 2> memory_;  ///< Parameters that outlast a reboot.
  int command_level_ = 0;
  std::string line_;
  bool line_too_long_ = false;
  int error_ = kNoError;
  Clock::Instant now_;
};

PiGcsFirmware::Controller::Controller(std::shared_ptr<SimBench> bench, PiGcsSettings settings,
                                      UnservedCommands& unserved)
    : bench_(std::move(bench)), settings_(std::move(settings)), unserved_(unserved), now_(bench_->start()) {
  for (const int sign : settings_.sign)
    if (sign != 1 && sign != -1)
      throw std::invalid_argument(
          fmt::format("simulated GCS controller: sign is {}, required: +1 or -1", sign));
  if (settings_.axis_names[0] == settings_.axis_names[1])
    throw std::invalid_argument(
        fmt::format("simulated GCS controller: both axes are named \"{}\", required: two names",
                    settings_.axis_names[0]));
  for (std::size_t k = 0; k < 2; ++k) {
    for (const PiParameter& one : pi_parameters()) memory_[k][one.id] = one.initial;
    memory_[k][pi_id::kSettleTime] = short_decimal(settings_.settle_s);
    const MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    memory_[k][pi_id::kVelocity] = short_decimal(limits.speed_deg_per_s);
    memory_[k][pi_id::kAcceleration] = short_decimal(limits.acceleration_deg_per_s2);
    memory_[k][pi_id::kDeceleration] = short_decimal(limits.deceleration_deg_per_s2);
  }
  power_on();
}

void PiGcsFirmware::Controller::power_on() {
  error_ = kNoError;
  command_level_ = 0;
  forget_line();
  for (std::size_t k = 0; k < 2; ++k) {
    axes_[k] = Axis{};
    axes_[k].target_deg = controller_deg(k, bench_->target(kStageAxes[k], now_));
    axes_[k].parameters = memory_[k];
  }
}

const std::map<std::string, PiGcsFirmware::Controller::Command, std::less<>>&
PiGcsFirmware::Controller::commands() {
  using C = Controller;
  static const std::map<std::string, Command, std::less<>> table{
      {"*IDN?", {"Get Device Identification", &C::idn}},
      {"ACC", {"{<AxisID> <Acceleration>} Set Closed-Loop Acceleration", &C::set_acc}},
      {"ACC?", {"[{<AxisID>}] Get Closed-Loop Acceleration", &C::get_acc}},
      {"CCL", {"<Level> [<PSWD>] Set Command Level", &C::set_ccl}},
      {"CCL?", {"Get Command Level", &C::get_ccl}},
      {"CST", {"{<AxisID> <StageName>} Set Assignment Of Stages To Axes", &C::set_cst}},
      {"CST?", {"[{<AxisID>}] Get Assignment Of Stages To Axes", &C::cst}},
      {"CSV?", {"Get Current Syntax Version", &C::csv}},
      {"DEC", {"{<AxisID> <Deceleration>} Set Closed-Loop Deceleration", &C::set_dec}},
      {"DEC?", {"[{<AxisID>}] Get Closed-Loop Deceleration", &C::get_dec}},
      {"DFH", {"[{<AxisID>}] Define Home Position", &C::dfh}},
      {"DFH?", {"[{<AxisID>}] Get Home Position Definition", &C::get_dfh}},
      {"EAX", {"{<AxisID> <EnableState>} Enable Axis", &C::set_eax}},
      {"EAX?", {"[{<AxisID>}] Get Enable Status Of Axes", &C::get_eax}},
      {"ERR?", {"Get Error Number", &C::get_err}},
      {"FNL", {"[{<AxisID>}] Fast Reference Move To Negative Limit", &C::fnl}},
      {"FPL", {"[{<AxisID>}] Fast Reference Move To Positive Limit", &C::fpl}},
      {"FRF", {"[{<AxisID>}] Fast Reference Move To Reference Switch", &C::frf}},
      {"FRF?", {"[{<AxisID>}] Get Referencing Result", &C::get_frf}},
      {"GOH", {"[{<AxisID>}] Go To Home Position", &C::goh}},
      {"HAR?", {"[{<AxisID>}] Indicate Hard Stops", &C::no}},
      {"HIN", {"{<AxisID> <State>} Set Activation State For HID Control", &C::hand_control}},
      {"HIN?", {"[{<AxisID>}] Get Activation State Of HID Control", &C::no}},
      {"HLP?", {"Get List Of Available Commands", &C::hlp}},
      {"HLT", {"[{<AxisID>}] Halt Motion Smoothly", &C::hlt}},
      {"HPA?", {"Get List Of Available Parameters", &C::hpa}},
      {"JON", {"{<JoystickID> <State>} Set Joystick Activation Status", &C::joystick}},
      {"JON?", {"[{<JoystickID>}] Get Joystick Activation Status", &C::get_joystick}},
      {"LIM?", {"[{<AxisID>}] Indicate Limit Switches", &C::yes}},
      {"MOV", {"{<AxisID> <Position>} Set Target Position", &C::mov}},
      {"MOV?", {"[{<AxisID>}] Get Target Position", &C::get_mov}},
      {"MVR", {"{<AxisID> <Distance>} Set Target Relative To Current Target", &C::mvr}},
      {"ONT?", {"[{<AxisID>}] Get On-Target State", &C::get_ont}},
      {"POS", {"{<AxisID> <Position>} Set Real Position", &C::set_pos}},
      {"POS?", {"[{<AxisID>}] Get Real Position", &C::get_pos}},
      {"PUN?", {"[{<AxisID>}] Get Axis Unit", &C::get_pun}},
      {"RBT", {"Reboot System", &C::rbt}},
      {"RON", {"{<AxisID> <ReferenceOn>} Set Reference Mode", &C::set_ron}},
      {"RON?", {"[{<AxisID>}] Get Reference Mode", &C::get_ron}},
      {"SAI?", {"[ALL] Get List Of Current Axis Identifiers", &C::sai}},
      {"SEP", {"<PSWD> {<ItemID> <PamID> <PamValue>} Set Non-Volatile Memory Parameters", &C::set_sep}},
      {"SEP?", {"[{<ItemID> <PamID>}] Get Non-Volatile Memory Parameters", &C::get_sep}},
      {"SPA", {"{<ItemID> <PamID> <PamValue>} Set Volatile Memory Parameters", &C::set_spa}},
      {"SPA?", {"[{<ItemID> <PamID>}] Get Volatile Memory Parameters", &C::get_spa}},
      {"STP", {"Stop All Axes", &C::stp}},
      {"SVO", {"{<AxisID> <ServoState>} Set Servo Mode", &C::set_svo}},
      {"SVO?", {"[{<AxisID>}] Get Servo Mode", &C::get_svo}},
      {"TIO?", {"Tell Digital I/O Lines", &C::tio}},
      {"TMN?", {"[{<AxisID>}] Get Minimum Commandable Position", &C::get_tmn}},
      {"TMX?", {"[{<AxisID>}] Get Maximum Commandable Position", &C::get_tmx}},
      {"TPC?", {"Get Number Of Piezo Channels", &C::channels}},
      {"TRS?", {"[{<AxisID>}] Indicate Reference Switch", &C::yes}},
      {"TVI?", {"Tell Valid Character Set For Axis Identifiers", &C::tvi}},
      {"VEL", {"{<AxisID> <Velocity>} Set Closed-Loop Velocity", &C::set_vel}},
      {"VEL?", {"[{<AxisID>}] Get Closed-Loop Velocity", &C::get_vel}},
      {"VER?", {"Get Versions Of Firmware And Drivers", &C::ver}},
      {"VST?", {"Get List Of Available Stages", &C::vst}},
      {"WPA", {"<PSWD> [{<ItemID> <PamID>}] Save Parameters To Non-Volatile Memory", &C::wpa}},
  };
  return table;
}

bool PiGcsFirmware::Controller::knows(std::string_view name) const {
  if (!settings_.has_enable && name.starts_with("EAX")) return false;
  if (!settings_.has_unit_query && name == "PUN?") return false;
  return commands().contains(name);
}

// Bytes.

void PiGcsFirmware::Controller::receive(std::string_view bytes, Clock::Instant now) {
  now_ = now;
  update();
  if (cut_off()) return forget_session();
  for (const char c : bytes) {
    switch (c) {
      case '\x03':
      case '\x04':
      case '\x05':
      case '\x07':
      case '\x18':
        single_byte(c);
        break;
      case '\n':
        if (line_too_long_) error_ = kCommandTooLong;
        if (!line_too_long_) run_line(std::exchange(line_, {}));
        line_.clear();
        line_too_long_ = false;
        break;
      case '\r':
        break;
      default:
        if (line_.size() < kLongestLine) {
          line_.push_back(c);
        } else {
          line_too_long_ = true;
        }
    }
  }
}

/// From the daisy chain, by a scripted fault of one of its axes.
bool PiGcsFirmware::Controller::cut_off() const {
  for (std::size_t k = 0; k < 2; ++k)
    if (!settings_.axis_names[k].empty() && bench_->fault_at(FaultKind::kLostController, now_, kStageAxes[k]))
      return true;
  return false;
}

/// Takes the address off the words. Absent: the line is for another controller of the chain.
std::optional<std::string> PiGcsFirmware::Controller::chain_prefix(Words& words) const {
  if (words.empty() || !is_number(words.front()))
    return settings_.address == 1 ? std::optional<std::string>("") : std::nullopt;
  const std::string address = words.front();
  words.erase(words.begin());
  if (!words.empty() && words.front() == "0") words.erase(words.begin());  // the host's own address
  if (address != std::to_string(settings_.address)) return std::nullopt;
  return fmt::format("0 {} ", address);
}

void PiGcsFirmware::Controller::run_line(std::string line) {
  Words words = split(line);
  if (words.empty()) return;
  const std::optional<std::string> prefix = chain_prefix(words);
  if (!prefix || words.empty()) return;
  const std::string name = upper(words.front());
  words.erase(words.begin());
  if (!knows(name)) {
    error_ = kUnknownCommand;
    unserved_.note(name, "not emulated: error 2, no answer", line);
    return;
  }
  try {
    const Lines lines = (this->*commands().find(name)->second.run)(words);
    if (!lines.empty()) reply(*prefix, lines);
  } catch (const Refusal& refusal) {
    error_ = refusal.code;  // a refused query does not answer
  }
}

void PiGcsFirmware::Controller::single_byte(char byte) {
  // In a daisy chain the address precedes it, with no line end.
  Words words = split(line_);
  std::string prefix;
  if (!words.empty()) {
    const std::optional<std::string> found = chain_prefix(words);
    if (words.empty()) line_.clear();
    if (words.empty() && !found) return;
    if (words.empty()) prefix = *found;
  } else if (settings_.address != 1) {
    return;
  }
  switch (byte) {
    case '\x03':
      reply(prefix, get_pos({}));
      return;
    case '\x04': {
      std::string status = "0x";
      for (const std::size_t k : axes_or_all({})) {
        unsigned bits = 0;
        if (axes_[k].servo) bits |= 0x1000U;
        if (in_motion(k)) bits |= 0x2000U;
        if (axes_[k].homing_until) bits |= 0x4000U;
        status += fmt::format("{:04X}", bits);
      }
      reply(prefix, {status});
      return;
    }
    case '\x05': {
      unsigned mask = 0;
      unsigned bit = 1;
      for (const std::size_t k : axes_or_all({})) {
        if (in_motion(k)) mask |= bit;
        bit <<= 1U;
      }
      reply(prefix, {fmt::format("{:X}", mask)});
      return;
    }
    case '\x07': {
      const bool homing = axes_[0].homing_until || axes_[1].homing_until;
      reply(prefix, {std::string(1, homing ? '\xB0' : '\xB1')});
      return;
    }
    default:
      stop_all(true);
  }
}

void PiGcsFirmware::Controller::reply(const std::string& prefix, const Lines& lines) {
  std::string bytes = prefix;
  for (std::size_t n = 0; n < lines.size(); ++n) bytes += lines[n] + (n + 1 < lines.size() ? " \n" : "\n");
  replies.push(std::move(bytes), now_ + settings_.reply_delay);
}

// Axes.

void PiGcsFirmware::Controller::update() {
  for (std::size_t k = 0; k < 2; ++k) {
    Axis& a = axes_[k];
    if (a.homing_until) a.homing_until = std::max(*a.homing_until, bench_->motion_end(kStageAxes[k], now_));
    if (a.homing_until && now_ >= *a.homing_until) {
      a.homing_until.reset();
      a.referenced = true;
    }
    if (bench_->fault_at(FaultKind::kLostReference, now_, kStageAxes[k])) a.referenced = false;
  }
}

std::size_t PiGcsFirmware::Controller::find(const std::string& name) const {
  for (std::size_t k = 0; k < 2; ++k)
    if (!name.empty() && settings_.axis_names[k] == name) return k;
  throw Refusal{kInvalidAxis};
}

std::vector<std::size_t> PiGcsFirmware::Controller::axes_or_all(const Words& arguments) const {
  std::vector<std::size_t> found;
  for (const std::string& name : arguments) found.push_back(find(name));
  for (std::size_t k = 0; arguments.empty() && k < 2; ++k)
    if (!settings_.axis_names[k].empty()) found.push_back(k);
  return found;
}

std::vector<std::pair<std::size_t, std::string>> PiGcsFirmware::Controller::pairs(
    const Words& arguments) const {
  if (arguments.empty()) throw Refusal{kMissingParameter};
  std::vector<std::pair<std::size_t, std::string>> found;
  for (std::size_t n = 0; n < arguments.size(); n += 2) {
    const std::size_t k = find(arguments[n]);
    if (n + 1 >= arguments.size()) throw Refusal{kWrongCount};
    for (const auto& before : found)
      if (before.first == k) throw Refusal{kDoubleAxis};
    found.emplace_back(k, arguments[n + 1]);
  }
  return found;
}

double PiGcsFirmware::Controller::controller_deg(std::size_t k, Angle protocol) const {
  return settings_.zero[k].deg() + axes_[k].offset_deg + settings_.sign[k] * protocol.deg();
}

Angle PiGcsFirmware::Controller::protocol_angle(std::size_t k, double controller) const {
  return Angle::degrees(settings_.sign[k] * (controller - settings_.zero[k].deg() - axes_[k].offset_deg));
}

std::pair<double, double> PiGcsFirmware::Controller::travel(std::size_t k) const {
  const double a = controller_deg(k, truth(k).travel_min);
  const double b = controller_deg(k, truth(k).travel_max);
  return {std::min(a, b), std::max(a, b)};
}

bool PiGcsFirmware::Controller::in_motion(std::size_t k) const {
  return axes_[k].homing_until.has_value() || bench_->moving(kStageAxes[k], now_);
}

void PiGcsFirmware::Controller::check_move(std::size_t k, double target_deg) const {
  if (!axes_[k].referenced || !axes_[k].servo || !axes_[k].enabled) throw Refusal{kNoReferenceOrServoOff};
  const auto [lowest, highest] = travel(k);
  if (target_deg < lowest || target_deg > highest) throw Refusal{kPositionOutOfLimits};
  if (bench_->fault_at(FaultKind::kRefusedMove, now_, kStageAxes[k])) throw Refusal{kNotAllowed};
}

void PiGcsFirmware::Controller::start_move(std::size_t k, double target_deg) {
  axes_[k].target_deg = target_deg;
  bench_->move(kStageAxes[k], protocol_angle(k, target_deg), now_);
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::start_reference(
    const Words& arguments, double (Controller::*where)(std::size_t) const) {
  const std::vector<std::size_t> wanted = axes_or_all(arguments);
  for (const std::size_t k : wanted)
    if (!axes_[k].servo) throw Refusal{kNoReferenceOrServoOff};
  for (const std::size_t k : wanted) {
    axes_[k].offset_deg = 0.0;
    axes_[k].referenced = false;
    start_move(k, (this->*where)(k));
    axes_[k].homing_until = now_ + kShortestHoming;
  }
  return {};
}

void PiGcsFirmware::Controller::stop_all(bool abruptly) {
  for (const std::size_t k : axes_or_all({})) {
    const StageAxis axis = kStageAxes[k];
    const MotionLimits limits = bench_->motion_limits(axis);
    MotionLimits abrupt = limits;
    if (abruptly) abrupt.deceleration_deg_per_s2 = kAbruptDeceleration;
    bench_->set_motion_limits(axis, abrupt);
    if (in_motion(k)) {
      bench_->halt(axis, now_);
      axes_[k].target_deg = controller_deg(k, bench_->target(axis, now_));
    }
    bench_->set_motion_limits(axis, limits);
    axes_[k].homing_until.reset();  // a search cut short finds nothing
  }
  error_ = kStoppedByCommand;
}

// Commands. A set command answers nothing.

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::idn(const Words&) {
  if (settings_.short_identity)
    return {fmt::format("(c)2013 Physik Instrumente(PI) Karlsruhe, {} Version {}", settings_.model,
                        settings_.firmware_version)};
  return {fmt::format("(c)2013 Physik Instrumente (PI) GmbH & Co. KG, {}, {}, {}", settings_.model,
                      settings_.serial_number, settings_.firmware_version)};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::csv(const Words&) {
  return {"2.0"};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::sai(const Words& a) {
  if (!a.empty() && (a.size() > 1 || upper(a.front()) != "ALL")) throw Refusal{kOutOfRange};
  Lines lines;
  for (const std::size_t k : axes_or_all({})) lines.push_back(settings_.axis_names[k]);
  return lines;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::cst(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return settings_.stage_names[k]; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::hlp(const Words&) {
  Lines lines{"The following commands are available:",
              "#3 Get Real Time Position",
              "#4 Request Status Register",
              "#5 Request Motion Status",
              "#7 Request Controller Ready Status",
              "#24 Stop All Axes"};
  for (const auto& [name, command] : commands()) {
    if (!knows(name)) continue;
    lines.push_back(fmt::format("{} {}", name, command.help));
  }
  lines.emplace_back("end of help");
  return lines;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_eax(const Words& a) {
  for (const auto& [k, value] : pairs(a)) axes_[k].enabled = flag(value);
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_eax(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return axes_[k].enabled ? 1 : 0; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_svo(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted) flag(value);  // all or nothing
  for (const auto& [k, value] : wanted) {
    axes_[k].servo = flag(value);
    if (axes_[k].servo || !in_motion(k)) continue;
    axes_[k].homing_until.reset();
    bench_->halt(kStageAxes[k], now_);
  }
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_svo(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return axes_[k].servo ? 1 : 0; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_frf(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return axes_[k].referenced ? 1 : 0; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::yes(const Words& a) {
  return each_axis(a, [](std::size_t) { return 1; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::no(const Words& a) {
  return each_axis(a, [](std::size_t) { return 0; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_ron(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted) flag(value);
  for (const auto& [k, value] : wanted) axes_[k].reference_mode = flag(value);
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_ron(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return axes_[k].reference_mode ? 1 : 0; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_pos(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted) {
    number(value);
    // Only where the reference mode is off, and not on the way: which code a controller gives is not known.
    if (axes_[k].reference_mode || in_motion(k)) throw Refusal{kNotAllowed};
  }
  for (const auto& [k, value] : wanted) {
    axes_[k].offset_deg += number(value) - controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_));
    axes_[k].target_deg = number(value);
    axes_[k].referenced = true;
  }
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_pos(const Words& a) {
  return each_axis(a, [&](std::size_t k) {
    return decimal(controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_)));
  });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_vel(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted)
    if (!(number(value) > 0.0 && number(value) <= settings_.max_speed_deg_per_s))
      throw Refusal{kVelocityOutOfLimits};
  for (const auto& [k, value] : wanted) {
    MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    limits.speed_deg_per_s = number(value);
    bench_->set_motion_limits(kStageAxes[k], limits);
  }
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_vel(const Words& a) {
  return each_axis(
      a, [&](std::size_t k) { return decimal(bench_->motion_limits(kStageAxes[k]).speed_deg_per_s); });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_acc(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted)
    if (!(number(value) > 0.0 && number(value) <= kLargestAcceleration)) throw Refusal{kOutOfRange};
  for (const auto& [k, value] : wanted) {
    MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    limits.acceleration_deg_per_s2 = number(value);
    bench_->set_motion_limits(kStageAxes[k], limits);
  }
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_acc(const Words& a) {
  return each_axis(a, [&](std::size_t k) {
    return decimal(bench_->motion_limits(kStageAxes[k]).acceleration_deg_per_s2);
  });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_dec(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted)
    if (!(number(value) > 0.0 && number(value) <= kLargestAcceleration)) throw Refusal{kOutOfRange};
  for (const auto& [k, value] : wanted) {
    MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    limits.deceleration_deg_per_s2 = number(value);
    bench_->set_motion_limits(kStageAxes[k], limits);
  }
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_dec(const Words& a) {
  return each_axis(a, [&](std::size_t k) {
    return decimal(bench_->motion_limits(kStageAxes[k]).deceleration_deg_per_s2);
  });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::mov(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted) check_move(k, number(value));  // all axes move, or none does
  for (const auto& [k, value] : wanted) start_move(k, number(value));
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::mvr(const Words& a) {
  const auto wanted = pairs(a);
  for (const auto& [k, value] : wanted) check_move(k, axes_[k].target_deg + number(value));
  for (const auto& [k, value] : wanted) start_move(k, axes_[k].target_deg + number(value));
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_mov(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return decimal(axes_[k].target_deg); });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_ont(const Words& a) {
  return each_axis(a, [&](std::size_t k) {
    if (in_motion(k)) return 0;
    const Clock::Duration since = now_ - bench_->motion_end(kStageAxes[k], now_);
    return since >= from_seconds(number(axes_[k].parameters.at(pi_id::kSettleTime))) ? 1 : 0;
  });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_tmn(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return decimal(travel(k).first); });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_tmx(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return decimal(travel(k).second); });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_pun(const Words& a) {
  return each_axis(a, [](std::size_t) { return "DEG"; });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::hlt(const Words& a) {
  for (const std::size_t k : axes_or_all(a)) {
    axes_[k].homing_until.reset();
    if (!bench_->moving(kStageAxes[k], now_)) continue;
    bench_->halt(kStageAxes[k], now_);
    axes_[k].target_deg = controller_deg(k, bench_->target(kStageAxes[k], now_));
  }
  error_ = kStoppedByCommand;
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::stp(const Words&) {
  stop_all(true);
  return {};
}

// Parameters.

/// Most are only kept; these are the stage's.
std::string PiGcsFirmware::Controller::parameter(std::size_t k, const PiParameter& parameter) const {
  const MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  switch (parameter.id) {
    case pi_id::kMaxVelocity:
      return short_decimal(settings_.max_speed_deg_per_s);
    case pi_id::kAcceleration:
      return short_decimal(limits.acceleration_deg_per_s2);
    case pi_id::kDeceleration:
      return short_decimal(limits.deceleration_deg_per_s2);
    case pi_id::kVelocity:
      return short_decimal(limits.speed_deg_per_s);
    case pi_id::kMaxAcceleration:
    case pi_id::kMaxDeceleration:
      return short_decimal(kLargestAcceleration);
    case pi_id::kNegativeLimit:
      return short_decimal(travel(k).first);
    case pi_id::kPositiveLimit:
      return short_decimal(travel(k).second);
    case pi_id::kStageName:
      return settings_.stage_names[k];
    default:
      return axes_[k].parameters.at(parameter.id);
  }
}

void PiGcsFirmware::Controller::check_parameter(const PiParameter& parameter, const std::string& text) const {
  if (parameter.write_level > command_level_) throw Refusal{kParameterProtected};
  const double value = number(text);
  if (value < 0.0) throw Refusal{kOutOfRange};
  const bool ramp = parameter.id == pi_id::kAcceleration || parameter.id == pi_id::kDeceleration;
  if (ramp && !(value > 0.0 && value <= kLargestAcceleration)) throw Refusal{kOutOfRange};
  if (parameter.id == pi_id::kVelocity && !(value > 0.0 && value <= settings_.max_speed_deg_per_s))
    throw Refusal{kVelocityOutOfLimits};
}

void PiGcsFirmware::Controller::set_parameter(std::size_t k, const PiParameter& parameter,
                                              const std::string& text) {
  axes_[k].parameters[parameter.id] = text;
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  if (parameter.id == pi_id::kAcceleration) limits.acceleration_deg_per_s2 = number(text);
  if (parameter.id == pi_id::kDeceleration) limits.deceleration_deg_per_s2 = number(text);
  if (parameter.id == pi_id::kVelocity) limits.speed_deg_per_s = number(text);
  bench_->set_motion_limits(kStageAxes[k], limits);
}

const PiParameter& PiGcsFirmware::Controller::known_parameter(std::string_view command,
                                                              const std::string& axis,
                                                              const std::string& id) const {
  if (const PiParameter* found = pi_parameter(parameter_id(id))) return *found;
  unserved_.note(fmt::format("{} {} {}", command, axis, id), "not emulated: error 54, no answer");
  throw Refusal{kUnknownParameter};
}

std::vector<PiGcsFirmware::Controller::NamedParameter> PiGcsFirmware::Controller::named_parameters(
    std::string_view command, const Words& arguments, bool with_values) const {
  const std::size_t size = with_values ? 3 : 2;
  if (arguments.size() % size != 0) throw Refusal{kWrongCount};
  std::vector<NamedParameter> named;
  for (std::size_t n = 0; n < arguments.size(); n += size) {
    const std::size_t k = find(arguments[n]);
    const PiParameter& parameter = known_parameter(command, arguments[n], arguments[n + 1]);
    if (with_values) check_parameter(parameter, arguments[n + 2]);
    named.push_back({k, &parameter, with_values ? arguments[n + 2] : ""});
  }
  return named;
}

/// "1 0x4A=1.5"; without arguments all of them.
template <typename Value>
PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::parameter_lines(std::string_view command,
                                                                            const Words& arguments,
                                                                            Value value) const {
  std::vector<NamedParameter> named = named_parameters(command, arguments, false);
  if (arguments.empty()) {
    for (const std::size_t k : axes_or_all({}))
      for (const PiParameter& parameter : pi_parameters()) named.push_back({k, &parameter, ""});
  }
  Lines lines;
  for (const NamedParameter& one : named)
    lines.push_back(fmt::format("{} 0x{:X}={}", settings_.axis_names[one.axis], one.parameter->id,
                                value(one.axis, *one.parameter)));
  return lines;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_spa(const Words& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  for (const NamedParameter& one : named_parameters("SPA", a, true))  // all, or none
    set_parameter(one.axis, *one.parameter, one.value);
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_spa(const Words& a) {
  return parameter_lines("SPA?", a,
                         [this](std::size_t k, const PiParameter& one) { return parameter(k, one); });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_sep(const Words& a) {
  if (a.size() < 2) throw Refusal{kMissingParameter};
  if (a.front() != kMemoryPassword) throw Refusal{kWrongPassword};
  for (const NamedParameter& one : named_parameters("SEP", {a.begin() + 1, a.end()}, true))
    memory_[one.axis][one.parameter->id] = one.value;
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_sep(const Words& a) {
  return parameter_lines("SEP?", a, [this](std::size_t k, const PiParameter& one) {
    const std::string& stored = memory_[k].at(one.id);
    return stored.empty() ? parameter(k, one) : stored;
  });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::wpa(const Words& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  if (a.front() != kMemoryPassword) throw Refusal{kWrongPassword};
  const std::vector<NamedParameter> named = named_parameters("WPA", {a.begin() + 1, a.end()}, false);
  for (const NamedParameter& one : named)
    memory_[one.axis][one.parameter->id] = parameter(one.axis, *one.parameter);
  if (!named.empty()) return {};
  for (const std::size_t k : axes_or_all({}))
    for (const PiParameter& one : pi_parameters()) memory_[k][one.id] = parameter(k, one);
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::hpa(const Words&) {
  Lines lines{"The following parameters are available:"};
  for (const PiParameter& one : pi_parameters())
    lines.push_back(fmt::format("0x{:X}=\t{}\t1\t{}\tmotorcontroller\t{}", one.id, one.write_level, one.type,
                                one.description));
  lines.emplace_back("end of help");
  return lines;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_ccl(const Words& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  if (a.front() != "0" && a.front() != "1") throw Refusal{kOutOfRange};
  const bool advanced = a.front() == "1";
  if (advanced && (a.size() < 2 || a[1] != kAdvancedPassword)) throw Refusal{kWrongPassword};
  command_level_ = advanced ? 1 : 0;
  return {};
}

// The rest.

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_cst(const Words& a) {
  // The type of the simulated stage cannot be changed.
  for (const auto& [k, value] : pairs(a))
    if (value != settings_.stage_names[k]) throw Refusal{kInvalidStageName};
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::vst(const Words&) {
  Lines names{settings_.stage_names[0]};
  if (settings_.stage_names[1] != names.front()) names.push_back(settings_.stage_names[1]);
  names.emplace_back("NOSTAGE");
  return names;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::ver(const Words&) {
  return {fmt::format("FW_ARM: V{}", settings_.firmware_version)};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::dfh(const Words& a) {
  for (const std::size_t k : axes_or_all(a))
    axes_[k].home_deg = controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_));
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_dfh(const Words& a) {
  return each_axis(a, [&](std::size_t k) { return decimal(axes_[k].home_deg); });
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::goh(const Words& a) {
  const std::vector<std::size_t> wanted = axes_or_all(a);
  for (const std::size_t k : wanted) check_move(k, axes_[k].home_deg);
  for (const std::size_t k : wanted) start_move(k, axes_[k].home_deg);
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::joystick(const Words& a) {
  if (a.size() < 2) throw Refusal{kMissingParameter};
  joystick_number(a[0]);
  if (flag(a[1])) throw Refusal{kNotAllowed};  // No joystick is connected.
  return {};
}

/// There is a connector for each axis of the controller [unverified against a device].
std::size_t PiGcsFirmware::Controller::joystick_number(const std::string& text) const {
  const double wanted = number(text);
  if (!(wanted >= 1.0 && wanted <= static_cast<double>(axes_or_all({}).size()))) throw Refusal{kOutOfRange};
  return static_cast<std::size_t>(wanted);
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_joystick(const Words& a) {
  Lines lines;
  for (const std::string& each : a) lines.push_back(fmt::format("{}=0", joystick_number(each)));
  for (std::size_t n = 1; a.empty() && n <= axes_or_all({}).size(); ++n)
    lines.push_back(fmt::format("{}=0", n));
  return lines;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::hand_control(const Words& a) {
  for (const auto& [k, value] : pairs(a))
    if (flag(value)) throw Refusal{kNotAllowed};  // No device is connected.
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_err(const Words&) {
  return {std::to_string(std::exchange(error_, kNoError))};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::rbt(const Words&) {
  stop_all(true);
  start_again();
  return {};
}

/// With the parameters of its memory; axes have no reference, and servos are off.
void PiGcsFirmware::Controller::start_again() {
  replies.clear();
  power_on();
  for (const std::size_t k : axes_or_all({}))
    for (const unsigned live : {pi_id::kVelocity, pi_id::kAcceleration, pi_id::kDeceleration})
      set_parameter(k, *pi_parameter(live), memory_[k].at(live));
}

void PiGcsFirmware::Controller::power(bool on, Clock::Instant now) {
  now_ = now;
  update();
  if (on) {
    start_again();
  } else {
    stop_all(true);
  }
}

namespace {

/// The settings of each controller of the line.
std::vector<PiGcsSettings> controllers_of(const PiGcsSettings& settings) {
  std::vector<PiGcsSettings> found;
  for (std::size_t k = 0; k < 2; ++k) {
    if (settings.axis_names[k].empty()) continue;
    const std::vector<std::string> words = split(settings.axis_names[k]);
    if (words.empty() || words.size() > 2 || (words.size() == 2 && !is_number(words[0])))
      throw std::invalid_argument(
          fmt::format("simulated GCS controller: axis \"{}\", required: a name, or \"<address> <name>\"",
                      settings.axis_names[k]));
    const int address = words.size() == 2 ? std::stoi(words[0]) : settings.address;
    auto same = std::find_if(found.begin(), found.end(),
                             [&](const PiGcsSettings& one) { return one.address == address; });
    if (same == found.end()) {
      same = found.insert(found.end(), settings);
      same->address = address;
      same->axis_names = {};
      if (k == 1) same->serial_number = settings.z_serial_number;
    }
    same->axis_names[k] = words.back();
  }
  if (found.empty()) found.push_back(settings);
  // One alone has one number, whichever axes are on it.
  if (found.size() == 1) found.front().serial_number = settings.serial_number;
  return found;
}

}  // namespace

PiGcsFirmware::PiGcsFirmware(std::shared_ptr<SimBench> bench, PiGcsSettings settings) {
  for (PiGcsSettings& one : controllers_of(settings))
    controllers_.push_back(std::make_unique<Controller>(bench, std::move(one), unserved()));
}

PiGcsFirmware::~PiGcsFirmware() = default;

void PiGcsFirmware::receive(std::string_view bytes, Clock::Instant now) {
  for (const auto& controller : controllers_) controller->receive(bytes, now);
}

std::string PiGcsFirmware::transmit(Clock::Instant now) {
  std::string out;
  for (auto due = next_due(); due && *due <= now; due = next_due())
    for (const auto& controller : controllers_) out += controller->replies.take(*due);
  return out;
}

std::optional<Clock::Instant> PiGcsFirmware::next_due() const {
  std::optional<Clock::Instant> first;
  for (const auto& controller : controllers_)
    if (const auto due = controller->replies.next_due()) first = first ? std::min(*first, *due) : *due;
  return first;
}

void PiGcsFirmware::session_starts() {
  for (const auto& controller : controllers_) controller->forget_session();
}

void PiGcsFirmware::power(bool on, Clock::Instant now) {
  for (const auto& controller : controllers_) controller->power(on, now);
}

std::optional<unsigned> PiGcsFirmware::line_speed() const {
  return controllers_.front()->baud();
}

}  // namespace abcal::sim
