#include "sim/firmware/newport_xps_firmware.h"

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
#include "sim/firmware/xps_gathering.h"

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
  kNoGatheringType = -29,
  kGatheringNotStarted = -30,
  kGatheringNotConfigured = -32,
  kNoAction = -39,
  kNoEvent = -40,
  kJogOutOfRange = -42,
  kGatheringRuns = -43,
  kNoEventId = -83,
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
  kJogging = 47,
  kReferencing = 64,
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
      {kAbortedMotion, "Move Aborted"},
      {kNoGatheringType, "Mnemonic gathering type doesn't exist"},
      {kGatheringNotStarted, "Gathering not started"},
      {kGatheringNotConfigured, "Gathering not configured"},
      {kNoAction, "Mnemonic action doesn't exist"},
      {kNoEvent, "Mnemonic event doesn't exist"},
      {kJogOutOfRange, "Jog value out of range"},
      {kGatheringRuns, "Gathering running"},
      {kNoEventId, "Event id doesn't exist"}};
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
      {kMoving, "Moving state"},
      {kJogging, "Jogging state"},
      {kReferencing, "Referencing state"}};
  return all;
}

/// "0 : text;-1 : text;".
std::string list_of(const std::map<int, std::string_view>& texts) {
  std::string list;
  for (const auto& [code, text] : texts) list += fmt::format("{} : {};", code, text);
  return list;
}

const std::map<int, std::string_view>& controller_state_texts() {
  static const std::map<int, std::string_view> all{{0, "Controller status OK"}};
  return all;
}

/// Parameters of a positioner that are kept and change nothing: the function is the name and "Get" or "Set".
struct KeptParameters {
  std::string_view name;
  std::string_view initial;  ///< [unverified against a device]
};
constexpr auto kKeptParameters = std::to_array<KeptParameters>({
    {"PositionerMotionDone", "0.001,0.1,0.1,0.01,1"},
    {"PositionerBacklash", "0"},
    {"PositionerCorrectorPIDFFVelocity", "1,10,20,0,0,0.001,4000,0,0,0,1,0"},
    {"PositionerHardInterpolatorFactor", "200"},
});

