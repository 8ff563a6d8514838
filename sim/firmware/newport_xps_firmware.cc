#include "sim/firmware/newport_xps_firmware.h"

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

namespace abcal::sim {
namespace {

constexpr std::size_t kLongestCommand = 1024;
constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);
constexpr double kAbruptDeceleration = 1e5;  // deg/s2, of a kill

enum Error : int {
  kBusy = -1,
  kTooLong = -3,
  kUnknownCommand = -4,
  kWrongFormat = -7,
  kWrongObject = -8,
  kWrongCount = -9,
  kNoNumber = -16,
  kOutOfRange = -17,
  kNoPositioner = -18,
  kNoGroup = -19,
  kNotAllowed = -22,
  kFollowingError = -25,
  kEmergency = -26,
  kAbortedMotion = -27,
};

enum State : int {
  kNotInit = 0,
  kNotInitFollowingError = 3,
  kKilled = 7,
  kReadyAfterAbort = 10,
  kReadyAfterHoming = 11,
  kReadyAfterMotion = 12,
  kReadyEnabled = 13,
  kDisabled = 20,
  kNotReferenced = 42,
  kHoming = 43,
  kMoving = 44,
};

struct Refusal {
  int code;
};

const std::map<int, std::string_view>& error_texts() {
  static const std::map<int, std::string_view> all{
      {0, "Successful command"},
      {kBusy, "Busy socket : previous command not yet finished"},
      {kTooLong, "Unknown command : string too long"},
      {kUnknownCommand, "Unknown command"},
      {kWrongFormat, "Wrong format in the command string"},
      {kWrongObject, "Wrong object type for this command"},
      {kWrongCount, "Wrong number of parameters in the command"},
      {kNoNumber, "Wrong parameter type in the command string"},
      {kOutOfRange, "Parameter out of range"},
      {kNoPositioner, "Positioner Name doesn't exist or unknown command"},
      {kNoGroup, "GroupName doesn't exist or unknown command"},
      {kNotAllowed, "Not allowed action"},
      {kFollowingError, "Following Error"},
      {kEmergency, "Emergency signal"},
      {kAbortedMotion, "Move Aborted"}};
  return all;
}

const std::map<int, std::string_view>& state_texts() {
  static const std::map<int, std::string_view> all{
      {kNotInit, "Not initialized state"},
      {kNotInitFollowingError, "Not initialized state due to a following error"},
      {kKilled, "Not initialized state due to a KillAll or GroupKill command"},
      {kReadyAfterAbort, "Ready state due to an AbortMove command"},
      {kReadyAfterHoming, "Ready state from homing"},
      {kReadyAfterMotion, "Ready state from motion"},
      {kReadyEnabled, "Ready state due to a MotionEnable command"},
      {kDisabled, "Disable state"},
      {kNotReferenced, "Not referenced state"},
      {kHoming, "Homing state"},
      {kMoving, "Moving state"}};
  return all;
}

double number(std::string_view text) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value))
    throw Refusal{kNoNumber};
  return value;
}

std::string decimal(double value) {
  return fmt::format("{:.13g}", value == 0.0 ? 0.0 : value);
}

std::string positioner_name(const std::string& name) {
  const bool digits = std::all_of(name.begin(), name.end(), [](char c) { return c >= '0' && c <= '9'; });
  return digits ? "Group" + name + ".Pos" : name;
}

}  // namespace

class NewportXpsFirmware::Controller {
 public:
  struct Call {
    std::vector<std::string> in;     ///< Arguments, without the types of outputs.
    std::size_t outputs = 0;         ///< How many of those there are.
    std::optional<Motion> motion{};  ///< Set by calls that are answered only once this motion has ended.
  };
  struct Function {
    std::size_t inputs;
    std::size_t outputs;
    std::string (Controller::*run)(Call& call);
  };

  Controller(std::shared_ptr<SimBench> bench, NewportXpsSettings settings);

  static const std::map<std::string, Function, std::less<>>& functions();
  void advance(Clock::Instant now);
  /// The error of a motion that has ended.
  std::optional<int> result(const Motion& motion) const;
  std::optional<Clock::Instant> end_of(const Motion& motion) const;
  Clock::Duration reply_delay() const { return settings_.reply_delay; }
  UnservedCommands& unserved() { return unserved_; }

