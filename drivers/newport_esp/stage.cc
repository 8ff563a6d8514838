#include "drivers/newport_esp/stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/newport_esp/codec.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::newport_esp {
namespace {

constexpr std::string_view kIdentityQuery = "VE?";
constexpr std::string_view kErrorQuery = "TB?";

/// The error buffer is a FIFO; ten entries are usual [unverified against a device]. A reply that never ends
/// the list is not an error buffer.
constexpr int kMostErrors = 32;

/// Time that halt() leaves an exchange under way to end: its reply deadline, and some.
constexpr Clock::Duration kHaltWaitsForExchange = kReplyDeadline + std::chrono::milliseconds(500);
constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(50);

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  wire::check_stage_settings("Newport", "the number", stream, settings);
  for (const std::string& name : settings.axis_names) {
    if (!name.empty() && (name.size() != 1 || name[0] < '1' || name[0] > '6')) {
      throw std::invalid_argument(fmt::format(
          "Newport stage: axis name \"{}\"; required: an axis number from 1 to 6", printable(name)));
    }
  }
  if (!settings.address.empty()) {
    throw std::invalid_argument(fmt::format(
        "Newport stage: address \"{}\"; required: none, because an ESP controller on RS-232 has no address",
        printable(settings.address)));
  }
}

/// The axis of a command; 0: it has none.
int axis_in(std::string_view command) {
  const bool has_axis = !command.empty() && command.front() >= '1' && command.front() <= '9';
  return has_axis ? command.front() - '0' : 0;
}

/// Empty for empty and unsolicited lines, which are skipped.
std::string normal_line(std::string_view line) {
  const auto text = line_text(line);
  if (!text) return std::string(line);
  return is_unsolicited(*text) ? std::string() : *text;
}

wire::LineExchange::Manner manner() {
  return {.identity_request = command_line(kIdentityQuery),
          .identity_name = kIdentityQuery,
          .error_request = command_line(kErrorQuery),
          .error_name = kErrorQuery,
          .patience = kReplyDeadline,
          .normal = normal_line,
          .show = printable};
}

class NewportEspController final : public wire::LineController {
 public:
  NewportEspController(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : LineController("Newport ESP stage", std::move(stream), clock, check_reply,
                       {command_line("ST"), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}),
        settings_(settings),
        replies_(line(), manner(),
                 {[this](std::string_view after) { return errors_of(after, axis_in(after)); },
                  [this](const std::string& reply) { return code_in(reply); }}) {}

  // ---- Errors

  InstrumentError refusal(int code, std::string_view command) const {
    const int axis_code = error_axis(code) == 0 ? -1 : code % 100;
    Fault fault = Fault::kRefused;
    if (axis_code == kAxisErrorPositiveSoftLimit || axis_code == kAxisErrorNegativeSoftLimit)
      fault = Fault::kOutOfTravel;
    if (axis_code == kAxisErrorMotorOff) fault = Fault::kNotReady;
    return failure(fault, fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command));
  }

  // ---- Replies

  template <class Parse>
  auto of_text(Parse parse) {
    using Value = std::invoke_result_t<Parse, std::string_view>;
    return [parse](const std::string& reply) {
      const auto text = line_text(reply);
      return text ? parse(*text) : Value();
    };
  }

  template <class Parse>
  auto ask(const std::string& query, Parse parse) {
    return replies_.ask(command_line(query), query, of_text(parse), kReplyDeadline);
  }

  /// Asks a question that the controller must know.
  template <class Parse>
  auto require(const std::string& query, Parse parse) {
    return replies_.require(command_line(query), query, of_text(parse),
                            [this](int code, std::string_view asked) { return refusal(code, asked); });
  }

  // ---- The error buffer

  std::optional<int> code_in(const std::string& reply) {
    const auto text = line_text(reply);
    const auto report = text ? parse_error_report(*text) : std::nullopt;
    if (!report) return std::nullopt;
    // The time stamp counts from power-on of the controller [unverified against a device]; if it decreases,
    // the controller was switched on again, or the counter overflowed. In both cases the reference is no
    // longer known.
    const bool restarted = report->time_stamp < last_time_stamp_;
    last_time_stamp_ = report->time_stamp;
    if (restarted) {
      forget();
      throw failure(Fault::kNotReady,
                    "the controller was switched off and on (its time stamp decreased), so its axes have "
                    "lost their reference; home them");
    }
    return report->code;
  }