double number(std::string_view text) {
  const auto value = pieces::number<double>(text);
  if (!value || !std::isfinite(*value)) throw Refusal{kNoNumber};
  return *value;
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
    std::string_view function;       ///< Its name.
    std::vector<std::string> in;     ///< Arguments, without the types of outputs.
    std::size_t outputs = 0;         ///< How many of those there are.
    std::optional<Motion> motion{};  ///< Set by calls that are answered only once this motion has ended.
  };
  /// A function with a list of arguments, which it counts itself.
  static constexpr std::size_t kAnyNumber = static_cast<std::size_t>(-1);
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
    std::array<double, 2> jog{0.0, 0.0};  ///< Velocity and acceleration of jogging.
    bool backlash_on = false;
    std::array<double, 2> last_motion_s{0.0, 0.0};  ///< Duration of the last motion, and of its settling.
    Clock::Instant motion_since{};
  };
  /// Events of a trigger start actions.
  struct Event {
    std::vector<std::string> trigger;  ///< Name and four parameters.
    std::vector<std::string> action;   ///< The same.
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
  std::string zero(Call&) { return "0"; }
  std::string controller_status_string(Call& c);
  std::string controller_status_list(Call&) { return list_of(controller_state_texts()); }
  std::string group_status_list(Call&) { return list_of(state_texts()); }
  std::string no_errors_list(Call&) { return "0 : No error;"; }
  std::string kernel_load(Call&) { return "0.1,0.05,0.02,0.03"; }  ///< Parts of the processor's time.
  std::string following_error(Call& c);
  std::string keep_parameters(Call& c);
  std::string kept_parameters(Call& c);
  std::string backlash(Call& c);
  std::string enable_backlash(Call& c);
  std::string motion_times(Call& c);
  std::string displacement(Call& c);
  std::string other_kind_of_group(Call& c);
  std::string keep_global(Call& c);
  std::string global(Call& c);
  std::string start_referencing(Call& c);
  std::string stop_referencing(Call& c);
  std::string reference(Call& c);

  std::string enable_jog(Call& c);
  std::string disable_jog(Call& c);
  std::string set_jog(Call& c);
  std::string jog_parameters(Call& c);
  std::string jog_now(Call& c);

  double measured(const XpsGathering::Quantity& quantity, Clock::Instant t) const;
  double velocity_at(std::size_t k, Clock::Instant t) const;
  void gather();
  std::string configure_gathering(Call& c);
  std::string gathering_configuration(Call&);
  std::string gathering_types(Call&);
  std::string run_gathering(Call& c);
  std::string resume_gathering(Call&);
  std::string stop_gathering(Call&);
  std::string reset_gathering(Call&);
  std::string acquire(Call&);
  std::string gathered_number(Call&);
  std::string gathered_line(Call& c);
  std::string gathered_lines(Call& c);

  std::string configure_trigger(Call& c);
  std::string configure_action(Call& c);
  std::string trigger_configuration(Call&) { return joined(event_.trigger); }
  std::string action_configuration(Call&) { return joined(event_.action); }
  static std::string joined(const std::vector<std::string>& words);
  std::string start_event(Call&);
  std::string all_events(Call&);
  std::string event(Call& c);
  std::string remove_event(Call& c);
  void motion_event(std::size_t k, std::string_view what);
  void act(const Event& event);
  std::map<int, Event>::iterator event_of(const std::string& id);

  std::shared_ptr<SimBench> bench_;
  NewportXpsSettings settings_;
  std::array<Axis, 2> axes_;
  XpsGathering gathering_;
  Event event_;                  ///< The one that is configured.
  std::map<int, Event> events_;  ///< Those that are started, by their number.
  int last_event_ = 0;
  std::map<std::string, std::string> kept_;  ///< Function without "Get", and its object -> values.
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

// A table of names.
const std::map<std::string, NewportXpsFirmware::Controller::Function, std::less<>>&
NewportXpsFirmware::Controller::functions() {  // NOLINT(readability-function-size)
  using C = Controller;
  static const std::map<std::string, Function, std::less<>> all{
      {"CleanCoreDumpFolder", {0, 0, &C::nothing}},
      {"CleanTmpFolder", {0, 0, &C::nothing}},
      {"CloseAllOtherSockets", {0, 0, &C::nothing}},
      {"ControllerMotionKernelTimeLoadGet", {0, 4, &C::kernel_load}},
      {"ControllerStatusGet", {0, 1, &C::zero}},
      {"ControllerStatusListGet", {0, 1, &C::controller_status_list}},
      {"ControllerStatusStringGet", {1, 1, &C::controller_status_string}},
      {"DoubleGlobalArrayGet", {1, 1, &C::global}},
      {"DoubleGlobalArraySet", {2, 0, &C::keep_global}},
      {"ElapsedTimeGet", {0, 1, &C::elapsed}},
      {"ErrorListGet", {0, 1, &C::error_list}},
      {"ErrorStringGet", {1, 1, &C::error_string}},
      {"EventExtendedAllGet", {0, 1, &C::all_events}},
      {"EventExtendedConfigurationActionGet", {0, 1, &C::action_configuration}},
      {"EventExtendedConfigurationActionSet", {C::kAnyNumber, 0, &C::configure_action}},
      {"EventExtendedConfigurationTriggerGet", {0, 1, &C::trigger_configuration}},
      {"EventExtendedConfigurationTriggerSet", {C::kAnyNumber, 0, &C::configure_trigger}},
      {"EventExtendedGet", {1, 2, &C::event}},
      {"EventExtendedRemove", {1, 0, &C::remove_event}},
      {"EventExtendedStart", {0, 1, &C::start_event}},
      {"FirmwareVersionGet", {0, 1, &C::version}},
      {"GatheringConfigurationGet", {0, 1, &C::gathering_configuration}},
      {"GatheringConfigurationSet", {C::kAnyNumber, 0, &C::configure_gathering}},
      {"GatheringCurrentNumberGet", {0, 2, &C::gathered_number}},
      {"GatheringDataAcquire", {0, 0, &C::acquire}},
      {"GatheringDataGet", {1, 1, &C::gathered_line}},
      {"GatheringDataMultipleLinesGet", {2, 1, &C::gathered_lines}},
      {"GatheringListGet", {0, 1, &C::gathering_types}},
      {"GatheringReset", {0, 0, &C::reset_gathering}},
      {"GatheringRun", {2, 0, &C::run_gathering}},
      {"GatheringRunAppend", {0, 0, &C::resume_gathering}},
      {"GatheringStop", {0, 0, &C::stop_gathering}},
      {"GatheringStopAndSave", {0, 0, &C::stop_gathering}},
      {"GlobalArrayGet", {1, 1, &C::global}},
      {"GlobalArraySet", {2, 0, &C::keep_global}},
      {"GroupCurrentFollowingErrorGet", {1, 1, &C::following_error}},
      {"GroupHomeSearch", {1, 0, &C::home}},
      {"GroupInitialize", {1, 0, &C::initialize}},
      {"GroupJogCurrentGet", {1, 2, &C::jog_now}},
      {"GroupJogModeDisable", {1, 0, &C::disable_jog}},
      {"GroupJogModeEnable", {1, 0, &C::enable_jog}},
      {"GroupJogParametersGet", {1, 2, &C::jog_parameters}},
      {"GroupJogParametersSet", {3, 0, &C::set_jog}},
      {"GroupKill", {1, 0, &C::kill}},
      {"GroupMotionDisable", {1, 0, &C::disable}},
      {"GroupMotionEnable", {1, 0, &C::enable}},
      {"GroupMoveAbort", {1, 0, &C::abort}},
      {"GroupMoveAbsolute", {2, 0, &C::move_absolute}},
      {"GroupMoveRelative", {2, 0, &C::move_relative}},
      {"GroupPositionCurrentGet", {1, 1, &C::position}},
      {"GroupPositionSetpointGet", {1, 1, &C::setpoint}},
      {"GroupPositionTargetGet", {1, 1, &C::target}},
      {"GroupReferencingActionExecute", {4, 0, &C::reference}},
      {"GroupReferencingStart", {1, 0, &C::start_referencing}},
      {"GroupReferencingStop", {1, 0, &C::stop_referencing}},
      {"GroupSpinCurrentGet", {1, 2, &C::other_kind_of_group}},
      {"GroupSpinModeStop", {2, 0, &C::other_kind_of_group}},
      {"GroupSpinParametersGet", {1, 2, &C::other_kind_of_group}},
      {"GroupSpinParametersSet", {3, 0, &C::other_kind_of_group}},
      {"GroupStatusGet", {1, 1, &C::status}},
      {"GroupStatusListGet", {0, 1, &C::group_status_list}},
      {"GroupStatusStringGet", {1, 1, &C::status_string}},
      {"GroupVelocityCurrentGet", {1, 1, &C::velocity}},
      {"InstallerVersionGet", {0, 1, &C::version}},
      {"IntegerGlobalArrayGet", {1, 1, &C::global}},
      {"IntegerGlobalArraySet", {2, 0, &C::keep_global}},
      {"Reboot", {0, 0, &C::kill_all}},
      {"KillAll", {0, 0, &C::kill_all}},
      {"Login", {2, 0, &C::nothing}},
      {"MultipleAxesPVTExecution", {3, 0, &C::other_kind_of_group}},
      {"MultipleAxesPVTPulseOutputSet", {4, 0, &C::other_kind_of_group}},
      {"MultipleAxesPVTVerification", {2, 0, &C::other_kind_of_group}},
      {"ObjectsListGet", {0, 1, &C::objects}},
      {"PositionerBacklashDisable", {1, 0, &C::enable_backlash}},
      {"PositionerBacklashEnable", {1, 0, &C::enable_backlash}},
      {"PositionerBacklashGet", {1, 2, &C::backlash}},
      {"PositionerBacklashSet", {2, 0, &C::keep_parameters}},
      {"PositionerCorrectorPIDFFVelocityGet", {1, 12, &C::kept_parameters}},
      {"PositionerCorrectorPIDFFVelocitySet", {13, 0, &C::keep_parameters}},
      {"PositionerCorrectorTypeGet", {1, 1, &C::corrector}},
      {"PositionerDriverStatusGet", {1, 1, &C::zero_of_positioner}},
      {"PositionerErrorGet", {1, 1, &C::zero_of_positioner}},
      {"PositionerErrorRead", {1, 1, &C::zero_of_positioner}},
      {"PositionerErrorStringGet", {1, 1, &C::no_error_text}},
      {"PositionerErrorListGet", {0, 1, &C::no_errors_list}},
      {"PositionerHardInterpolatorFactorGet", {1, 1, &C::kept_parameters}},
      {"PositionerHardInterpolatorFactorSet", {2, 0, &C::keep_parameters}},
      {"PositionerHardwareStatusListGet", {0, 1, &C::no_errors_list}},
      {"PositionerMotionDoneGet", {1, 5, &C::kept_parameters}},
      {"PositionerMotionDoneSet", {6, 0, &C::keep_parameters}},
      {"PositionerSGammaExactVelocityAjustedDisplacementGet", {2, 1, &C::displacement}},
      {"PositionerSGammaPreviousMotionTimesGet", {1, 2, &C::motion_times}},
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
  axis.last_motion_s[0] = to_seconds(now_ - axis.motion_since);
  motion_event(axis.group == axes_[0].group ? 0 : 1, "MotionEnd");
}

NewportXpsFirmware::Motion NewportXpsFirmware::Controller::begin(std::size_t k, int state) {
  Axis& a = axes_[k];
  a.state = state;
  a.aborting = false;
  a.motion_since = now_;
  motion_event(k, "MotionStart");
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
  gather();
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
  return decimal(velocity_at(either(c.in[0]), now_));
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

std::string NewportXpsFirmware::Controller::controller_status_string(Call& c) {
  const auto found = controller_state_texts().find(static_cast<int>(number(c.in[0])));
  return found == controller_state_texts().end() ? "Undefined status" : std::string(found->second);
}

std::string NewportXpsFirmware::Controller::following_error(Call& c) {
  const std::size_t k = either(c.in[0]);
  return decimal(controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_)) -
                 controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_)));
}