 private:
  struct Axis {
    std::string positioner;
    std::string group;
    int state = kNotInit;
    bool aborting = false;
    std::optional<Clock::Instant> homing_until;
    std::uint64_t motions = 0;  ///< Number of motions commanded,
    std::uint64_t ended = 0;    ///< and of motions that have ended,
    int last_result = 0;        ///< result of the last one.
    double offset_deg = 0.0;    ///< Controller angle = zero + sign * protocol angle + offset.
    double target_deg = 0.0;
    double travel_min_deg = 0.0;
    double travel_max_deg = 0.0;
    double speed = 0.0;
    double acceleration = 0.0;
    std::array<double, 2> jerk_time{0.02, 0.02};
  };

  const AxisTruth& truth(std::size_t k) const { return bench_->stage().axis(kStageAxes[k]); }
  std::size_t group(const std::string& name) const;
  std::size_t positioner(const std::string& name) const;
  std::size_t either(const std::string& name) const;
  double controller_deg(std::size_t k, Angle protocol) const;
  Angle protocol_angle(std::size_t k, double controller) const;
  void finish(Axis& axis, int state, int result);
  void stop(std::size_t k, bool abruptly);
  Motion begin(std::size_t k, int state);
  std::string move(Call& c, bool relative);

  std::string version(Call&) { return settings_.version; }
  std::string elapsed(Call&) { return decimal(to_seconds(now_ - bench_->start())); }
  std::string nothing(Call&) { return {}; }
  std::string error_list(Call&);
  std::string error_string(Call& c);
  std::string objects(Call&);
  std::string status(Call& c) { return std::to_string(axes_[group(c.in[0])].state); }
  std::string status_string(Call& c);
  std::string initialize(Call& c);
  std::string home(Call& c);
  std::string kill(Call& c);
  std::string kill_all(Call& c);
  std::string abort(Call& c);
  std::string enable(Call& c);
  std::string disable(Call& c);
  std::string move_absolute(Call& c) { return move(c, false); }
  std::string move_relative(Call& c) { return move(c, true); }
  std::string position(Call& c);
  std::string target(Call& c) { return decimal(axes_[either(c.in[0])].target_deg); }
  std::string setpoint(Call& c);
  std::string velocity(Call& c);
  std::string profile(Call& c);
  std::string set_profile(Call& c);
  std::string travel(Call& c);
  std::string set_travel(Call& c);
  std::string maxima(Call& c);
  std::string zero_of_positioner(Call& c);
  std::string corrector(Call& c);
  std::string no_error_text(Call&) { return {}; }

  std::shared_ptr<SimBench> bench_;
  NewportXpsSettings settings_;
  std::array<Axis, 2> axes_;
  Clock::Instant now_;
  UnservedCommands unserved_;
};

NewportXpsFirmware::Controller::Controller(std::shared_ptr<SimBench> bench, NewportXpsSettings settings)
    : bench_(std::move(bench)), settings_(std::move(settings)), now_(bench_->start()) {
  for (std::size_t k = 0; k < 2; ++k) {
    if (settings_.sign[k] != 1 && settings_.sign[k] != -1)
      throw std::invalid_argument(
          fmt::format("simulated XPS controller: sign is {}, required: +1 or -1", settings_.sign[k]));
    Axis& a = axes_[k];
    if (settings_.axis_names[k].empty()) continue;
    a.positioner = positioner_name(settings_.axis_names[k]);
    a.group = a.positioner.substr(0, a.positioner.find('.'));
    if (a.group.size() + 1 >= a.positioner.size())
      throw std::invalid_argument(fmt::format(
          "simulated XPS controller: an axis is named \"{}\", required: GROUP.POSITIONER or a number",
          a.positioner));
    a.offset_deg = -controller_deg(k, bench_->target(kStageAxes[k], now_));  // Reads 0 until it is homed.
    const double low = settings_.zero[k].deg() + settings_.sign[k] * truth(k).travel_min.deg();
    const double high = settings_.zero[k].deg() + settings_.sign[k] * truth(k).travel_max.deg();
    a.travel_min_deg = std::min(low, high);
    a.travel_max_deg = std::max(low, high);
    const MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    a.speed = limits.speed_deg_per_s;
    a.acceleration = limits.acceleration_deg_per_s2;
  }
  if (axes_[0].group == axes_[1].group)
    throw std::invalid_argument(fmt::format(
        "simulated XPS controller: both axes are in group \"{}\", required: two groups", axes_[0].group));
}