  /// Whether an entry of the buffer is of the other axis of this stage: then it answers nothing that was
  /// asked of `axis`, and is kept, as it has ended the motion of its own.
  bool is_of_another_axis(int code, int axis) {
    const int other = error_axis(code);
    if (other == 0 || other == axis) return false;
    for (const StageAxis mine : kStageAxes) {
      if (settings_.axis_names[index(mine)] != std::to_string(other)) continue;
      int& first = motion_error_[index(mine)];
      if (first == 0) first = code;
      return true;
    }
    return false;
  }

  /// Empties the buffer and returns the oldest entry that is of this axis or of the controller (`axis` 0: the
  /// oldest of all): the first cause. Others are kept for the motion of their own axis.
  int errors_of(std::string_view after, int axis) {
    int first = 0;
    int code = 0;
    for (int n = 0; n < kMostErrors; ++n) {
      code = replies_.ask_error(after);
      if (code == 0) {
        replies_.error_may_wait(false);
        return first;
      }
      if (axis != 0 && is_of_another_axis(code, axis)) continue;
      if (first == 0) first = code;
    }
    throw failure(Fault::kBadFrame, fmt::format("{} errors in a row, the first {} ({})", kMostErrors, first,
                                                error_text(first)));
  }

  /// Sends a set command of an axis, once, and returns the controller's error code. An error of the other
  /// axis, whose motion has just ended, is not the answer to it.
  int execute(StageAxis axis, std::string_view words) {
    const std::string command = name_of(axis) + std::string(words);
    const int number = axis_in(command);
    int code = replies_.execute(command_line(command), command);
    if (code == 0) {
      replies_.error_may_wait(false);
      return code;
    }
    if (is_of_another_axis(code, number)) return errors_of(command, number);
    errors_of(command, number);  // Also reads other errors that the command left.
    return code;
  }

  void execute_or_throw(StageAxis axis, std::string_view words) {
    if (const int code = execute(axis, words); code != 0)
      throw refusal(code, name_of(axis) + std::string(words));
  }

  // ---- The controller

  /// Forgets the state of a controller that has been replaced or restarted.
  void forget() {
    known_ = false;
    referenced_ = {};
    homing_ = {};
    motor_on_ = {};
    speed_set_ = {};
    motion_error_ = {};
    replies_.error_may_wait(true);
  }

  void identify_controller() {
    const std::string known_reply = replies_.identity();
    known_ = false;
    const auto accept = [this](const std::string& reply) {
      const auto text = line_text(reply);
      const auto identity = text ? parse_identity(*text) : std::nullopt;
      if (identity) identity_ = *identity;
      return identity.has_value();
    };
    replies_.identify(accept,
                      "is the controller on, is its RS-232 port (not its USB port) connected, is the baud "
                      "rate 19200, and are RTS/CTS wired?",
                      "an ESP controller", 4 * kLongestReply);
    if (replies_.identity() != known_reply) {
      forget();
      last_time_stamp_ = 0;
    }
    line().rename("stage " + identity_.model);
  }

  /// Once, before anything else is asked: an ESP controller, which has our axes, in degrees.
  void ensure_known() {
    if (known_) return;
    identify_controller();
    errors_of("an earlier program", 0);
    for (const StageAxis axis : kStageAxes) {
      const std::string& name = settings_.axis_names[index(axis)];
      if (name.empty()) continue;
      const std::string query = name + "SN?";
      const auto unit = ask(query, parse_unit);
      if (!unit.value) {
        const bool absent = unit.error == kErrorNoSuchAxis ||
                            (error_axis(unit.error) != 0 && unit.error % 100 == kAxisErrorNotConnected);
        if (absent)
          throw failure(
              Fault::kWrongIdentity,
              fmt::format("there is no axis {} (for {}) on this controller: error {} ({}) to \"{}\"", name,
                          to_string(axis), unit.error, error_text(unit.error), query));
        if (unit.error != 0) throw refusal(unit.error, query);
        throw failure(Fault::kNoReply, fmt::format("no answer to \"{}\", asked twice", query));
      }
      if (*unit.value != kUnitDegrees) {
        throw failure(Fault::kWrongIdentity,
                      fmt::format("the unit of axis {} is {} (SN? is {}); required: degrees (send {}SN{}, "
                                  "check speed and limits, save with SM)",
                                  name, unit_name(*unit.value), *unit.value, name, kUnitDegrees));
      }
    }
    known_ = true;
  }

