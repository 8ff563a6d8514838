#include "drivers/pi_gcs/stage.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

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
#include "drivers/pi_gcs/codec.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::pi_gcs {
namespace {

using Lines = std::vector<std::string>;

constexpr std::string_view kIdentityQuery = "*IDN?";

/// Time that halt() leaves an exchange under way to end: its reply deadline, and some.
constexpr Clock::Duration kHaltWaitsForExchange = std::chrono::milliseconds(2500);
constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(20);

/// SPA parameters: counts per degree = numerator / denominator.
constexpr unsigned kCountsNumerator = 14;
constexpr unsigned kCountsDenominator = 15;
/// The unit of an axis, where the controller has no PUN? (E-861).
constexpr unsigned kUserUnit = 0x7000601;
constexpr int kErrorUnknownParameter = 54;

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  wire::check_stage_settings("PI", "the controller's name", stream, settings);
  for (const std::string& name : settings.axis_names) {
    if (name.find_first_of(" \t\r\n=") != std::string::npos) {
      throw std::invalid_argument(
          fmt::format("PI stage: axis name \"{}\" contains a blank or '='; required: a name without them",
                      printable(name)));
    }
  }
  if (settings.address.find_first_not_of("0123456789") != std::string::npos) {
    throw std::invalid_argument(fmt::format(
        "PI stage: address \"{}\"; required: the controller's number in the daisy chain, or nothing",
        printable(settings.address)));
  }
}

std::string stop_command(const StageSettings& settings) {
  std::string stop(1, kStopAllAxes);
  // Alone it reaches the first controller of a chain, not surely the others.
  if (!settings.address.empty()) stop += command_line("STP", settings.address);
  return stop;
}

wire::LineExchange::Manner manner(const StageSettings& settings) {
  return {.identity_request = command_line(kIdentityQuery, settings.address),
          .identity_name = kIdentityQuery,
          .error_request = command_line("ERR?", settings.address),
          .error_name = "ERR?",
          .patience = kReplyDeadline,
          .normal = [](std::string_view reply) { return std::string(reply); },
          .show = printable};
}

class PiGcsController final : public wire::LineController {
 public:
  PiGcsController(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : LineController("PI stage", std::move(stream), clock, check_reply,
                       {stop_command(settings), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}),
        settings_(settings),
        replies_(line(), manner(settings),
                 {[this](std::string_view after) { return read_error(after); },
                  [this](const std::string& reply) {
                    const auto lines = reply_lines(reply, settings_.address);
                    return lines ? parse_error_code(*lines) : std::nullopt;
                  }}) {}

  enum class MotionQuery { kMask, kStatus, kOnTarget };

  // ---- Errors

  InstrumentError refusal(int code, std::string_view command) const {
    const Fault fault = code == kErrorPositionOutOfLimits ? Fault::kOutOfTravel : Fault::kRefused;
    return failure(fault, fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command));
  }

  // ---- Replies

  /// A parser of the lines of a reply, for the reply itself.
  template <class Parse>
  auto of_lines(Parse parse) {
    using Value = std::invoke_result_t<Parse, const Lines&>;
    return [this, parse](const std::string& reply) {
      const auto lines = reply_lines(reply, settings_.address);
      return lines ? parse(*lines) : Value();
    };
  }

  template <class Parse>
  auto ask(const std::string& request, std::string_view shown, Parse parse) {
    return replies_.ask(request, shown, of_lines(parse), kReplyDeadline);
  }

  /// Asks for what the controller must know.
  template <class Parse>
  auto require(std::string_view text, Parse parse) {
    return replies_.require(command_line(text, settings_.address), text, of_lines(parse),
                            [this](int code, std::string_view query) { return refusal(code, query); });
  }

  /// Asks for what it need not know: nothing if it does not.
  template <class Parse>
  auto ask_optional(std::string_view text, Parse parse) {
    auto answer =
        replies_.ask(command_line(text, settings_.address), text, of_lines(parse), kOptionalReplyDeadline);
    if (!answer.value && answer.error != 0 && answer.error != kErrorUnknownCommand &&
        answer.error != kErrorUnknownParameter) {
      throw refusal(answer.error, text);
    }
    return std::move(answer.value);
  }

  // ---- The error code

