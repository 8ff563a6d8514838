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
#include "drivers/wire/haltable_line.h"

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
constexpr int kErrorUnknownParameter = 54;

void check_settings(const StageSettings& settings) {
  const auto& names = settings.axis_names;
  if (names[0].empty() && names[1].empty()) {
    throw std::invalid_argument(
        "PI stage: no axis is named; required is the controller's name of X, Z or both");
  }
  if (names[0] == names[1]) {
    throw std::invalid_argument(
        fmt::format("PI stage: X and Z are both axis \"{}\"; two different axes are required", names[0]));
  }
  for (const std::string& name : names) {
    if (name.find_first_of(" \t\r\n=") != std::string::npos) {
      throw std::invalid_argument(
          fmt::format("PI stage: axis name \"{}\" has a blank or '=' in it", printable(name)));
    }
  }
  for (const auto& speed : settings.speed_deg_per_s) {
    if (speed && !(std::isfinite(*speed) && *speed > 0.0)) {
      throw std::invalid_argument(
          fmt::format("PI stage: speed {} deg/s; required is a positive number", *speed));
    }
  }
  if (settings.address.find_first_not_of("0123456789") != std::string::npos) {
    throw std::invalid_argument(fmt::format(
        "PI stage: address \"{}\"; required is the controller's number in the daisy chain, or nothing",
        printable(settings.address)));
  }
}

std::string stop_command(const StageSettings& settings) {
  std::string stop(1, kStopAllAxes);
  // Alone it reaches the first controller of a chain, not surely the others.
  if (!settings.address.empty()) stop += command_line("STP", settings.address);
  return stop;
}

}  // namespace

// How a late reply is kept from being taken for the answer to the next query: line commands are answered in
// order. So once a reply is missing or garbled, nothing else is asked before "*IDN?" (whose answer is known
// to the letter, and looks like no other) has been answered; whatever came before that answer belongs to the
// past.
struct PiGcsStage::Impl {
  Impl(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : settings_(settings),
        line_("PI stage", std::move(stream), clock, check_reply,
              {stop_command(settings), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}) {}

  /// What became of a query that the controller need not know. No value and no error: it stayed silent.
  template <class T>
  struct Answer {
    std::optional<T> value;
    int error = 0;
  };

  enum class MotionQuery { kMask, kStatus, kOnTarget };

  // ---- Errors

  InstrumentError failure(Fault fault, std::string_view detail) const { return line_.failure(fault, detail); }

  InstrumentError refusal(int code, std::string_view command) const {
    const Fault fault = code == kErrorPositionOutOfLimits ? Fault::kOutOfTravel : Fault::kRefused;
    return failure(fault, fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command));
  }

  // ---- Bytes

  /// Throws away stale input, sends, and waits for one reply.
  std::optional<std::string> exchange(std::string_view request, Clock::Duration patience) {
    line_.discard_input();
    line_.send(request);
    const Clock::Instant deadline = line_.deadline_after(patience);
    for (;;) {
      std::optional<std::string> reply = line_.take_frame(deadline);
      // Of an earlier resynchronise() that gave up too soon.
      if (reply && *reply == identity_reply_) continue;
      return reply;
    }
  }

  // ---- Replies in step with queries

  /// Returns once the controller has answered "*IDN?". What it sent before that, if it is one whole reply, is
  /// the late answer to the query that had none.
  std::optional<std::string> resynchronise(std::string_view unanswered) {
    line_.send(command_line(kIdentityQuery, settings_.address));
    const Clock::Instant deadline = line_.deadline_after(kReplyDeadline);
    std::vector<std::string> before;
    while (const std::optional<std::string> reply = line_.take_frame(deadline)) {
      if (reply->ends_with(identity_reply_)) {
        in_step_ = true;
        const bool alone = reply->size() == identity_reply_.size();  // Else half a reply came before it.
        if (alone && before.size() == 1) return before.front();
        return std::nullopt;
      }
      before.push_back(*reply);
    }
    std::string heard;
    for (const std::string& reply : before) heard += reply;
    heard += line_.received();
    throw failure(Fault::kNoReply,
                  fmt::format("no answer to \"{}\" within {} s, nor then to \"{}\"; {}", unanswered,
                              to_seconds(kReplyDeadline), kIdentityQuery,
                              heard.empty() ? std::string("nothing arrived")
                                            : fmt::format("what arrived was \"{}\"", printable(heard))));
  }

  void ensure_in_step(std::string_view next) {
    if (!in_step_) resynchronise(next);
  }