  const std::string& name_of(StageAxis axis) const {
    const std::string& name = settings_.axis_names[index(axis)];
    if (name.empty())
      throw failure(Fault::kNotReady, fmt::format("axis {} is not on this controller", to_string(axis)));
    return name;
  }

  std::optional<StageIdentity> stage_identity(StageAxis axis) {
    return ask(name_of(axis) + "ID?", parse_stage_identity).value;
  }

  StageAxisInfo axis_info(StageAxis axis, const std::optional<StageIdentity>& stage) {
    const std::string& name = name_of(axis);
    StageAxisInfo info;
    if (stage) info.stage_name = stage->model;
    info.travel_min = Angle::degrees(require(name + "SL?", parse_number));
    info.travel_max = Angle::degrees(require(name + "SR?", parse_number));
    // The speed that moves will have: the bench file's is set before the first one.
    const double speed = require(name + "VA?", parse_number);
    info.speed_deg_per_s = settings_.speed_deg_per_s[index(axis)].value_or(speed);
    info.resolution = Angle::degrees(std::abs(ask(name + "SU?", parse_number).value.value_or(0.0)));
    info.referenced = referenced_[index(axis)];
    return info;
  }

  StageInfo identify() override {
    known_ = false;  // A controller that was swapped or switched off and on since is noticed.
    motor_on_ = {};
    speed_set_ = {};
    try {
      ensure_known();
    } catch (const InstrumentError& error) {
      // The controller was switched off and on. Its old state is now forgotten, and the repeated call
      // describes the new one.
      if (error.fault() != Fault::kNotReady || line().halting()) throw;
      ensure_known();
    }
    StageInfo info;
    info.maker = "Newport";
    info.model = identity_.model;
    info.firmware = identity_.firmware;
    for (const StageAxis axis : kStageAxes) {
      if (settings_.axis_names[index(axis)].empty()) continue;
      const auto stage = stage_identity(axis);
      const std::string seen = stage ? stage->model + " " + stage->serial_number : std::string();
      const std::string before = std::exchange(stage_seen_[index(axis)], seen);
      if (!before.empty() && before != seen) referenced_[index(axis)] = false;  // Another stage by now.
      info.axes[index(axis)] = axis_info(axis, stage);
      if (!stage || stage->serial_number.empty()) continue;
      if (!info.serial_number.empty()) info.serial_number += "/";
      info.serial_number += stage->serial_number;
    }
    return info;
  }

  void switch_on(StageAxis axis) {
    if (motor_on_[index(axis)]) return;
    const std::string& name = name_of(axis);
    if (!require(name + "MO?", parse_flag)) execute_or_throw(axis, "MO");
    motor_on_[index(axis)] = true;
  }