const std::map<std::string, NewportXpsFirmware::Controller::Function, std::less<>>&
NewportXpsFirmware::Controller::functions() {
  using C = Controller;
  static const std::map<std::string, Function, std::less<>> all{
      {"CloseAllOtherSockets", {0, 0, &C::nothing}},
      {"ElapsedTimeGet", {0, 1, &C::elapsed}},
      {"ErrorListGet", {0, 1, &C::error_list}},
      {"ErrorStringGet", {1, 1, &C::error_string}},
      {"FirmwareVersionGet", {0, 1, &C::version}},
      {"GroupHomeSearch", {1, 0, &C::home}},
      {"GroupInitialize", {1, 0, &C::initialize}},
      {"GroupKill", {1, 0, &C::kill}},
      {"GroupMotionDisable", {1, 0, &C::disable}},
      {"GroupMotionEnable", {1, 0, &C::enable}},
      {"GroupMoveAbort", {1, 0, &C::abort}},
      {"GroupMoveAbsolute", {2, 0, &C::move_absolute}},
      {"GroupMoveRelative", {2, 0, &C::move_relative}},
      {"GroupPositionCurrentGet", {1, 1, &C::position}},
      {"GroupPositionSetpointGet", {1, 1, &C::setpoint}},
      {"GroupPositionTargetGet", {1, 1, &C::target}},
      {"GroupStatusGet", {1, 1, &C::status}},
      {"GroupStatusStringGet", {1, 1, &C::status_string}},
      {"GroupVelocityCurrentGet", {1, 1, &C::velocity}},
      {"InstallerVersionGet", {0, 1, &C::version}},
      {"KillAll", {0, 0, &C::kill_all}},
      {"Login", {2, 0, &C::nothing}},
      {"ObjectsListGet", {0, 1, &C::objects}},
      {"PositionerCorrectorTypeGet", {1, 1, &C::corrector}},
      {"PositionerDriverStatusGet", {1, 1, &C::zero_of_positioner}},
      {"PositionerErrorGet", {1, 1, &C::zero_of_positioner}},
      {"PositionerErrorRead", {1, 1, &C::zero_of_positioner}},
      {"PositionerErrorStringGet", {1, 1, &C::no_error_text}},
      {"PositionerHardwareStatusGet", {1, 1, &C::zero_of_positioner}},
      {"PositionerHardwareStatusStringGet", {1, 1, &C::no_error_text}},
      {"PositionerMaximumVelocityAndAccelerationGet", {1, 2, &C::maxima}},
      {"PositionerSGammaParametersGet", {1, 4, &C::profile}},
      {"PositionerSGammaParametersSet", {5, 0, &C::set_profile}},
      {"PositionerUserTravelLimitsGet", {1, 2, &C::travel}},
      {"PositionerUserTravelLimitsSet", {3, 0, &C::set_travel}},
  };
  return all;
}

// Motions.

void NewportXpsFirmware::Controller::finish(Axis& axis, int state, int result) {
  axis.state = state;
  if (axis.ended == axis.motions) return;
  axis.ended = axis.motions;
  axis.last_result = result;
}

NewportXpsFirmware::Motion NewportXpsFirmware::Controller::begin(std::size_t k, int state) {
  Axis& a = axes_[k];
  a.state = state;
  a.aborting = false;
  return {k, ++a.motions};
}

std::optional<int> NewportXpsFirmware::Controller::result(const Motion& motion) const {
  const Axis& a = axes_[motion.axis];
  if (a.ended < motion.number) return std::nullopt;
  return a.ended == motion.number ? a.last_result : kAbortedMotion;
}

std::optional<Clock::Instant> NewportXpsFirmware::Controller::end_of(const Motion& motion) const {
  const Axis& a = axes_[motion.axis];
  if (a.ended >= motion.number) return now_;
  const Clock::Instant end = bench_->motion_end(kStageAxes[motion.axis], now_);
  if (end == Clock::Instant::max()) return std::nullopt;
  return a.homing_until ? std::max(*a.homing_until, end) : end;
}

