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
#include "drivers/text/text.h"
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

/// Where an axis is: "2 1" is axis 1 of the controller with address 2, "1" that of the address given for all.
struct AxisPlace {
  std::string address;
  std::string name;  ///< Empty: not on this line.
};

AxisPlace place_of(const std::string& axis_name, const std::string& address) {
  const std::vector<std::string_view> words = pieces::words(axis_name, " ");
  if (words.size() == 2) return {std::string(words[0]), std::string(words[1])};
  return {address, axis_name};
}

/// Highest address of a controller in a chain. Others belong to the computer, or reach all controllers at
/// once.
constexpr int kLastAddress = 16;

bool is_address(const std::string& text) {
  for (int address = 1; address <= kLastAddress; ++address)
    if (text == std::to_string(address)) return true;
  return text.empty();
}

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  wire::check_stage_settings("PI", "the controller's name", stream, settings);
  for (const std::string& name : settings.axis_names) {
    const AxisPlace place = place_of(name, settings.address);
    if (place.name.find_first_of(" \t\r\n=") != std::string::npos) {
      throw std::invalid_argument(
          fmt::format("PI stage: axis name \"{}\" contains a blank or '='; required: a name without them, or "
                      "\"<address> <name>\" in a daisy chain",
                      printable(name)));
    }
    if (!is_address(place.address)) {
      throw std::invalid_argument(
          fmt::format("PI stage: address \"{}\"; required: the controller's number in the daisy chain, 1 to "
                      "{}, or nothing",
                      printable(place.address), kLastAddress));
    }
  }
  const AxisPlace x = place_of(settings.axis_names[0], settings.address);
  const AxisPlace z = place_of(settings.axis_names[1], settings.address);
  if (x.address == z.address && x.name == z.name) {
    throw std::invalid_argument(
        fmt::format("PI stage: X and Z are both axis \"{}\" of the controller with address {}; required: two "
                    "different axes",
                    x.name, x.address));
  }
  if (!x.name.empty() && !z.name.empty() && x.address != z.address &&
      (x.address.empty() || z.address.empty())) {
    throw std::invalid_argument(
        "PI stage: one axis has an address, the other has none; required: both, in a daisy chain");
  }
}

/// The addresses of the controllers on the line, X's first; empty text: no chain.
std::vector<std::string> addresses_of(const StageSettings& settings) {
  std::vector<std::string> found;
  for (const std::string& axis_name : settings.axis_names) {
    const AxisPlace place = place_of(axis_name, settings.address);
    if (!place.name.empty() && std::find(found.begin(), found.end(), place.address) == found.end())
      found.push_back(place.address);
  }
  return found;
}

std::string stop_command(const StageSettings& settings) {
  std::string stop(1, kStopAllAxes);
  // Alone it reaches the first controller of a chain, not surely the others.
  for (const std::string& address : addresses_of(settings))
    if (!address.empty()) stop += command_line("STP", address);
  return stop;
}

/// The reply to SAI?.
std::optional<Lines> parse_axis_names(const Lines& lines) {
  const bool plausible =
      !lines.empty() && std::all_of(lines.begin(), lines.end(), [](const std::string& line) {
        return !line.empty() && line.size() <= 16 && line.find_first_of("= ,") == std::string::npos;
      });
  return plausible ? std::optional(lines) : std::nullopt;
}

/// Value that `parse` reads from the reply to a question at an address, asked once; absent if none arrives in
/// time.
template <class Parse>
auto asked_once(wire::ByteStream& stream, Clock& clock, const std::string& address, std::string_view text,
                Parse parse) {
  using Value = std::invoke_result_t<Parse, const Lines&>;
  stream.discard_input();
  stream.write(command_line(text, address));
  const Clock::Instant deadline = clock.now() + (address.empty() ? kOptionalReplyDeadline : kAddressDeadline);
  std::string received;
  for (;;) {
    const wire::FrameVerdict reply = check_reply(received);
    if (reply.check == wire::FrameCheck::kInvalid) return Value();
    if (reply.check == wire::FrameCheck::kComplete) {
      const auto lines = reply_lines(std::string_view(received).substr(0, reply.length), address);
      if (auto value = lines ? parse(*lines) : Value()) return value;
      received.erase(0, reply.length);
      continue;
    }
    if (clock.now() >= deadline) return Value();
    received += stream.read_until(deadline).bytes;
  }
}