  void apply_speed(StageAxis axis) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)]) return;
    execute_or_throw(axis, fmt::format("VA{:.6f}", *speed));
    speed_set_[index(axis)] = true;
  }

  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    ensure_known();
    replace_speed(settings_.speed_deg_per_s[index(axis)], usual_speed_[index(axis)], deg_per_s,
                  [&] { return axis_info(axis, std::nullopt).speed_deg_per_s; });
    speed_set_[index(axis)] = false;
    apply_speed(axis);
  }

  void home(StageAxis axis) override {
    name_of(axis);
    ensure_known();
    referenced_[index(axis)] = false;
    motion_error_[index(axis)] = 0;
    motor_on_[index(axis)] = false;  // Ask again: a fault switches it off.
    switch_on(axis);
    apply_speed(axis);
    execute_or_throw(axis, "OR");
    homing_[index(axis)] = true;
  }

  void move_to(StageAxis axis, Angle target) override {
    const std::string& name = name_of(axis);
    if (!std::isfinite(target.deg())) {
      throw failure(Fault::kOutOfTravel,
                    fmt::format("target {} of axis {} is not a number", target.deg(), name));
    }
    ensure_known();
    if (!referenced_[index(axis)]) {
      throw failure(Fault::kNotReady,
                    fmt::format("axis {} has not been homed by this program, and the controller cannot "
                                "report whether it was homed before; home it",
                                name));
    }
    switch_on(axis);
    apply_speed(axis);
    motion_error_[index(axis)] = 0;
    const std::string command = move_command(name, target);
    if (const int code = execute(axis, std::string_view(command).substr(name.size())); code != 0) {
      motor_on_[index(axis)] = false;  // Ask again before the next move.
      throw refusal(code, command);
    }
  }

  bool done(StageAxis axis) { return require(name_of(axis) + "MD?", parse_flag); }

  bool moving(StageAxis axis) {
    if (!done(axis)) return true;
    // An axis that a fault has stopped reads as done as well.
    int code = errors_of("the motion", 0);
    if (code == 0) code = std::exchange(motion_error_[index(axis)], 0);  // Seen between other questions.
    if (code != 0) {
      homing_[index(axis)] = false;
      motor_on_[index(axis)] = false;
      throw failure(Fault::kRefused,
                    fmt::format("error {} ({}) has ended the motion of axis {} or of the other axis", code,
                                error_text(code), name_of(axis)));
    }
    if (std::exchange(homing_[index(axis)], false)) referenced_[index(axis)] = true;
    return false;
  }

  MotionState motion_state(StageAxis axis) override {
    name_of(axis);
    ensure_known();
    return moving(axis) ? MotionState::kMoving : MotionState::kStopped;
  }

  Angle encoder_angle(StageAxis axis) override {
    const std::string& name = name_of(axis);
    ensure_known();
    return Angle::degrees(require(name + "TP?", parse_number));
  }

  // ---- Halt

  void forget_motion() override {
    homing_ = {};
    motor_on_ = {};
    motion_error_ = {};
    replies_.error_may_wait(true);
  }

  Clock::Duration reply_deadline() const override { return kReplyDeadline; }

  HaltReport stopped_axes(const HaltReport& /*so_far*/) override {
    if (replies_.identity().empty()) identify_controller();
    const bool all = std::all_of(kStageAxes.begin(), kStageAxes.end(), [this](StageAxis axis) {
      return settings_.axis_names[index(axis)].empty() || done(axis);
    });
    return HaltReport::of_both(all);
  }

  /// A half-written command ends in words that no command has, which the controller refuses.
  std::vector<HaltRecipe> halt_recipes() const override {
    HaltRecipe recipe{.driver = "newport_esp",
                      .axes = {!settings_.axis_names[0].empty(), !settings_.axis_names[1].empty()},
                      .end_partial = "!\r",
                      .stop = command_line("ST"),
                      .questions = {{.bytes = command_line(kIdentityQuery),
                                     .reply = {pattern::literal("ESP30"), pattern::text()},
                                     .standing = {}}},
                      .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kReplyDeadline)};
    for (const std::string& name : settings_.axis_names) {
      if (name.empty()) continue;
      recipe.questions.push_back({.bytes = command_line(name + "MD?"),
                                  .reply = {pattern::spaces(), pattern::number(0, 1), pattern::spaces()},
                                  .standing = {pattern::spaces(), pattern::literal("1"), pattern::spaces()}});
    }
    return {recipe};
  }

 private:
  StageSettings settings_;
  std::array<std::optional<double>, 2> usual_speed_{};  ///< Before set_speed().
  wire::LineExchange replies_;
  Identity identity_;
  bool known_ = false;
  std::uint64_t last_time_stamp_ = 0;
  std::array<std::string, 2> stage_seen_;
  std::array<bool, 2> referenced_{};
  std::array<bool, 2> homing_{};
  std::array<bool, 2> motor_on_{};
  std::array<bool, 2> speed_set_{};
  std::array<int, 2> motion_error_{};  ///< Errors of motions that occurred between other questions; 0: none.
};

}  // namespace

NewportEspStage::NewportEspStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                 const StageSettings& settings)
    : LineStage((check_settings(stream.get(), settings),
                 std::make_unique<NewportEspController>(std::move(stream), clock, settings))) {}

}  // namespace abcal::newport_esp