  /// Asks at most twice. Throws kNoReply if the controller is silent altogether, kBadFrame if both replies
  /// were garbled.
  template <class Parse>
  auto ask(const std::string& request, std::string_view shown, Parse parse,
           Clock::Duration patience = kReplyDeadline) {
    using T = typename std::invoke_result_t<Parse, const Lines&>::value_type;
    for (int attempt = 1;; ++attempt) {
      ensure_in_step(shown);
      std::optional<std::string> reply = exchange(request, patience);
      if (!reply) {
        in_step_ = false;
        reply = resynchronise(shown);
      }
      if (reply) {
        if (const auto lines = reply_lines(*reply, settings_.address)) {
          if (auto value = parse(*lines)) return Answer<T>{std::move(value), 0};
        }
        in_step_ = false;
        if (attempt == 2) {
          throw failure(Fault::kBadFrame,
                        fmt::format("\"{}\" is no answer to \"{}\"", printable(*reply), shown));
        }
        continue;
      }
      // It is there, but said nothing to this query: then it has put the reason into its error code, unless
      // that was there before (an unacknowledged halt leaves one).
      const bool was_there = error_may_wait_;
      if (const int code = read_error(shown); code != 0 && !was_there) return Answer<T>{std::nullopt, code};
      if (attempt == 2) return Answer<T>{};
    }
  }

  template <class Parse>
  auto ask_line(std::string_view text, Parse parse, Clock::Duration patience = kReplyDeadline) {
    return ask(command_line(text, settings_.address), text, parse, patience);
  }

  /// Asks for what the controller must know.
  template <class Parse>
  auto require(std::string_view text, Parse parse) {
    auto answer = ask_line(text, parse);
    if (answer.value) return *std::move(answer.value);
    if (answer.error != 0) throw refusal(answer.error, text);
    throw failure(Fault::kNoReply,
                  fmt::format("no answer to \"{}\" within {} s, asked twice, though \"{}\" is answered", text,
                              to_seconds(kReplyDeadline), kIdentityQuery));
  }

  /// Asks for what it need not know: nothing if it does not.
  template <class Parse>
  auto ask_optional(std::string_view text, Parse parse) {
    auto answer = ask_line(text, parse, kOptionalReplyDeadline);
    if (!answer.value && answer.error != 0 && answer.error != kErrorUnknownCommand &&
        answer.error != kErrorUnknownParameter) {
      throw refusal(answer.error, text);
    }
    return std::move(answer.value);
  }

  /// Reads and thereby clears the error code. Never asked twice: the code would be gone.
  int read_error(std::string_view after) {
    ensure_in_step("ERR?");
    return error_code(exchange(command_line("ERR?", settings_.address), kReplyDeadline), after);
  }

  int error_code(std::optional<std::string> reply, std::string_view after) {
    if (!reply) {
      in_step_ = false;
      reply = resynchronise(fmt::format("ERR? after {}", after));
      if (!reply) {
        throw failure(
            Fault::kNoReply,
            fmt::format(
                "no answer to \"ERR?\" after \"{}\" within {} s: whether that was accepted is not known",
                after, to_seconds(kReplyDeadline)));
      }
    }
    const auto lines = reply_lines(*reply, settings_.address);
    const auto code = lines ? parse_error_code(*lines) : std::nullopt;
    if (!code) {
      in_step_ = false;
      throw failure(Fault::kBadFrame,
                    fmt::format("\"{}\" is no answer to \"ERR?\" after \"{}\"", printable(*reply), after));
    }
    error_may_wait_ = false;
    return *code;
  }

  /// Sends a set command, once, and returns what the controller says to it.
  int execute(std::string_view command) {
    ensure_in_step(command);
    if (error_may_wait_)
      read_error("an earlier command");  // Else an old error would be laid at this one's door.
    error_may_wait_ = true;
    // In one piece with its ERR?, as PIPython can do it: one round trip.
    return error_code(
        exchange(command_line(command, settings_.address) + command_line("ERR?", settings_.address),
                 kReplyDeadline),
        command);
  }

  void execute_or_throw(std::string_view command) {
    if (const int code = execute(command); code != 0) throw refusal(code, command);
  }

  // ---- The controller