/// Two texts of the controllers as one.
std::string joined(const std::string& first, const std::string& second) {
  return first.empty() || first == second ? second : first + "/" + second;
}

class PiGcsController final : public wire::LineController {
 public:
  PiGcsController(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : LineController("PI stage", std::move(stream), clock, check_reply,
                       {stop_command(settings), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}),
        settings_(settings) {
    const std::vector<std::string> addresses = addresses_of(settings);
    for (const std::string& address : addresses) add_member(address, addresses.size() > 1);
    for (const StageAxis axis : kStageAxes) {
      places_[index(axis)] = place_of(settings.axis_names[index(axis)], settings.address);
      for (std::size_t n = 0; n < addresses.size(); ++n)
        if (addresses[n] == places_[index(axis)].address) member_of_[index(axis)] = n;
    }
  }

  enum class MotionQuery { kMask, kStatus, kOnTarget };

  /// One controller of the line: in most cases the only one.
  struct Member {
    std::string address;
    std::string identity_name;  ///< The query of its identity, for messages.
    std::unique_ptr<wire::LineExchange> replies;
    Identity identity;
    bool known = false;
    Lines axes;      ///< SAI?
    Lines commands;  ///< HLP?; empty: it does not list its commands.
    MotionQuery motion_query = MotionQuery::kMask;

    bool may_know(std::string_view command) const {
      return commands.empty() || std::find(commands.begin(), commands.end(), command) != commands.end();
    }
  };

  void add_member(const std::string& address, bool in_chain) {
    auto member = std::make_unique<Member>();
    Member& m = *member;
    m.address = address;
    m.identity_name = in_chain ? address + " *IDN?" : std::string(kIdentityQuery);
    m.replies = std::make_unique<wire::LineExchange>(
        line(),
        wire::LineExchange::Manner{.identity_request = command_line(kIdentityQuery, address),
                                   .identity_name = m.identity_name,
                                   .error_request = command_line("ERR?", address),
                                   .error_name = "ERR?",
                                   .patience = kReplyDeadline,
                                   .normal = [](std::string_view reply) { return std::string(reply); },
                                   .show = printable},
        wire::LineExchange::Errors{[this, &m](std::string_view after) { return read_error(m, after); },
                                   [&m](const std::string& reply) {
                                     const auto lines = reply_lines(reply, m.address);
                                     return lines ? parse_error_code(*lines) : std::nullopt;
                                   }});
    members_.push_back(std::move(member));
  }

  Member& member_of(StageAxis axis) { return *members_[member_of_[index(axis)]]; }

  // ---- Errors

  InstrumentError refusal(int code, std::string_view command) const {
    const Fault fault = code == kErrorPositionOutOfLimits ? Fault::kOutOfTravel : Fault::kRefused;
    return failure(fault, fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command));
  }

  // ---- Replies

  /// A parser of the lines of a reply, for the reply itself.
  template <class Parse>
  auto of_lines(const Member& m, Parse parse) {
    using Value = std::invoke_result_t<Parse, const Lines&>;
    return [&m, parse](const std::string& reply) {
      const auto lines = reply_lines(reply, m.address);
      return lines ? parse(*lines) : Value();
    };
  }

  template <class Parse>
  auto ask(Member& m, const std::string& request, std::string_view shown, Parse parse) {
    return m.replies->ask(request, shown, of_lines(m, parse), kReplyDeadline);
  }

  /// Asks a question that the controller must know.
  template <class Parse>
  auto require(Member& m, std::string_view text, Parse parse) {
    return m.replies->require(command_line(text, m.address), text, of_lines(m, parse),
                              [this](int code, std::string_view query) { return refusal(code, query); });
  }

  /// Asks a question that the controller need not know; absent if it does not.
  template <class Parse>
  auto ask_optional(Member& m, std::string_view text, Parse parse,
                    Clock::Duration patience = kOptionalReplyDeadline) {
    using Value = std::invoke_result_t<Parse, const Lines&>;
    if (!m.may_know(text.substr(0, text.find(' ')))) return Value();
    auto answer = m.replies->ask(command_line(text, m.address), text, of_lines(m, parse), patience);
    if (!answer.value && answer.error != 0 && answer.error != kErrorUnknownCommand &&
        answer.error != kErrorUnknownParameter) {
      throw refusal(answer.error, text);
    }
    return std::move(answer.value);
  }

