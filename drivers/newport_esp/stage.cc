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
#include "drivers/wire/haltable_line.h"

namespace abcal::newport_esp {
namespace {

constexpr std::string_view kIdentityQuery = "VE?";
constexpr std::string_view kErrorQuery = "TB?";

/// The error buffer is a FIFO; ten entries are usual [M]. One that never empties is no error buffer.
constexpr int kMostErrors = 32;

/// Time that halt() leaves an exchange under way to end: its reply deadline, and some.
constexpr Clock::Duration kHaltWaitsForExchange = kReplyDeadline + std::chrono::milliseconds(500);
constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(50);

void check_settings(const StageSettings& settings) {
  const auto& names = settings.axis_names;
  if (names[0].empty() && names[1].empty()) {
    throw std::invalid_argument("Newport stage: no axis is named; required is the number of X, Z or both");
  }
  if (names[0] == names[1]) {
    throw std::invalid_argument(
        fmt::format("Newport stage: X and Z are both axis {}; two different axes are required", names[0]));
  }
  for (const std::string& name : names) {
    if (!name.empty() && (name.size() != 1 || name[0] < '1' || name[0] > '6')) {
      throw std::invalid_argument(fmt::format(
          "Newport stage: axis name \"{}\"; required is an axis number from 1 to 6", printable(name)));
    }
  }
  for (const auto& speed : settings.speed_deg_per_s) {
    if (speed && !(std::isfinite(*speed) && *speed > 0.0)) {
      throw std::invalid_argument(
          fmt::format("Newport stage: speed {} deg/s; required is a positive number", *speed));
    }
  }
  if (!settings.address.empty()) {
    throw std::invalid_argument(fmt::format(
        "Newport stage: address \"{}\"; an ESP controller on RS-232 has none", printable(settings.address)));
  }
}

}  // namespace

// How a late reply is kept from being taken for the answer to the next query: replies come in the order of
// the queries. So once a reply is missing or garbled, nothing else is asked before "VE?" (whose answer is
// known to the letter, and looks like no other) has been answered; whatever came before that answer belongs
// to the past.
struct NewportEspStage::Impl {
  Impl(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : settings_(settings),
        line_("Newport ESP stage", std::move(stream), clock, check_reply,
              {command_line("ST"), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}) {}

  /// What became of a query. No value and no error: it stayed silent.
  template <class T>
  struct Answer {
    std::optional<T> value;
    int error = 0;
  };

  // ---- Errors

  InstrumentError failure(Fault fault, std::string_view detail) const { return line_.failure(fault, detail); }

  InstrumentError refusal(int code, std::string_view command) const {
    const int axis_code = error_axis(code) == 0 ? -1 : code % 100;
    Fault fault = Fault::kRefused;
    if (axis_code == kAxisErrorPositiveSoftLimit || axis_code == kAxisErrorNegativeSoftLimit)
      fault = Fault::kOutOfTravel;
    if (axis_code == kAxisErrorMotorOff) fault = Fault::kNotReady;
    return failure(fault, fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command));
  }

  // ---- Bytes

  /// The next line that is neither empty nor unsolicited, as it came; nothing if there is no whole one by the
  /// deadline.
  std::optional<std::string> take_line(Clock::Instant deadline) {
    for (;;) {
      std::optional<std::string> line = line_.take_frame(deadline);
      const auto text = line ? line_text(*line) : std::nullopt;
      if (!text || !(text->empty() || is_unsolicited(*text))) return line;
    }
  }

  /// Throws away stale input, sends, and waits for one line.
  std::optional<std::string> exchange(std::string_view request) {
    line_.discard_input();
    line_.send(request);
    const Clock::Instant deadline = line_.deadline_after(kReplyDeadline);
    for (;;) {
      std::optional<std::string> line = take_line(deadline);
      // Of an earlier resynchronise() that gave up too soon.
      if (line && !identity_reply_.empty() && line_text(*line) == identity_reply_) continue;
      return line;
    }
  }