  /// Reads and thereby clears the error code. That a halt has stopped the axes is not the answer to anything
  /// that is asked here.
  int read_error(std::string_view after) {
    const int code = replies_.ask_error(after);
    replies_.error_may_wait(false);
    return code == kErrorStoppedByCommand ? 0 : code;
  }

  /// Sends a set command, once, and returns what the controller says to it.
  int execute(std::string_view command) {
    const std::uint64_t halts = line().halts();
    int code = replies_.execute(command_line(command, settings_.address), command);
    replies_.error_may_wait(false);
    // Only a stop causes error 10. Of one that came before the command, its line being slow, it says nothing
    // of the command: that would have set a code of its own in place of it.
    if (code == kErrorStoppedByCommand && line().halts() == halts && !line().halting())
      code = read_error(command);
    return code;
  }

  void execute_or_throw(std::string_view command) {
    if (const int code = execute(command); code != 0) throw refusal(code, command);
  }

  // ---- The controller

  void identify_controller() {
    known_ = false;
    const auto accept = [this](const std::string& reply) {
      const auto lines = reply_lines(reply, settings_.address);
      const auto identity = lines ? parse_identity(*lines) : std::nullopt;
      if (identity) identity_ = *identity;
      return identity.has_value();
    };
    replies_.identify(accept,
                      "is the controller on, is the cable in the right connector, and are baud rate and "
                      "address as in the bench file?",
                      "a PI controller", kLongestReply);
    std::string who = "stage " + identity_.model;
    if (!identity_.serial_number.empty()) who += " (SN " + identity_.serial_number + ")";
    if (!settings_.address.empty()) who += " at address " + settings_.address;
    line().rename(who);
  }

  /// Once, before anything else is asked: a PI controller, which has our axes, in degrees.
  void ensure_known() {
    if (known_) return;
    identify_controller();
    replies_.error_may_wait(true);
    read_error("an earlier program");
    axes_ = require("SAI?", [](const Lines& lines) -> std::optional<Lines> {
      const bool plausible =
          !lines.empty() && std::all_of(lines.begin(), lines.end(), [](const std::string& line) {
            return !line.empty() && line.size() <= 16 && line.find_first_of("= ,") == std::string::npos;
          });
      return plausible ? std::optional(lines) : std::nullopt;
    });
    for (const StageAxis axis : kStageAxes) {
      const std::string& name = settings_.axis_names[index(axis)];
      if (name.empty()) continue;
      const auto found = std::find(axes_.begin(), axes_.end(), name);
      if (found == axes_.end()) {
        throw failure(Fault::kWrongIdentity, fmt::format("has no axis \"{}\" (for {}); its axes are {}", name,
                                                         to_string(axis), fmt::join(axes_, ", ")));
      }
      position_[index(axis)] = static_cast<std::size_t>(found - axes_.begin());
      require_degrees(name);
    }
    known_ = true;
  }

  /// By PUN?, else by the axis' parameter, else as the bench file says.
  void require_degrees(const std::string& name) {
    auto unit = ask_optional(fmt::format("PUN? {}", name),
                             [&name](const Lines& lines) { return axis_value(lines, name); });
    if (!unit) {
      unit = ask_optional(fmt::format("SPA? {} 0x{:X}", name, kUserUnit),
                          [](const Lines& lines) { return parameter_text(lines, kUserUnit); });
    }
    if (!unit && settings_.unit.empty()) {
      throw failure(Fault::kWrongIdentity,
                    fmt::format("axis \"{}\" does not report its unit (PUN?, parameter 0x{:X}); if the unit "
                                "is degrees, set unit = \"deg\" under [stage]",
                                name, kUserUnit));
    }
    if (!is_degrees(unit.value_or(settings_.unit))) {
      throw failure(
          Fault::kWrongIdentity,
          fmt::format(
              "the unit of axis \"{}\" is \"{}\"; required: degrees (set PUN, or the stage's parameters)",
              name, printable(unit.value_or(settings_.unit))));
    }
  }

  const std::string& name_of(StageAxis axis) const {
    const std::string& name = settings_.axis_names[index(axis)];
    if (name.empty())
      throw failure(Fault::kNotReady, fmt::format("axis {} is not on this controller", to_string(axis)));
    return name;
  }

  auto flag_of(const std::string& axis) {
    return [&axis](const Lines& lines) { return axis_flag(lines, axis); };
  }
  auto number_of(const std::string& axis) {
    return [&axis](const Lines& lines) { return axis_number(lines, axis); };
  }