  // ---- The error code

  /// Reads and thereby clears the error code. The code for "stopped by a halt" is ignored, because it answers
  /// no question that is asked here.
  static int read_error(Member& m, std::string_view after) {
    const int code = m.replies->ask_error(after);
    m.replies->error_may_wait(false);
    return code == kErrorStoppedByCommand ? 0 : code;
  }

  /// Sends a set command once, and returns the controller's error code.
  int execute(Member& m, std::string_view command) {
    const std::uint64_t halts = line().halts();
    int code = m.replies->execute(command_line(command, m.address), command);
    m.replies->error_may_wait(false);
    // Only a stop causes error 10. If the stop arrived before the command on a slow line, the code does not
    // concern the command, which would have replaced it by its own code.
    if (code == kErrorStoppedByCommand && line().halts() == halts && !line().halting())
      code = read_error(m, command);
    return code;
  }

  void execute_or_throw(Member& m, std::string_view command) {
    if (const int code = execute(m, command); code != 0) throw refusal(code, command);
  }

  // ---- The controller

  void identify_controller(Member& m) {
    m.known = false;
    const Identity before = std::exchange(m.identity, {});
    const auto accept = [&m](const std::string& reply) {
      const auto lines = reply_lines(reply, m.address);
      const auto identity = lines ? parse_identity(*lines) : std::nullopt;
      if (identity) m.identity = *identity;
      return identity.has_value();
    };
    m.replies->identify(accept,
                        "is the controller on, is the cable in the right connector, and are baud rate and "
                        "address as in the bench file?",
                        "a PI controller", kLongestReply);
    if (m.identity.model != before.model || m.identity.firmware != before.firmware) m.commands.clear();
    const Identity all = identity_of_all();
    std::string who = "stage " + all.model;
    if (!all.serial_number.empty()) who += " (SN " + all.serial_number + ")";
    if (!m.address.empty()) who += members_.size() == 1 ? " at address " + m.address : " in a daisy chain";
    line().rename(who);
  }

  Identity identity_of_all() const {
    Identity all;
    for (const auto& m : members_) {
      all.maker = joined(all.maker, m->identity.maker);
      all.model = joined(all.model, m->identity.model);
      all.firmware = joined(all.firmware, m->identity.firmware);
      if (!all.serial_number.empty()) all.serial_number += "/";
      all.serial_number += m->identity.serial_number;
    }
    return all;
  }

  /// Reads the list of commands that the controller knows; without such a list each command is tried when
  /// needed.
  void read_commands(Member& m) {
    if (!m.commands.empty()) return;
    m.commands = ask_optional(m, "HLP?", parse_help, kHelpDeadline).value_or(Lines{});
    m.motion_query = m.may_know("#5")   ? MotionQuery::kMask
                     : m.may_know("#4") ? MotionQuery::kStatus
                                        : MotionQuery::kOnTarget;
  }

  void ensure_known(StageAxis axis) { ensure_known(member_of(axis)); }

  /// Once, before anything else is asked: a PI controller, which has our axes, in degrees.
  void ensure_known(Member& m) {
    if (m.known) return;
    identify_controller(m);
    m.replies->error_may_wait(true);
    read_error(m, "an earlier program");
    read_commands(m);
    m.axes = require(m, "SAI?", parse_axis_names);
    for (const StageAxis axis : kStageAxes) {
      const std::string& name = places_[index(axis)].name;
      if (name.empty() || &member_of(axis) != &m) continue;
      const auto found = std::find(m.axes.begin(), m.axes.end(), name);
      if (found == m.axes.end()) {
        throw failure(Fault::kWrongIdentity, fmt::format("has no axis \"{}\" (for {}); its axes are {}", name,
                                                         to_string(axis), fmt::join(m.axes, ", ")));
      }
      position_[index(axis)] = static_cast<std::size_t>(found - m.axes.begin());
      require_degrees(m, name);
    }
    m.known = true;
  }