void NewportXpsFirmware::Controller::advance(Clock::Instant now) {
  now_ = std::max(now, now_);
  for (std::size_t k = 0; k < 2; ++k) {
    Axis& a = axes_[k];
    const StageAxis which = kStageAxes[k];
    if (a.homing_until) a.homing_until = std::max(*a.homing_until, bench_->motion_end(which, now_));
    if (a.homing_until && now_ >= *a.homing_until) {
      a.homing_until.reset();
      a.offset_deg = 0.0;
      a.target_deg = 0.0;
      finish(a, kReadyAfterHoming, 0);
    }
    if (a.state == kMoving && !bench_->moving(which, now_))
      finish(a, a.aborting ? kReadyAfterAbort : kReadyAfterMotion, 0);
    if (a.state >= kReadyAfterAbort && bench_->fault_at(FaultKind::kLostReference, now_, which)) {
      stop(k, true);
      a.homing_until.reset();
      finish(a, kNotInitFollowingError, kFollowingError);
    }
  }
}

void NewportXpsFirmware::Controller::stop(std::size_t k, bool abruptly) {
  const StageAxis which = kStageAxes[k];
  if (!bench_->moving(which, now_)) return;
  const MotionLimits limits = bench_->motion_limits(which);
  MotionLimits abrupt = limits;
  if (abruptly) abrupt.deceleration_deg_per_s2 = kAbruptDeceleration;
  bench_->set_motion_limits(which, abrupt);
  bench_->halt(which, now_);
  bench_->set_motion_limits(which, limits);
  axes_[k].target_deg = controller_deg(k, bench_->target(which, now_));
}

double NewportXpsFirmware::Controller::controller_deg(std::size_t k, Angle protocol) const {
  return settings_.zero[k].deg() + axes_[k].offset_deg + settings_.sign[k] * protocol.deg();
}

Angle NewportXpsFirmware::Controller::protocol_angle(std::size_t k, double controller) const {
  return Angle::degrees(settings_.sign[k] * (controller - settings_.zero[k].deg() - axes_[k].offset_deg));
}

// Names.

std::size_t NewportXpsFirmware::Controller::either(const std::string& name) const {
  for (std::size_t k = 0; k < 2; ++k)
    if (!name.empty() && (name == axes_[k].group || name == axes_[k].positioner)) return k;
  throw Refusal{name.find('.') == std::string::npos ? kNoGroup : kNoPositioner};
}

std::size_t NewportXpsFirmware::Controller::group(const std::string& name) const {
  const std::size_t k = either(name);
  if (name != axes_[k].group) throw Refusal{kWrongObject};
  return k;
}

std::size_t NewportXpsFirmware::Controller::positioner(const std::string& name) const {
  const std::size_t k = either(name);
  if (name != axes_[k].positioner) throw Refusal{kWrongObject};
  return k;
}

// Functions: the values that follow the error 0 in their answers.

std::string NewportXpsFirmware::Controller::error_list(Call&) {
  std::string list;
  for (const auto& [code, text] : error_texts()) list += fmt::format("Error {} : {};", code, text);
  return list;
}

std::string NewportXpsFirmware::Controller::error_string(Call& c) {
  const auto found = error_texts().find(static_cast<int>(number(c.in[0])));
  return found == error_texts().end() ? "Undefined error" : std::string(found->second);
}

std::string NewportXpsFirmware::Controller::objects(Call&) {
  std::string list;
  for (const Axis& a : axes_)
    if (!a.group.empty()) list += fmt::format("{};{};", a.group, a.positioner);
  return list;
}

std::string NewportXpsFirmware::Controller::status_string(Call& c) {
  const auto found = state_texts().find(static_cast<int>(number(c.in[0])));
  return found == state_texts().end() ? "Undefined status" : std::string(found->second);
}

std::string NewportXpsFirmware::Controller::initialize(Call& c) {
  Axis& a = axes_[group(c.in[0])];
  if (a.state > 9) throw Refusal{kNotAllowed};
  a.state = kNotReferenced;
  return {};
}

std::string NewportXpsFirmware::Controller::home(Call& c) {
  const std::size_t k = group(c.in[0]);
  if (axes_[k].state != kNotReferenced) throw Refusal{kNotAllowed};
  // The home switch lies where a homed axis reads 0.
  axes_[k].offset_deg = 0.0;
  bench_->move(kStageAxes[k], protocol_angle(k, 0.0), now_);
  axes_[k].homing_until = now_ + kShortestHoming;
  c.motion = begin(k, kHoming);
  return {};
}

std::string NewportXpsFirmware::Controller::kill(Call& c) {
  const std::size_t k = group(c.in[0]);
  stop(k, true);
  axes_[k].homing_until.reset();
  finish(axes_[k], kKilled, kEmergency);
  return {};
}

