#include "sim/firmware/pi_gcs_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/text.h"
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
constexpr int kOutOfRange = 17;
constexpr int kDoubleAxis = 22;
constexpr int kWrongCount = 24;
constexpr int kInvalidNumber = 25;
constexpr int kMissingParameter = 26;
constexpr int kNotAllowed = 34;
constexpr int kUnknownParameter = 54;
constexpr int kParameterProtected = 60;

constexpr std::size_t kLongestLine = 1024;
constexpr double kLargestAcceleration = 1e5;  // deg/s2
constexpr double kAbruptDeceleration = 1e5;   // deg/s2: STP and #24 do not use the ramp.
constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);

// Axis parameters (SPA).
constexpr unsigned kCountsNumerator = 14;
constexpr unsigned kCountsDenominator = 15;
constexpr unsigned kSettleTime = 0x3F;
constexpr unsigned kReferenceVelocity = 0x50;
constexpr unsigned kWindowEnter = 0x406;
constexpr unsigned kWindowLeave = 0x407;

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
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value))
    throw Refusal{kInvalidNumber};
  return value;
}

bool flag(std::string_view text) {
  if (text == "1") return true;
  if (text == "0") return false;
  throw Refusal{kOutOfRange};
}

unsigned parameter_id(std::string_view text) {
  const bool hex = text.size() > 2 && text[0] == '0' && (text[1] == 'x' || text[1] == 'X');
  const std::string_view digits = hex ? text.substr(2) : text;
  unsigned id = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), id, hex ? 16 : 10);
  if (error != std::errc{} || end != digits.data() + digits.size()) throw Refusal{kInvalidNumber};
  return id;
}

std::string decimal(double value) {
  return fmt::format("{:.6f}", value == 0.0 ? 0.0 : value);
}

}  // namespace

class PiGcsFirmware::Controller {
 public:
  Controller(std::shared_ptr<SimBench> bench, PiGcsSettings settings);

  void receive(std::string_view bytes, Clock::Instant now);

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
    double offset_deg = 0.0;  ///< By POS, on top of zero.
    double target_deg = 0.0;  ///< Controller angle.
    std::map<unsigned, double> parameters;
  };

  static const std::map<std::string, Command, std::less<>>& commands();

  void power_on();
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
  const AxisTruth& truth(std::size_t k) const { return k == 0 ? bench_->truth().x : bench_->truth().z; }
  bool in_motion(std::size_t k) const;
  void start_move(std::size_t k, double target_deg);
  void check_move(std::size_t k, double target_deg) const;
  Lines start_reference(const Words& arguments, double (Controller::*where)(std::size_t) const);
  double at_switch(std::size_t) const { return 0.0; }
  double at_negative_limit(std::size_t k) const { return travel(k).first; }
  double at_positive_limit(std::size_t k) const { return travel(k).second; }
  void stop_all(bool abruptly);
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

  std::shared_ptr<SimBench> bench_;
  PiGcsSettings settings_;
  std::array<Axis, 2> axes_;
  std::string line_;
  bool line_too_long_ = false;
  int error_ = kNoError;
  Clock::Instant now_;
};

PiGcsFirmware::Controller::Controller(std::shared_ptr<SimBench> bench, PiGcsSettings settings)
    : bench_(std::move(bench)), settings_(std::move(settings)), now_(bench_->start()) {
  for (const int sign : settings_.sign)
    if (sign != 1 && sign != -1)
      throw std::invalid_argument(
          fmt::format("simulated GCS controller: sign is {}, required: +1 or -1", sign));
  if (settings_.axis_names[0] == settings_.axis_names[1])
    throw std::invalid_argument(
        fmt::format("simulated GCS controller: both axes are named \"{}\", required: two names",
                    settings_.axis_names[0]));
  power_on();
}

void PiGcsFirmware::Controller::power_on() {
  error_ = kNoError;
  line_.clear();
  for (std::size_t k = 0; k < 2; ++k) {
    axes_[k] = Axis{};
    axes_[k].target_deg = controller_deg(k, bench_->target(kStageAxes[k], now_));
    // Hosts turn angles into counts by 14/15. A pair of whole numbers close to the encoder.
    axes_[k].parameters = {
        {kCountsNumerator, 10000.0}, {kCountsDenominator, 1.0}, {kSettleTime, settings_.settle_s},
        {kReferenceVelocity, 10.0},  {kWindowEnter, 10.0},      {kWindowLeave, 12.0}};
  }
}