  StageAxisInfo axis_info(StageAxis axis) {
    const std::string& name = name_of(axis);
    StageAxisInfo info;
    info.stage_name = ask_optional(fmt::format("CST? {}", name), [&name](const Lines& lines) {
                        return axis_value(lines, name);
                      }).value_or("");
    info.travel_min = Angle::degrees(require(fmt::format("TMN? {}", name), number_of(name)));
    info.travel_max = Angle::degrees(require(fmt::format("TMX? {}", name), number_of(name)));
    info.referenced = require(fmt::format("FRF? {}", name), flag_of(name));
    // The speed that moves will have: the bench file's is set before the first one.
    const auto speed = ask_optional(fmt::format("VEL? {}", name), number_of(name));
    info.speed_deg_per_s = settings_.speed_deg_per_s[index(axis)].value_or(speed.value_or(0.0));
    const auto counts = [this, &name](unsigned parameter) {
      return ask_optional(fmt::format("SPA? {} {}", name, parameter),
                          [parameter](const Lines& lines) { return parameter_number(lines, parameter); });
    };
    if (const auto numerator = counts(kCountsNumerator); numerator && *numerator != 0.0) {
      const auto denominator = counts(kCountsDenominator);
      if (denominator) info.resolution = Angle::degrees(std::abs(*denominator / *numerator));
    }
    return info;
  }

  StageInfo identify() override {
    known_ = false;  // A controller that was swapped or switched off and on since is noticed.
    servo_on_ = {false, false};
    speed_set_ = {false, false};
    motion_query_ = MotionQuery::kMask;
    ensure_known();
    StageInfo info;
    info.maker = identity_.maker;
    info.model = identity_.model;
    info.serial_number = identity_.serial_number;
    info.firmware = identity_.firmware;
    for (const StageAxis axis : kStageAxes) {
      if (!settings_.axis_names[index(axis)].empty()) info.axes[index(axis)] = axis_info(axis);
    }
    return info;
  }