// Parameters that are only kept.

std::string NewportXpsFirmware::Controller::keep_parameters(Call& c) {
  positioner(c.in[0]);
  std::string values;
  for (std::size_t n = 1; n < c.in.size(); ++n) {
    number(c.in[n]);
    values += (n == 1 ? "" : ",") + c.in[n];
  }
  kept_[fmt::format("{} {}", c.function.substr(0, c.function.size() - 3), c.in[0])] = values;
  return {};
}

std::string NewportXpsFirmware::Controller::kept_parameters(Call& c) {
  positioner(c.in[0]);
  const std::string_view name = c.function.substr(0, c.function.size() - 3);
  const auto found = kept_.find(fmt::format("{} {}", name, c.in[0]));
  if (found != kept_.end()) return found->second;
  const auto known = std::find_if(kKeptParameters.begin(), kKeptParameters.end(),
                                  [&](const KeptParameters& each) { return each.name == name; });
  return std::string(known->initial);
}

std::string NewportXpsFirmware::Controller::backlash(Call& c) {
  const std::string value = kept_parameters(c);
  return value + (axes_[positioner(c.in[0])].backlash_on ? ",Enable" : ",Disable");
}

std::string NewportXpsFirmware::Controller::enable_backlash(Call& c) {
  axes_[positioner(c.in[0])].backlash_on = c.function.ends_with("Enable");
  return {};
}