  /// Checks the unit by PUN?, else by the axis' parameter, else by the bench file.
  void require_degrees(Member& m, const std::string& name) {
    auto unit = ask_optional(m, fmt::format("PUN? {}", name),
                             [&name](const Lines& lines) { return axis_value(lines, name); });
    if (!unit) {
      unit = ask_optional(m, fmt::format("SPA? {} 0x{:X}", name, kUserUnit),
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
    const std::string& name = places_[index(axis)].name;
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
    Member& m = member_of(axis);
    StageAxisInfo info;
    info.stage_name = ask_optional(m, fmt::format("CST? {}", name), [&name](const Lines& lines) {
                        return axis_value(lines, name);
                      }).value_or("");
    info.travel_min = Angle::degrees(require(m, fmt::format("TMN? {}", name), number_of(name)));
    info.travel_max = Angle::degrees(require(m, fmt::format("TMX? {}", name), number_of(name)));
    info.referenced = require(m, fmt::format("FRF? {}", name), flag_of(name));
    // The speed that moves will have: the bench file's is set before the first one.
    const auto speed = ask_optional(m, fmt::format("VEL? {}", name), number_of(name));
    info.speed_deg_per_s = settings_.speed_deg_per_s[index(axis)].value_or(speed.value_or(0.0));
    const auto counts = [this, &name, &m](unsigned parameter) {
      return ask_optional(m, fmt::format("SPA? {} {}", name, parameter),
                          [parameter](const Lines& lines) { return parameter_number(lines, parameter); });
    };
    if (const auto numerator = counts(kCountsNumerator); numerator && *numerator != 0.0) {
      const auto denominator = counts(kCountsDenominator);
      if (denominator) info.resolution = Angle::degrees(std::abs(*denominator / *numerator));
    }
    return info;
  }

  StageInfo identify() override {
    servo_on_ = {false, false};
    speed_set_ = {false, false};
    for (const auto& m : members_) {
      m->known = false;  // A controller that was swapped or switched off and on since is noticed.
      ensure_known(*m);
    }
    const Identity all = identity_of_all();
    StageInfo info;
    info.maker = all.maker;
    info.model = all.model;
    info.serial_number = all.serial_number;
    info.firmware = all.firmware;
    for (const StageAxis axis : kStageAxes) {
      if (!places_[index(axis)].name.empty()) info.axes[index(axis)] = axis_info(axis);
    }
    return info;
  }

  void apply_speed(StageAxis axis) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)]) return;
    execute_or_throw(member_of(axis), fmt::format("VEL {} {:.6f}", name_of(axis), *speed));
    speed_set_[index(axis)] = true;
  }

  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    ensure_known(axis);
    replace_speed(settings_.speed_deg_per_s[index(axis)], usual_speed_[index(axis)], deg_per_s,
                  [&] { return axis_info(axis).speed_deg_per_s; });
    speed_set_[index(axis)] = false;
    apply_speed(axis);
  }

  void home(StageAxis axis) override {
    const std::string& name = name_of(axis);
    ensure_known(axis);
    Member& m = member_of(axis);
    if (m.may_know("EAX")) {
      const std::string enable = fmt::format("EAX {} 1", name);
      if (const int code = execute(m, enable); code != 0 && code != kErrorUnknownCommand)
        throw refusal(code, enable);
    }
    execute_or_throw(m, fmt::format("SVO {} 1", name));
    servo_on_[index(axis)] = true;
    apply_speed(axis);
    // A controller that does not know TRS? is taken to have the switch: FRF itself reports if it has none.
    if (ask_optional(m, fmt::format("TRS? {}", name), flag_of(name)).value_or(true)) {
      execute_or_throw(m, fmt::format("FRF {}", name));
    } else if (ask_optional(m, fmt::format("LIM? {}", name), flag_of(name)).value_or(false)) {
      execute_or_throw(m, fmt::format("FNL {}", name));
    } else {
      throw failure(Fault::kNotReady,
                    fmt::format("axis \"{}\" has neither a reference switch nor limit switches (TRS?, LIM?), "
                                "so it cannot be homed; set its position with the maker's program",
                                name));
    }
  }

  void move_to(StageAxis axis, Angle target) override {
    const std::string& name = name_of(axis);
    if (!std::isfinite(target.deg())) {
      throw failure(Fault::kOutOfTravel,
                    fmt::format("target {} of axis \"{}\" is not a number", target.deg(), name));
    }
    ensure_known(axis);
    Member& m = member_of(axis);
    if (!servo_on_[index(axis)]) {
      if (!require(m, fmt::format("SVO? {}", name), flag_of(name)))
        execute_or_throw(m, fmt::format("SVO {} 1", name));
      servo_on_[index(axis)] = true;
    }
    apply_speed(axis);
    const std::string command = move_command(name, target);
    const int code = execute(m, command);
    if (code == 0) return;
    servo_on_[index(axis)] = false;  // Ask again before the next move.
    if (code == kErrorUnreferencedOrServoOff || code == kErrorNoReference)
      throw not_ready(m, name, code, command);
    throw refusal(code, command);
  }

  /// Error 5 has two causes; the controller knows which.
  InstrumentError not_ready(Member& m, const std::string& name, int code, const std::string& command) {
    const std::string said = fmt::format("error {} ({}) to \"{}\"", code, error_text(code), command);
    if (code == kErrorUnreferencedOrServoOff && require(m, fmt::format("FRF? {}", name), flag_of(name))) {
      return failure(
          Fault::kNotReady,
          fmt::format("the servo of axis \"{}\" is off although the axis has its reference: {}", name, said));
    }
    return failure(Fault::kNotReady,
                   fmt::format("axis \"{}\" has lost its reference; home it: {}", name, said));
  }

  /// Tries #5, #4 and ONT? in this order unless the controller has listed its commands.
  bool moving(StageAxis axis) {
    Member& m = member_of(axis);
    const std::size_t position = position_[index(axis)];
    if (m.motion_query == MotionQuery::kMask) {
      const auto mask = ask(m, single_byte(kAskMotion, m.address), "#5", parse_motion_mask);
      if (mask.value) return ((*mask.value >> position) & 1U) != 0;
      m.motion_query = MotionQuery::kStatus;
    }
    if (m.motion_query == MotionQuery::kStatus) {
      const auto status = ask(m, single_byte(kAskStatus, m.address), "#4", [position](const Lines& lines) {
        auto words = parse_status(lines);
        if (words && words->size() <= position) words.reset();
        return words;
      });
      if (status.value) {
        const AxisStatus& word = (*status.value)[position];
        return word.moving || word.homing;
      }
      m.motion_query = MotionQuery::kOnTarget;
    }
    const std::string& name = name_of(axis);
    return !require(m, fmt::format("ONT? {}", name), flag_of(name));
  }

  MotionState motion_state(StageAxis axis) override {
    name_of(axis);
    ensure_known(axis);
    return moving(axis) ? MotionState::kMoving : MotionState::kStopped;
  }

  Angle encoder_angle(StageAxis axis) override {
    const std::string& name = name_of(axis);
    ensure_known(axis);
    return Angle::degrees(require(member_of(axis), fmt::format("POS? {}", name), number_of(name)));
  }

  // ---- Halt

  void forget_motion() override {
    servo_on_ = {false, false};
    for (const auto& m : members_) m->replies->error_may_wait(true);
  }

  Clock::Duration reply_deadline() const override { return kReplyDeadline; }

  HaltReport stopped_axes(const HaltReport& so_far) override {
    HaltReport report = so_far;
    std::vector<Member*> asked;
    for (const StageAxis axis : kStageAxes)
      if (!is_here(axis)) report.axes[index(axis)] = AxisHalt::kHalted;
    for (const auto& m : members_)
      if (!all_halted(*m, report)) asked.push_back(m.get());
    // One that is silent must not use up the time of the other.
    std::stable_partition(asked.begin(), asked.end(), [](const Member* m) { return m->replies->in_step(); });
    for (Member* m : asked) {
      if (!says_so([&] { return has_stopped(*m); })) continue;
      for (const StageAxis axis : axes_of(*m)) report.axes[index(axis)] = AxisHalt::kHalted;
    }
    return report;
  }

  bool is_here(StageAxis axis) const { return !places_[index(axis)].name.empty(); }

  /// Axes of the stage that are on this controller.
  std::vector<StageAxis> axes_of(const Member& m) const {
    std::vector<StageAxis> axes;
    for (const StageAxis axis : kStageAxes)
      if (is_here(axis) && members_[member_of_[index(axis)]].get() == &m) axes.push_back(axis);
    return axes;
  }

  bool all_halted(const Member& m, const HaltReport& report) const {
    const std::vector<StageAxis> axes = axes_of(m);
    return std::all_of(axes.begin(), axes.end(),
                       [&](StageAxis axis) { return report.axes[index(axis)] == AxisHalt::kHalted; });
  }

  bool has_stopped(Member& m) {
    if (m.replies->identity().empty()) identify_controller(m);
    const int code = m.replies->ask_error("#24");
    m.replies->error_may_wait(false);
    if (code == kErrorStoppedByCommand) return true;
    if (m.motion_query == MotionQuery::kMask) {
      const auto mask = ask(m, single_byte(kAskMotion, m.address), "#5", parse_motion_mask);
      return mask.value == std::uint64_t{0};
    }
    const std::vector<StageAxis> axes = axes_of(m);
    return std::none_of(axes.begin(), axes.end(), [&](StageAxis axis) { return moving(axis); });
  }

  /// A half-written command becomes one with an extra word, which the controller refuses. The identity is
  /// asked in between, so that an older reply is not taken for the mask. Each recipe stops all controllers.
  std::vector<HaltRecipe> halt_recipes() const override {
    std::vector<HaltRecipe> recipes;
    for (const auto& m : members_) {
      HaltRecipe recipe{.driver = "pi_gcs",
                        .axes = {},
                        .end_partial = " x\n",
                        .stop = stop_command(settings_),
                        .questions = {},
                        .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kReplyDeadline)};
      for (const StageAxis axis : axes_of(*m)) recipe.axes[index(axis)] = true;
      const std::string chained = m->address.empty() ? "" : "0 " + m->address + " ";
      const std::string identified = members_.size() == 1 ? "" : chained;
      recipe.questions.push_back({.bytes = command_line(kIdentityQuery, m->address),
                                  .reply = {pattern::literal(identified), pattern::text(),
                                            pattern::literal("Physik Instrumente"), pattern::text()},
                                  .standing = {}});
      recipe.questions.push_back(
          {.bytes = single_byte(kAskMotion, m->address),
           .reply = {pattern::literal(chained), pattern::run(pattern::kHexadecimalDigits)},
           .standing = {pattern::literal(chained), pattern::run("0")}});
      recipes.push_back(std::move(recipe));
    }
    return recipes;
  }

 private:
  StageSettings settings_;
  std::array<std::optional<double>, 2> usual_speed_{};  ///< Before set_speed().
  std::vector<std::unique_ptr<Member>> members_;
  std::array<AxisPlace, 2> places_;
  std::array<std::size_t, 2> member_of_{};
  std::array<std::size_t, 2> position_{};  ///< Positions of our axes among those of their controller.
  std::array<bool, 2> servo_on_{};
  std::array<bool, 2> speed_set_{};
};

}  // namespace

PiGcsStage::PiGcsStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
    : LineStage((check_settings(stream.get(), settings),
                 std::make_unique<PiGcsController>(std::move(stream), clock, settings))) {}

std::vector<std::string> axes_on_line(std::unique_ptr<wire::ByteStream> stream, Clock& clock) {
  std::vector<std::pair<std::string, Lines>> chain;  // Addresses and their axes.
  for (int n = 1; n <= kLastAddress; ++n) {
    const std::string address = std::to_string(n);
    if (!asked_once(*stream, clock, address, kIdentityQuery, parse_identity)) continue;
    if (auto axes = asked_once(*stream, clock, address, "SAI?", parse_axis_names))
      chain.emplace_back(address, *std::move(axes));
  }
  // A single controller also answers without its address.
  if (chain.size() < 2) return asked_once(*stream, clock, "", "SAI?", parse_axis_names).value_or(Lines{});
  std::vector<std::string> names;
  for (const auto& [address, axes] : chain)
    for (const std::string& axis : axes) names.push_back(address + " " + axis);
  return names;
}

}  // namespace abcal::pi_gcs