  void identify_controller() {
    known_ = false;
    identity_reply_.clear();
    in_step_ = true;
    std::string heard;
    for (int attempt = 1; attempt <= 2; ++attempt) {
      std::optional<std::string> reply =
          exchange(command_line(kIdentityQuery, settings_.address), kReplyDeadline);
      const Clock::Instant deadline = line_.deadline_after(kReplyDeadline);
      while (reply) {
        const auto lines = reply_lines(*reply, settings_.address);
        if (const auto identity = lines ? parse_identity(*lines) : std::nullopt) {
          identity_ = *identity;
          identity_reply_ = *reply;
          std::string who = "stage " + identity_.model;
          if (!identity_.serial_number.empty()) who += " (SN " + identity_.serial_number + ")";
          if (!settings_.address.empty()) who += " at address " + settings_.address;
          line_.rename(who);
          return;
        }
        heard += *reply;
        if (heard.size() > kLongestReply) break;
        reply = line_.take_frame(deadline);
      }
      heard += line_.received();
    }
    if (heard.empty()) {
      throw failure(
          Fault::kNoReply,
          fmt::format("no answer to \"{}\" within {} s, asked twice; is the controller on, the cable in the "
                      "right port, and its baud rate (or address) as in the bench file?",
                      kIdentityQuery, to_seconds(kReplyDeadline)));
    }
    throw failure(
        Fault::kWrongIdentity,
        fmt::format(
            "\"{}\" is no answer of a PI controller to \"{}\"; another instrument, or another baud rate?",
            printable(heard), kIdentityQuery));
  }

  /// Once, before anything else is asked: a PI controller, which has our axes, in degrees.
  void ensure_known() {
    if (known_) return;
    identify_controller();
    error_may_wait_ = true;
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
      const std::string unit = require(fmt::format("PUN? {}", name),
                                       [&name](const Lines& lines) { return axis_value(lines, name); });
      if (!is_degrees(unit)) {
        throw failure(
            Fault::kWrongIdentity,
            fmt::format("axis \"{}\" counts in \"{}\"; degrees are required (PUN, or the stage's parameters)",
                        name, printable(unit)));
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

  StageInfo identify() {
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

  void home(StageAxis axis) {
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

  void move_to(StageAxis axis, Angle target) {
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
          fmt::format("the servo of axis \"{}\" is off though it has its reference: {}", name, said));
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

  Angle encoder_angle(StageAxis axis) {
    const std::string& name = name_of(axis);
    ensure_known();
    return Angle::degrees(require(fmt::format("POS? {}", name), number_of(name)));
  }

  // ---- Halt

  /// Whether the controller says that all stands still.
  bool has_stopped() {
    if (identity_reply_.empty()) identify_controller();
    if (read_error("#24") == kErrorStoppedByCommand) return true;
    if (motion_query_ == MotionQuery::kMask) {
      const auto mask = ask(single_byte(kAskMotion, settings_.address), "#5", parse_motion_mask);
      return mask.value == std::uint64_t{0};
    }
    return std::none_of(kStageAxes.begin(), kStageAxes.end(), [this](StageAxis axis) {
      return !settings_.axis_names[index(axis)].empty() && moving(axis);
    });
  }

  bool halt() noexcept {
    return line_.halt(
        [this] {
          servo_on_ = {false, false};
          error_may_wait_ = true;
        },
        [this] { return has_stopped(); });
  }

  const StageSettings settings_;
  wire::HaltableLine line_;  ///< Its lock guards all below.
  Identity identity_;
  std::string identity_reply_;  ///< To the letter; empty before the controller is identified.
  bool known_ = false;
  bool in_step_ = true;         ///< False: a reply may still come to a query that is given up.
  bool error_may_wait_ = true;  ///< The controller may hold an error code that belongs to the past.
  Lines axes_;                  ///< SAI?
  std::array<std::size_t, 2> position_{};  ///< Of our axes in it.
  std::array<bool, 2> servo_on_{};
  std::array<bool, 2> speed_set_{};
  MotionQuery motion_query_ = MotionQuery::kMask;
};

PiGcsStage::PiGcsStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                       const StageSettings& settings) {
  check_settings(settings);
  impl_ = std::make_unique<Impl>(std::move(stream), clock, settings);
}

PiGcsStage::~PiGcsStage() = default;

StageInfo PiGcsStage::identify() {
  const std::lock_guard lock(impl_->line_);
  return impl_->identify();
}

void PiGcsStage::home(StageAxis axis) {
  const std::lock_guard lock(impl_->line_);
  impl_->home(axis);
}

void PiGcsStage::move_to(StageAxis axis, Angle target) {
  const std::lock_guard lock(impl_->line_);
  impl_->move_to(axis, target);
}

MotionState PiGcsStage::motion_state(StageAxis axis) {
  const std::lock_guard lock(impl_->line_);
  impl_->name_of(axis);
  impl_->ensure_known();
  return impl_->moving(axis) ? MotionState::kMoving : MotionState::kStopped;
}

Angle PiGcsStage::encoder_angle(StageAxis axis) {
  const std::lock_guard lock(impl_->line_);
  return impl_->encoder_angle(axis);
}

bool PiGcsStage::halt() noexcept {
  return impl_->halt();
}

}  // namespace abcal::pi_gcs