  // ---- Replies in step with queries

  /// Returns once the controller has answered "VE?". What it sent before that, if it is one whole line, is
  /// the late answer to the query that had none.
  std::optional<std::string> resynchronise(std::string_view unanswered) {
    line_.send(command_line(kIdentityQuery));
    const Clock::Instant deadline = line_.deadline_after(kReplyDeadline);
    std::vector<std::string> before;
    while (const std::optional<std::string> line = take_line(deadline)) {
      const std::string text = line_text(*line).value_or(*line);
      if (text.ends_with(identity_reply_)) {
        in_step_ = true;
        // Else half a reply came before it.
        if (text.size() == identity_reply_.size() && before.size() == 1) return before.front();
        return std::nullopt;
      }
      before.push_back(*line);
    }
    std::string heard;
    for (const std::string& line : before) heard += line;
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
  auto ask(const std::string& query, Parse parse) {
    using T = typename std::invoke_result_t<Parse, std::string_view>::value_type;
    for (int attempt = 1;; ++attempt) {
      ensure_in_step(query);
      std::optional<std::string> line = exchange(command_line(query));
      if (!line) {
        in_step_ = false;
        line = resynchronise(query);
      }
      if (line) {
        if (const auto text = line_text(*line)) {
          if (auto value = parse(*text)) return Answer<T>{std::move(value), 0};
        }
        in_step_ = false;
        if (attempt == 2)
          throw failure(Fault::kBadFrame,
                        fmt::format("\"{}\" is no answer to \"{}\"", printable(*line), query));
        continue;
      }
      // It is there, but said nothing to this query: then it has put the reason into its error buffer, unless
      // that was there before (an unacknowledged halt leaves one).
      const bool was_there = error_may_wait_;
      if (const int code = read_errors(query); code != 0 && !was_there) return Answer<T>{std::nullopt, code};
      if (attempt == 2) return Answer<T>{};
    }
  }

  /// Asks for what the controller must know.
  template <class Parse>
  auto require(const std::string& query, Parse parse) {
    auto answer = ask(query, parse);
    if (answer.value) return *std::move(answer.value);
    if (answer.error != 0) throw refusal(answer.error, query);
    throw failure(Fault::kNoReply,
                  fmt::format("no answer to \"{}\" within {} s, asked twice, though \"{}\" is answered",
                              query, to_seconds(kReplyDeadline), kIdentityQuery));
  }

  // ---- The error buffer

  /// Reads one entry. Never asked twice: the entry would be gone.
  int take_error(std::optional<std::string> line, std::string_view after) {
    if (!line) {
      in_step_ = false;
      line = resynchronise(fmt::format("{} after {}", kErrorQuery, after));
      if (!line) {
        throw failure(
            Fault::kNoReply,
            fmt::format(
                "no answer to \"{}\" after \"{}\" within {} s: whether that was accepted is not known",
                kErrorQuery, after, to_seconds(kReplyDeadline)));
      }
    }
    const auto text = line_text(*line);
    const auto report = text ? parse_error_report(*text) : std::nullopt;
    if (!report) {
      in_step_ = false;
      throw failure(Fault::kBadFrame, fmt::format("\"{}\" is no answer to \"{}\" after \"{}\"",
                                                  printable(*line), kErrorQuery, after));
    }
    // The time stamp counts from when the controller was switched on [M]; one that goes back says that it was
    // switched on again, or ran over. Either way nobody knows the reference any more.
    const bool restarted = report->time_stamp < last_time_stamp_;
    last_time_stamp_ = report->time_stamp;
    if (restarted) {
      forget();
      throw failure(Fault::kNotReady,
                    "the controller was switched off and on (its time stamp has gone back), so its axes have "
                    "lost their reference; home them");
    }
    return report->code;
  }

  /// Empties the buffer and returns the oldest entry: the first cause.
  int read_errors(std::string_view after) {
    int first = 0;
    for (int n = 0; n < kMostErrors; ++n) {
      ensure_in_step(kErrorQuery);
      const int code = take_error(exchange(command_line(kErrorQuery)), after);
      if (code == 0) {
        error_may_wait_ = false;
        return first;
      }
      if (first == 0) first = code;
    }
    throw failure(Fault::kBadFrame, fmt::format("{} errors one after the other, the first {} ({})",
                                                kMostErrors, first, error_text(first)));
  }

  /// Sends a set command, once, and returns what the controller says to it.
  int execute(std::string_view command) {
    ensure_in_step(command);
    // Else an old error would be laid at this one's door.
    if (error_may_wait_) read_errors("an earlier command");
    error_may_wait_ = true;
    const int code = take_error(exchange(command_line(command) + command_line(kErrorQuery)), command);
    if (code == 0) {
      error_may_wait_ = false;
    } else {
      read_errors(command);  // What else it left behind.
    }
    return code;
  }

  void execute_or_throw(std::string_view command) {
    if (const int code = execute(command); code != 0) throw refusal(code, command);
  }

  // ---- The controller

  /// What was known of a controller that is no longer the same, or not in the same state.
  void forget() {
    known_ = false;
    referenced_ = {};
    homing_ = {};
    motor_on_ = {};
    speed_set_ = {};
    error_may_wait_ = true;
  }

  void identify_controller() {
    const std::string known_reply = std::exchange(identity_reply_, {});
    known_ = false;
    in_step_ = true;
    std::string heard;
    for (int attempt = 1; attempt <= 2; ++attempt) {
      std::optional<std::string> line = exchange(command_line(kIdentityQuery));
      const Clock::Instant deadline = line_.deadline_after(kReplyDeadline);
      while (line) {
        const auto text = line_text(*line);
        if (const auto identity = text ? parse_identity(*text) : std::nullopt) {
          identity_ = *identity;
          identity_reply_ = *text;
          if (identity_reply_ != known_reply) {
            forget();
            last_time_stamp_ = 0;
          }
          line_.rename("stage " + identity_.model);
          return;
        }
        heard += *line;
        if (heard.size() > 4 * kLongestReply) break;
        line = take_line(deadline);
      }
      heard += line_.received();
    }
    if (heard.empty()) {
      throw failure(
          Fault::kNoReply,
          fmt::format(
              "no answer to \"{}\" within {} s, asked twice; is the controller on, its RS-232 (not its "
              "USB) connected, the baud rate 19200 and RTS/CTS wired?",
              kIdentityQuery, to_seconds(kReplyDeadline)));
    }
    throw failure(Fault::kWrongIdentity,
                  fmt::format("\"{}\" is no answer of an ESP controller to \"{}\"; another instrument, or "
                              "another baud rate?",
                              printable(heard), kIdentityQuery));
  }

  /// Once, before anything else is asked: an ESP controller, which has our axes, in degrees.
  void ensure_known() {
    if (known_) return;
    identify_controller();
    read_errors("an earlier program");
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
        throw failure(
            Fault::kWrongIdentity,
            fmt::format("axis {} counts in {} (SN? is {}); degrees are required ({}SN{}, then check "
                        "speed and limits, and save with SM)",
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

  StageInfo identify() {
    known_ = false;  // A controller that was swapped or switched off and on since is noticed.
    motor_on_ = {};
    speed_set_ = {};
    try {
      ensure_known();
    } catch (const InstrumentError& error) {
      // Switched off and on: now noticed, and forgotten; what it says is said of the new state.
      if (error.fault() != Fault::kNotReady || line_.halting()) throw;
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
    if (!require(name + "MO?", parse_flag)) execute_or_throw(name + "MO");
    motor_on_[index(axis)] = true;
  }

  void apply_speed(StageAxis axis) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)]) return;
    execute_or_throw(fmt::format("{}VA{:.6f}", name_of(axis), *speed));
    speed_set_[index(axis)] = true;
  }

  void home(StageAxis axis) {
    const std::string& name = name_of(axis);
    ensure_known();
    referenced_[index(axis)] = false;
    motor_on_[index(axis)] = false;  // Ask again: a fault switches it off.
    switch_on(axis);
    apply_speed(axis);
    execute_or_throw(name + "OR");
    homing_[index(axis)] = true;
  }

  void move_to(StageAxis axis, Angle target) {
    const std::string& name = name_of(axis);
    if (!std::isfinite(target.deg())) {
      throw failure(Fault::kOutOfTravel,
                    fmt::format("target {} of axis {} is not a number", target.deg(), name));
    }
    ensure_known();
    if (!referenced_[index(axis)]) {
      throw failure(Fault::kNotReady,
                    fmt::format("axis {} has not been homed by this program, and the controller cannot say "
                                "whether it ever was; home it",
                                name));
    }
    switch_on(axis);
    apply_speed(axis);
    const std::string command = move_command(name, target);
    if (const int code = execute(command); code != 0) {
      motor_on_[index(axis)] = false;  // Ask again before the next move.
      throw refusal(code, command);
    }
  }

  bool done(StageAxis axis) { return require(name_of(axis) + "MD?", parse_flag); }

  bool moving(StageAxis axis) {
    if (!done(axis)) return true;
    // An axis that a fault has stopped reads as done as well.
    const int code = read_errors("the motion");
    if (code != 0) {
      homing_[index(axis)] = false;
      motor_on_[index(axis)] = false;
      throw failure(Fault::kRefused,
                    fmt::format("error {} ({}) has ended the motion of axis {}, or of the other one", code,
                                error_text(code), name_of(axis)));
    }
    if (std::exchange(homing_[index(axis)], false)) referenced_[index(axis)] = true;
    return false;
  }

  Angle encoder_angle(StageAxis axis) {
    const std::string& name = name_of(axis);
    ensure_known();
    return Angle::degrees(require(name + "TP?", parse_number));
  }

  // ---- Halt

  bool has_stopped() {
    if (identity_reply_.empty()) identify_controller();
    return std::all_of(kStageAxes.begin(), kStageAxes.end(), [this](StageAxis axis) {
      return settings_.axis_names[index(axis)].empty() || done(axis);
    });
  }

  bool halt() noexcept {
    return line_.halt(
        [this] {
          homing_ = {};
          motor_on_ = {};
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
  bool error_may_wait_ = true;  ///< The controller may hold an error that belongs to the past.
  std::uint64_t last_time_stamp_ = 0;
  std::array<std::string, 2> stage_seen_;
  std::array<bool, 2> referenced_{};
  std::array<bool, 2> homing_{};
  std::array<bool, 2> motor_on_{};
  std::array<bool, 2> speed_set_{};
};

NewportEspStage::NewportEspStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                 const StageSettings& settings) {
  if (stream == nullptr) throw std::invalid_argument("Newport stage: no stream");
  check_settings(settings);
  impl_ = std::make_unique<Impl>(std::move(stream), clock, settings);
}

NewportEspStage::~NewportEspStage() = default;

StageInfo NewportEspStage::identify() {
  const std::lock_guard lock(impl_->line_);
  return impl_->identify();
}

void NewportEspStage::home(StageAxis axis) {
  const std::lock_guard lock(impl_->line_);
  impl_->home(axis);
}

void NewportEspStage::move_to(StageAxis axis, Angle target) {
  const std::lock_guard lock(impl_->line_);
  impl_->move_to(axis, target);
}

MotionState NewportEspStage::motion_state(StageAxis axis) {
  const std::lock_guard lock(impl_->line_);
  impl_->name_of(axis);
  impl_->ensure_known();
  return impl_->moving(axis) ? MotionState::kMoving : MotionState::kStopped;
}

Angle NewportEspStage::encoder_angle(StageAxis axis) {
  const std::lock_guard lock(impl_->line_);
  return impl_->encoder_angle(axis);
}

bool NewportEspStage::halt() noexcept {
  return impl_->halt();
}

}  // namespace abcal::newport_esp