std::string NewportXpsFirmware::Controller::kill_all(Call& c) {
  for (const Axis& a : axes_) {
    if (a.group.empty()) continue;
    c.in.assign(1, a.group);
    kill(c);
  }
  return {};
}

std::string NewportXpsFirmware::Controller::abort(Call& c) {
  const std::size_t k = group(c.in[0]);
  Axis& a = axes_[k];
  if (a.state != kMoving) throw Refusal{kNotAllowed};
  stop(k, false);
  finish(a, kMoving, kAbortedMotion);
  a.aborting = true;
  return {};
}

std::string NewportXpsFirmware::Controller::enable(Call& c) {
  Axis& a = axes_[group(c.in[0])];
  if (a.state != kDisabled) throw Refusal{kNotAllowed};
  a.state = kReadyEnabled;
  return {};
}

std::string NewportXpsFirmware::Controller::disable(Call& c) {
  Axis& a = axes_[group(c.in[0])];
  if (a.state < kReadyAfterAbort || a.state > 19) throw Refusal{kNotAllowed};
  a.state = kDisabled;
  return {};
}

std::string NewportXpsFirmware::Controller::move(Call& c, bool relative) {
  const std::size_t k = either(c.in[0]);
  Axis& a = axes_[k];
  if (a.state < kReadyAfterAbort || a.state > 19) throw Refusal{kNotAllowed};
  const double target = number(c.in[1]) + (relative ? a.target_deg : 0.0);
  if (!(target >= a.travel_min_deg && target <= a.travel_max_deg)) throw Refusal{kOutOfRange};
  if (bench_->fault_at(FaultKind::kRefusedMove, now_, kStageAxes[k])) throw Refusal{kNotAllowed};
  a.target_deg = target;
  bench_->move(kStageAxes[k], protocol_angle(k, target), now_);
  c.motion = begin(k, kMoving);
  return {};
}

std::string NewportXpsFirmware::Controller::position(Call& c) {
  const std::size_t k = either(c.in[0]);
  return decimal(controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_)));
}

std::string NewportXpsFirmware::Controller::setpoint(Call& c) {
  const std::size_t k = either(c.in[0]);
  return decimal(controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_)));
}

std::string NewportXpsFirmware::Controller::velocity(Call& c) {
  constexpr Clock::Duration kServoCycle = std::chrono::microseconds(125);
  const std::size_t k = either(c.in[0]);
  const Angle turned = bench_->commanded_angle(kStageAxes[k], now_) -
                       bench_->commanded_angle(kStageAxes[k], std::max(bench_->start(), now_ - kServoCycle));
  return decimal(settings_.sign[k] * turned.deg() / to_seconds(kServoCycle));
}

std::string NewportXpsFirmware::Controller::profile(Call& c) {
  const Axis& a = axes_[positioner(c.in[0])];
  return fmt::format("{},{},{},{}", decimal(a.speed), decimal(a.acceleration), decimal(a.jerk_time[0]),
                     decimal(a.jerk_time[1]));
}

std::string NewportXpsFirmware::Controller::set_profile(Call& c) {
  const std::size_t k = positioner(c.in[0]);
  Axis& a = axes_[k];
  const double speed = number(c.in[1]);
  const double acceleration = number(c.in[2]);
  const std::array jerk_time{number(c.in[3]), number(c.in[4])};
  if (!(speed > 0.0 && speed <= settings_.max_speed_deg_per_s && acceleration > 0.0 &&
        acceleration <= settings_.max_acceleration_deg_per_s2 && jerk_time[0] > 0.0 &&
        jerk_time[1] >= jerk_time[0]))
    throw Refusal{kOutOfRange};
  a.speed = speed;
  a.acceleration = acceleration;
  a.jerk_time = jerk_time;
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  limits.speed_deg_per_s = speed;
  limits.acceleration_deg_per_s2 = limits.deceleration_deg_per_s2 = acceleration;
  bench_->set_motion_limits(kStageAxes[k], limits);
  return {};
}

std::string NewportXpsFirmware::Controller::travel(Call& c) {
  const Axis& a = axes_[positioner(c.in[0])];
  return decimal(a.travel_min_deg) + "," + decimal(a.travel_max_deg);
}

std::string NewportXpsFirmware::Controller::set_travel(Call& c) {
  Axis& a = axes_[positioner(c.in[0])];
  const double low = number(c.in[1]);
  const double high = number(c.in[2]);
  if (!(low < high)) throw Refusal{kOutOfRange};
  a.travel_min_deg = low;
  a.travel_max_deg = high;
  return {};
}