std::string NewportXpsFirmware::Controller::motion_times(Call& c) {
  const Axis& a = axes_[positioner(c.in[0])];
  return decimal(a.last_motion_s[0]) + "," + decimal(a.last_motion_s[1]);
}

std::string NewportXpsFirmware::Controller::displacement(Call& c) {
  positioner(c.in[0]);
  return decimal(number(c.in[1]));
}

/// A function for spindles or for groups of several axes: here every group is a single axis.
std::string NewportXpsFirmware::Controller::other_kind_of_group(Call& c) {
  either(c.in[0]);
  throw Refusal{kWrongObject};
}

std::string NewportXpsFirmware::Controller::keep_global(Call& c) {
  number(c.in[0]);
  kept_[fmt::format("{} {}", c.function.substr(0, c.function.size() - 3), c.in[0])] = c.in[1];
  return {};
}

std::string NewportXpsFirmware::Controller::global(Call& c) {
  number(c.in[0]);
  const auto found = kept_.find(fmt::format("{} {}", c.function.substr(0, c.function.size() - 3), c.in[0]));
  const bool is_text = c.function.starts_with("Global");
  return found != kept_.end() ? found->second : is_text ? "" : "0";
}

// Referencing by hand: the host states where the axis is.

std::string NewportXpsFirmware::Controller::start_referencing(Call& c) {
  Axis& a = axes_[group(c.in[0])];
  if (a.state != kNotReferenced) throw Refusal{kNotAllowed};
  a.state = kReferencing;
  return {};
}