  void apply_speed(StageAxis axis) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)]) return;
    execute_or_throw(fmt::format("VEL {} {:.6f}", name_of(axis), *speed));
    speed_set_[index(axis)] = true;
  }

  void home(StageAxis axis) override {
    const std::string& name = name_of(axis);
    ensure_known();
    const std::string enable = fmt::format("EAX {} 1", name);
    if (const int code = execute(enable); code != 0 && code != kErrorUnknownCommand)
      throw refusal(code, enable);
    execute_or_throw(fmt::format("SVO {} 1", name));
    servo_on_[index(axis)] = true;
    apply_speed(axis);
    // A controller that does not know TRS? is taken to have the switch: FRF itself will say if not.
    if (ask_optional(fmt::format("TRS? {}", name), flag_of(name)).value_or(true)) {
      execute_or_throw(fmt::format("FRF {}", name));
    } else if (ask_optional(fmt::format("LIM? {}", name), flag_of(name)).value_or(false)) {
      execute_or_throw(fmt::format("FNL {}", name));
    } else {
      throw failure(
          Fault::kNotReady,
          fmt::format("axis \"{}\" has neither a reference switch nor limit switches (TRS?, LIM?), so it "
                      "cannot be homed; set its position with the maker's program",
                      name));
    }
  }

  void move_to(StageAxis axis, Angle target) override {
    const std::string& name = name_of(axis);
    if (!std::isfinite(target.deg())) {
      throw failure(Fault::kOutOfTravel,
                    fmt::format("target {} of axis \"{}\" is not a number", target.deg(), name));
    }
    ensure_known();
    if (!servo_on_[index(axis)]) {
      if (!require(fmt::format("SVO? {}", name), flag_of(name)))
        execute_or_throw(fmt::format("SVO {} 1", name));
      servo_on_[index(axis)] = true;
    }
    apply_speed(axis);
    const std::string command = move_command(name, target);
    const int code = execute(command);
    if (code == 0) return;
    servo_on_[index(axis)] = false;  // Ask again before the next move.
    if (code == kErrorUnreferencedOrServoOff || code == kErrorNoReference)
      throw not_ready(name, code, command);
    throw refusal(code, command);
  }

  /// Error 5 has two causes; the controller knows which.
  InstrumentError not_ready(const std::string& name, int code, const std::string& command) {
    const std::string said = fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command);
    if (code == kErrorUnreferencedOrServoOff && require(fmt::format("FRF? {}", name), flag_of(name))) {
      return failure(
          Fault::kNotReady,
          fmt::format("the servo of axis \"{}\" is off although the axis has its reference: {}", name, said));
    }
    return failure(Fault::kNotReady,
                   fmt::format("axis \"{}\" has lost its reference; home it: {}", name, said));
  }

  /// Whether the controller knows #5, #4 or only ONT? is found out by asking, in this order.
  bool moving(StageAxis axis) {
    const std::size_t position = position_[index(axis)];
    if (motion_query_ == MotionQuery::kMask) {
      const auto mask = ask(single_byte(kAskMotion, settings_.address), "#5", parse_motion_mask);
      if (mask.value) return ((*mask.value >> position) & 1U) != 0;
      motion_query_ = MotionQuery::kStatus;
    }
    if (motion_query_ == MotionQuery::kStatus) {
      const auto status =
          ask(single_byte(kAskStatus, settings_.address), "#4", [position](const Lines& lines) {
            auto words = parse_status(lines);
            if (words && words->size() <= position) words.reset();
            return words;
          });
      if (status.value) {
        const AxisStatus& word = (*status.value)[position];
        return word.moving || word.homing;
      }
      motion_query_ = MotionQuery::kOnTarget;
    }
    const std::string& name = name_of(axis);
    return !require(fmt::format("ONT? {}", name), flag_of(name));
  }

  MotionState motion_state(StageAxis axis) override {
    name_of(axis);
    ensure_known();
    return moving(axis) ? MotionState::kMoving : MotionState::kStopped;
  }

  Angle encoder_angle(StageAxis axis) override {
    const std::string& name = name_of(axis);
    ensure_known();
    return Angle::degrees(require(fmt::format("POS? {}", name), number_of(name)));
  }

  // ---- Halt

  void forget_motion() override {
    servo_on_ = {false, false};
    replies_.error_may_wait(true);
  }

  Clock::Duration reply_deadline() const override { return kReplyDeadline; }

  bool has_stopped() override {
    if (replies_.identity().empty()) identify_controller();
    const int code = replies_.ask_error("#24");
    replies_.error_may_wait(false);
    if (code == kErrorStoppedByCommand) return true;
    if (motion_query_ == MotionQuery::kMask) {
      const auto mask = ask(single_byte(kAskMotion, settings_.address), "#5", parse_motion_mask);
      return mask.value == std::uint64_t{0};
    }
    return std::none_of(kStageAxes.begin(), kStageAxes.end(), [this](StageAxis axis) {
      return !settings_.axis_names[index(axis)].empty() && moving(axis);
    });
  }

  /// A half-written command becomes one with a word too many, which the controller refuses. The identity
  /// comes in between, so that an older reply does not pass for the mask.
  HaltRecipe halt_recipe() const override {
    const std::string chained = settings_.address.empty() ? "" : "0 " + settings_.address + " ";
    return {.driver = "pi_gcs",
            .axes = {!settings_.axis_names[0].empty(), !settings_.axis_names[1].empty()},
            .end_partial = " x\n",
            .stop = stop_command(settings_),
            .questions = {{.bytes = command_line(kIdentityQuery, settings_.address),
                           .reply = ".*Physik Instrumente.*",
                           .standing = {}},
                          {.bytes = single_byte(kAskMotion, settings_.address),
                           .reply = chained + "[0-9A-Fa-f]+",
                           .standing = chained + "0+"}},
            .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kReplyDeadline)};
  }

 private:
  const StageSettings settings_;
  wire::LineExchange replies_;
  Identity identity_;
  bool known_ = false;
  Lines axes_;                             ///< SAI?
  std::array<std::size_t, 2> position_{};  ///< Of our axes in it.
  std::array<bool, 2> servo_on_{};
  std::array<bool, 2> speed_set_{};
  MotionQuery motion_query_ = MotionQuery::kMask;
};

}  // namespace

PiGcsStage::PiGcsStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
    : LineStage((check_settings(stream.get(), settings),
                 std::make_unique<PiGcsController>(std::move(stream), clock, settings))) {}

}  // namespace abcal::pi_gcs