const std::map<std::string, PiGcsFirmware::Controller::Command, std::less<>>&
PiGcsFirmware::Controller::commands() {
  using C = Controller;
  static const std::map<std::string, Command, std::less<>> table{
      {"*IDN?", {"Get Device Identification", &C::idn}},
      {"ACC", {"{<AxisID> <Acceleration>} Set Closed-Loop Acceleration", &C::set_acc}},
      {"ACC?", {"[{<AxisID>}] Get Closed-Loop Acceleration", &C::get_acc}},
      {"CST?", {"[{<AxisID>}] Get Assignment Of Stages To Axes", &C::cst}},
      {"CSV?", {"Get Current Syntax Version", &C::csv}},
      {"DEC", {"{<AxisID> <Deceleration>} Set Closed-Loop Deceleration", &C::set_dec}},
      {"DEC?", {"[{<AxisID>}] Get Closed-Loop Deceleration", &C::get_dec}},
      {"EAX", {"{<AxisID> <EnableState>} Enable Axis", &C::set_eax}},
      {"EAX?", {"[{<AxisID>}] Get Enable Status Of Axes", &C::get_eax}},
      {"ERR?", {"Get Error Number", &C::get_err}},
      {"FNL", {"[{<AxisID>}] Fast Reference Move To Negative Limit", &C::fnl}},
      {"FPL", {"[{<AxisID>}] Fast Reference Move To Positive Limit", &C::fpl}},
      {"FRF", {"[{<AxisID>}] Fast Reference Move To Reference Switch", &C::frf}},
      {"FRF?", {"[{<AxisID>}] Get Referencing Result", &C::get_frf}},
      {"HAR?", {"[{<AxisID>}] Indicate Hard Stops", &C::no}},
      {"HLP?", {"Get List Of Available Commands", &C::hlp}},
      {"HLT", {"[{<AxisID>}] Halt Motion Smoothly", &C::hlt}},
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
      {"SPA", {"{<ItemID> <PamID> <PamValue>} Set Volatile Memory Parameters", &C::set_spa}},
      {"SPA?", {"[{<ItemID> <PamID>}] Get Volatile Memory Parameters", &C::get_spa}},
      {"STP", {"Stop All Axes", &C::stp}},
      {"SVO", {"{<AxisID> <ServoState>} Set Servo Mode", &C::set_svo}},
      {"SVO?", {"[{<AxisID>}] Get Servo Mode", &C::get_svo}},
      {"TMN?", {"[{<AxisID>}] Get Minimum Commandable Position", &C::get_tmn}},
      {"TMX?", {"[{<AxisID>}] Get Maximum Commandable Position", &C::get_tmx}},
      {"TRS?", {"[{<AxisID>}] Indicate Reference Switch", &C::yes}},
      {"VEL", {"{<AxisID> <Velocity>} Set Closed-Loop Velocity", &C::set_vel}},
      {"VEL?", {"[{<AxisID>}] Get Closed-Loop Velocity", &C::get_vel}},
  };
  return table;
}

// Bytes.

void PiGcsFirmware::Controller::receive(std::string_view bytes, Clock::Instant now) {
  now_ = now;
  update();
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

/// Takes the address off the words. Nothing: the line is for another controller of the chain.
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
  const auto command = commands().find(name);
  const bool absent =
      command == commands().end() || (!settings_.has_enable && (name == "EAX" || name == "EAX?"));
  if (absent) {
    error_ = kUnknownCommand;
    return;
  }
  try {
    const Lines lines = (this->*command->second.run)(words);
    if (!lines.empty()) reply(*prefix, lines);
  } catch (const Refusal& refusal) {
    error_ = refusal.code;  // a refused query does not answer
  }
}

void PiGcsFirmware::Controller::single_byte(char byte) {
  // In a daisy chain the address stands before it, with no line end.
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
      replies.push(std::string(1, homing ? '\xB0' : '\xB1'), now_ + settings_.reply_delay);  // no line end
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
    if (!settings_.has_enable && name.starts_with("EAX")) continue;
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
    return since >= from_seconds(axes_[k].parameters.at(kSettleTime)) ? 1 : 0;
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

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::set_spa(const Words& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  if (a.size() % 3 != 0) throw Refusal{kWrongCount};
  for (std::size_t n = 0; n < a.size(); n += 3) {
    Axis& axis = axes_[find(a[n])];
    const unsigned id = parameter_id(a[n + 1]);
    const double value = number(a[n + 2]);
    if (!axis.parameters.contains(id)) throw Refusal{kUnknownParameter};
    if (id == kCountsNumerator || id == kCountsDenominator) throw Refusal{kParameterProtected};
    if (value < 0.0) throw Refusal{kOutOfRange};
    axis.parameters[id] = value;
  }
  return {};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_spa(const Words& a) {
  Lines lines;
  const auto line = [&](std::size_t k, std::string_view id, double value) {
    const std::string axis = settings_.spa_reply_names_axis ? settings_.axis_names[k] + " " : "";
    lines.push_back(fmt::format("{}{}={}", axis, id, value));
  };
  if (a.empty()) {
    for (const std::size_t k : axes_or_all({}))
      for (const auto& [id, value] : axes_[k].parameters)
        lines.push_back(fmt::format("{} {:#x}={}", settings_.axis_names[k], id, value));
    return lines;
  }
  if (a.size() % 2 != 0) throw Refusal{kWrongCount};
  for (std::size_t n = 0; n < a.size(); n += 2) {
    const std::size_t k = find(a[n]);
    const auto found = axes_[k].parameters.find(parameter_id(a[n + 1]));
    if (found == axes_[k].parameters.end()) throw Refusal{kUnknownParameter};
    line(k, a[n + 1], found->second);
  }
  return lines;
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::get_err(const Words&) {
  return {std::to_string(std::exchange(error_, kNoError))};
}

PiGcsFirmware::Controller::Lines PiGcsFirmware::Controller::rbt(const Words&) {
  stop_all(true);
  replies.clear();
  power_on();
  return {};
}

PiGcsFirmware::PiGcsFirmware(std::shared_ptr<SimBench> bench, PiGcsSettings settings)
    : controller_(std::make_unique<Controller>(std::move(bench), std::move(settings))) {}

PiGcsFirmware::~PiGcsFirmware() = default;

void PiGcsFirmware::receive(std::string_view bytes, Clock::Instant now) {
  controller_->receive(bytes, now);
}

std::string PiGcsFirmware::transmit(Clock::Instant now) {
  return controller_->replies.take(now);
}

std::optional<Clock::Instant> PiGcsFirmware::next_due() const {
  return controller_->replies.next_due();
}

}  // namespace abcal::sim