std::string NewportXpsFirmware::Controller::stop_referencing(Call& c) {
  Axis& a = axes_[group(c.in[0])];
  if (a.state != kReferencing) throw Refusal{kNotAllowed};
  a.state = kReadyAfterHoming;
  return {};
}

std::string NewportXpsFirmware::Controller::reference(Call& c) {
  const std::size_t k = positioner(c.in[0]);
  Axis& a = axes_[k];
  if (a.state != kReferencing) throw Refusal{kNotAllowed};
  if (c.in[1] != "SetPosition") {
    unserved_.note(fmt::format("{}({})", c.function, c.in[1]), "not emulated: error -22");
    throw Refusal{kNotAllowed};
  }
  a.offset_deg += number(c.in[3]) - controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_));
  a.target_deg = number(c.in[3]);
  return {};
}

// Jogging: on and on at a velocity, to the end of the travel.

std::string NewportXpsFirmware::Controller::enable_jog(Call& c) {
  Axis& a = axes_[group(c.in[0])];
  if (a.state < kReadyAfterAbort || a.state > 19) throw Refusal{kNotAllowed};
  a.state = kJogging;
  a.jog = {0.0, a.acceleration};
  return {};
}

std::string NewportXpsFirmware::Controller::disable_jog(Call& c) {
  const std::size_t k = group(c.in[0]);
  Axis& a = axes_[k];
  if (a.state != kJogging || bench_->moving(kStageAxes[k], now_)) throw Refusal{kNotAllowed};
  a.target_deg = controller_deg(k, bench_->target(kStageAxes[k], now_));
  a.state = kReadyAfterMotion;
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  limits.speed_deg_per_s = a.speed;
  limits.acceleration_deg_per_s2 = limits.deceleration_deg_per_s2 = a.acceleration;
  bench_->set_motion_limits(kStageAxes[k], limits);
  return {};
}

std::string NewportXpsFirmware::Controller::set_jog(Call& c) {
  const std::size_t k = group(c.in[0]);
  Axis& a = axes_[k];
  if (a.state != kJogging) throw Refusal{kNotAllowed};
  const double speed = number(c.in[1]);
  const double acceleration = number(c.in[2]);
  if (!(std::abs(speed) <= settings_.max_speed_deg_per_s && acceleration > 0.0 &&
        acceleration <= settings_.max_acceleration_deg_per_s2))
    throw Refusal{kJogOutOfRange};
  a.jog = {speed, acceleration};
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  limits.acceleration_deg_per_s2 = limits.deceleration_deg_per_s2 = acceleration;
  if (speed != 0.0) limits.speed_deg_per_s = std::abs(speed);
  bench_->set_motion_limits(kStageAxes[k], limits);
  if (speed == 0.0) {
    bench_->halt(kStageAxes[k], now_);
  } else {
    bench_->move(kStageAxes[k], protocol_angle(k, speed > 0.0 ? a.travel_max_deg : a.travel_min_deg), now_);
  }
  return {};
}

std::string NewportXpsFirmware::Controller::jog_parameters(Call& c) {
  const Axis& a = axes_[group(c.in[0])];
  return decimal(a.jog[0]) + "," + decimal(a.jog[1]);
}

std::string NewportXpsFirmware::Controller::jog_now(Call& c) {
  const std::size_t k = group(c.in[0]);
  return decimal(velocity_at(k, now_)) + "," + decimal(axes_[k].jog[1]);
}

// Gathering.

double NewportXpsFirmware::Controller::velocity_at(std::size_t k, Clock::Instant t) const {
  constexpr Clock::Duration kCycle = XpsGathering::kServoCycle;
  const Angle turned = bench_->commanded_angle(kStageAxes[k], t) -
                       bench_->commanded_angle(kStageAxes[k], std::max(bench_->start(), t - kCycle));
  return settings_.sign[k] * turned.deg() / to_seconds(kCycle);
}