std::string NewportXpsFirmware::Controller::maxima(Call& c) {
  positioner(c.in[0]);
  return decimal(settings_.max_speed_deg_per_s) + "," + decimal(settings_.max_acceleration_deg_per_s2);
}

std::string NewportXpsFirmware::Controller::zero_of_positioner(Call& c) {
  positioner(c.in[0]);
  return "0";
}

std::string NewportXpsFirmware::Controller::corrector(Call& c) {
  positioner(c.in[0]);
  return "PositionerCorrectorPIDFFVelocity";
}

// A connection.

NewportXpsFirmware::NewportXpsFirmware(std::shared_ptr<SimBench> bench, NewportXpsSettings settings)
    : controller_(std::make_shared<Controller>(std::move(bench), std::move(settings))) {}
NewportXpsFirmware::NewportXpsFirmware(std::shared_ptr<Controller> controller)
    : controller_(std::move(controller)) {}
NewportXpsFirmware::~NewportXpsFirmware() = default;

std::shared_ptr<Firmware> NewportXpsFirmware::another_session() {
  return std::shared_ptr<Firmware>(new NewportXpsFirmware(controller_));
}

UnservedCommands& NewportXpsFirmware::unserved() {
  return controller_->unserved();
}

void NewportXpsFirmware::session_starts() {
  received_.clear();
  motion_.reset();
  replies_.clear();
}

void NewportXpsFirmware::answer(int code, std::string_view values) {
  replies_.push(fmt::format("{},{},EndOfAPI", code, values), now_ + controller_->reply_delay());
}

void NewportXpsFirmware::receive(std::string_view bytes, Clock::Instant now) {
  transmit_due(now);
  for (const char c : bytes) {
    if (c == '\n' || c == '\r') {
      const std::string rest = std::exchange(received_, {});
      if (!pieces::trimmed(rest).empty()) answer(kWrongFormat, "");
      continue;
    }
    if (received_.size() <= kLongestCommand) received_.push_back(c);
    if (c != ')') continue;
    const std::string command = std::exchange(received_, {});
    if (command.size() > kLongestCommand) {
      answer(kTooLong, "");
    } else {
      take_command(command);
    }
  }
}

void NewportXpsFirmware::take_command(std::string_view text) {
  text = pieces::trimmed(text);
  const std::string echo(text);
  if (motion_) return answer(kBusy, echo);
  const std::size_t bracket = text.find('(');
  if (bracket == std::string_view::npos) return answer(kWrongFormat, echo);
  const std::string_view name = pieces::trimmed(text.substr(0, bracket));
  const auto found = Controller::functions().find(name);
  if (found == Controller::functions().end()) {
    unserved().note(name, "not emulated: error -4");
    return answer(kUnknownCommand, echo);
  }
  Controller::Call call;
  const std::string_view inside = text.substr(bracket + 1, text.size() - bracket - 2);
  for (std::string_view each : pieces::split(inside, ',')) {
    each = pieces::trimmed(each);
    if (each.ends_with('*')) {
      ++call.outputs;
    } else if (!each.empty() || !call.in.empty()) {
      call.in.emplace_back(each);
    }
  }
  const Controller::Function& function = found->second;
  if (call.in.size() != function.inputs || call.outputs != function.outputs) return answer(kWrongCount, echo);
  try {
    const std::string values = (*controller_.*function.run)(call);
    motion_ = call.motion;
    blocking_ = echo;
    if (!motion_) answer(0, values);
  } catch (const Refusal& refusal) {
    answer(refusal.code, echo);
  }
}

void NewportXpsFirmware::transmit_due(Clock::Instant now) {
  now_ = now;
  controller_->advance(now);
  if (!motion_) return;
  const auto result = controller_->result(*motion_);
  if (!result) return;
  motion_.reset();
  answer(*result, *result == 0 ? std::string_view() : std::string_view(blocking_));
}

std::string NewportXpsFirmware::transmit(Clock::Instant now) {
  transmit_due(now);
  return replies_.take(now);
}

std::optional<Clock::Instant> NewportXpsFirmware::next_due() const {
  auto due = replies_.next_due();
  if (!motion_) return due;
  const auto end = controller_->end_of(*motion_);
  if (!end) return due;
  return due ? std::min(*due, *end) : *end;
}

}  // namespace abcal::sim