double NewportXpsFirmware::Controller::measured(const XpsGathering::Quantity& quantity,
                                                Clock::Instant t) const {
  const std::size_t k = quantity.axis;
  const double current = controller_deg(k, bench_->encoder_angle(kStageAxes[k], t));
  const double setpoint = controller_deg(k, bench_->commanded_angle(kStageAxes[k], t));
  switch (quantity.kind) {
    case XpsGathering::Kind::kCurrentPosition:
      return current;
    case XpsGathering::Kind::kSetpointPosition:
      return setpoint;
    case XpsGathering::Kind::kFollowingError:
      return current - setpoint;
    default:
      return velocity_at(k, t);
  }
}

void NewportXpsFirmware::Controller::gather() {
  gathering_.sample_until(now_,
                          [this](const auto& quantity, Clock::Instant t) { return measured(quantity, t); });
}

std::string NewportXpsFirmware::Controller::configure_gathering(Call& c) {
  if (gathering_.running()) throw Refusal{kGatheringRuns};
  std::vector<XpsGathering::Quantity> quantities;
  for (const std::string& name : c.in) {
    const auto kind = XpsGathering::kind_of(name);
    if (!kind) {
      unserved_.note(fmt::format("{}({})", c.function, name), "not emulated: error -29");
      throw Refusal{kNoGatheringType};
    }
    quantities.push_back({name, positioner(name.substr(0, name.rfind('.'))), *kind});
  }
  if (quantities.empty()) throw Refusal{kWrongCount};
  gathering_.configure(std::move(quantities));
  return {};
}

std::string NewportXpsFirmware::Controller::gathering_configuration(Call&) {
  std::string names;
  for (const auto& each : gathering_.quantities()) names += each.name + ";";
  return names;
}

std::string NewportXpsFirmware::Controller::gathering_types(Call&) {
  return "CurrentPosition;SetpointPosition;FollowingError;CurrentVelocity;SetpointVelocity;";
}

std::string NewportXpsFirmware::Controller::run_gathering(Call& c) {
  if (gathering_.quantities().empty()) throw Refusal{kGatheringNotConfigured};
  if (gathering_.running()) throw Refusal{kGatheringRuns};
  const double count = number(c.in[0]);
  const double divisor = number(c.in[1]);
  if (!(count >= 1.0 && count <= static_cast<double>(gathering_.capacity()) && divisor >= 1.0 &&
        divisor < 1e9))
    throw Refusal{kOutOfRange};
  gathering_.run(static_cast<std::size_t>(count), static_cast<unsigned>(divisor), now_);
  return {};
}

std::string NewportXpsFirmware::Controller::resume_gathering(Call&) {
  if (gathering_.quantities().empty()) throw Refusal{kGatheringNotConfigured};
  if (gathering_.running()) throw Refusal{kGatheringRuns};
  gathering_.resume(now_);
  return {};
}

std::string NewportXpsFirmware::Controller::stop_gathering(Call&) {
  if (gathering_.quantities().empty()) throw Refusal{kGatheringNotStarted};
  gathering_.stop();
  return {};
}

std::string NewportXpsFirmware::Controller::reset_gathering(Call&) {
  gathering_.clear();
  return {};
}

std::string NewportXpsFirmware::Controller::acquire(Call&) {
  if (gathering_.quantities().empty()) throw Refusal{kGatheringNotConfigured};
  gathering_.take_one(now_, [this](const auto& quantity, Clock::Instant t) { return measured(quantity, t); });
  return {};
}

std::string NewportXpsFirmware::Controller::gathered_number(Call&) {
  return fmt::format("{},{}", gathering_.size(), gathering_.capacity());
}

std::string NewportXpsFirmware::Controller::gathered_line(Call& c) {
  c.in.emplace_back("1");
  return gathered_lines(c);
}

/// The form of the lines is [unverified against a device].
std::string NewportXpsFirmware::Controller::gathered_lines(Call& c) {
  const double first = number(c.in[0]);
  const double count = number(c.in[1]);
  if (!(first >= 0.0 && count >= 1.0 && first + count <= static_cast<double>(gathering_.size())))
    throw Refusal{kOutOfRange};
  std::string lines;
  for (std::size_t n = 0; n < static_cast<std::size_t>(count); ++n)
    lines += (n == 0 ? "" : "\n") + gathering_.line(static_cast<std::size_t>(first) + n);
  return lines;
}

// Events: a trigger starts an action.

std::string NewportXpsFirmware::Controller::joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& each : words) text += each + ";";
  return text;
}

/// Triggers "Immediate", "Always" (with an event of a motion) and the starts and ends of motions. Others are
/// kept, and nothing happens.
std::string NewportXpsFirmware::Controller::configure_trigger(Call& c) {
  if (c.in.empty() || c.in.size() % 5 != 0) throw Refusal{kWrongCount};
  for (std::size_t n = 0; n < c.in.size(); n += 5) {
    const std::string& name = c.in[n];
    if (name != "Immediate" && name != "Always") either(name.substr(0, name.find(".SGamma")));
    if (!name.ends_with("MotionStart") && !name.ends_with("MotionEnd") && name != "Immediate" &&
        name != "Always")
      unserved_.note(fmt::format("{}({})", c.function, name), "kept; the event does not happen");
  }
  event_.trigger = c.in;
  return {};
}

std::string NewportXpsFirmware::Controller::configure_action(Call& c) {
  if (c.in.empty() || c.in.size() % 5 != 0) throw Refusal{kWrongCount};
  constexpr std::array<std::string_view, 4> kActions{"GatheringRun", "GatheringRunAppend", "GatheringStop",
                                                     "GatheringOneData"};
  for (std::size_t n = 0; n < c.in.size(); n += 5) {
    if (std::find(kActions.begin(), kActions.end(), c.in[n]) != kActions.end()) continue;
    unserved_.note(fmt::format("{}({})", c.function, c.in[n]), "not emulated: error -39");
    throw Refusal{kNoAction};
  }
  event_.action = c.in;
  return {};
}

std::string NewportXpsFirmware::Controller::start_event(Call&) {
  if (event_.trigger.empty()) throw Refusal{kNoEvent};
  if (event_.action.empty()) throw Refusal{kNoAction};
  if (event_.trigger[0] == "Immediate") act(event_);
  events_[++last_event_] = event_;
  return fmt::format("{}", last_event_);
}

std::string NewportXpsFirmware::Controller::all_events(Call&) {
  if (events_.empty()) throw Refusal{kNoEventId};
  std::string list;
  for (const auto& [id, event] : events_) list += fmt::format("{};", id);
  return list;
}

std::map<int, NewportXpsFirmware::Controller::Event>::iterator NewportXpsFirmware::Controller::event_of(
    const std::string& id) {
  const auto found = events_.find(static_cast<int>(number(id)));
  if (found == events_.end()) throw Refusal{kNoEventId};
  return found;
}

std::string NewportXpsFirmware::Controller::event(Call& c) {
  const Event& found = event_of(c.in[0])->second;
  return joined(found.trigger) + "," + joined(found.action);
}

std::string NewportXpsFirmware::Controller::remove_event(Call& c) {
  events_.erase(event_of(c.in[0]));
  return {};
}

void NewportXpsFirmware::Controller::motion_event(std::size_t k, std::string_view what) {
  for (const auto& [id, event] : events_) {
    const bool happens =
        std::any_of(event.trigger.begin(), event.trigger.end(), [&](const std::string& word) {
          return word.ends_with(what) && word.starts_with(axes_[k].positioner + ".");
        });
    if (happens) act(event);
  }
}

void NewportXpsFirmware::Controller::act(const Event& event) {
  for (std::size_t n = 0; n < event.action.size(); n += 5) {
    const std::string& action = event.action[n];
    Call call{action, {event.action[n + 1], event.action[n + 2]}};
    try {
      if (action == "GatheringRun") run_gathering(call);
      if (action == "GatheringRunAppend") resume_gathering(call);
      if (action == "GatheringStop") stop_gathering(call);
      if (action == "GatheringOneData") acquire(call);
    } catch (const Refusal&) {
      // A failed action is not reported to anyone.
    }
  }
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
    unserved().note(name, "not emulated: error -4", echo);
    return answer(kUnknownCommand, echo);
  }
  Controller::Call call;
  call.function = found->first;
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
  const bool counts_itself = function.inputs == Controller::kAnyNumber;
  if ((!counts_itself && call.in.size() != function.inputs) || call.outputs != function.outputs)
    return answer(kWrongCount, echo);
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
