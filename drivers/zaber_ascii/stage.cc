#include "drivers/zaber_ascii/stage.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"
#include "drivers/wire/line_exchange.h"
#include "drivers/zaber_ascii/codec.h"

namespace abcal::zaber_ascii {
namespace {

/// Several devices answer a broadcast: no further answer is expected this long after the last one.
constexpr Clock::Duration kQuiet = std::chrono::milliseconds(200);

/// Time that halt() leaves an exchange under way to end: a query, asked twice, and some.
constexpr Clock::Duration kHaltWaitsForExchange = 2 * kReplyDeadline + std::chrono::milliseconds(500);
constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(20);

constexpr int kMessageIds = 100;

/// Speeds are in microsteps per second times this (docs/protocols/zaber_ascii.md).
constexpr double kSpeedFactor = 1.6384;

/// Where an axis is on the line.
struct Place {
  int device = 0;
  int axis = 0;
};

/// An axis in the form of a bench file: "device axis", or a number whose meaning depends on the devices on
/// the line.
struct AxisName {
  std::optional<int> device;
  int number = 0;
};

std::optional<int> number_between(std::string_view text, int least, int most) {
  const auto value = pieces::number<int>(text);
  return value && *value >= least && *value <= most ? value : std::nullopt;
}

std::optional<AxisName> parse_axis_name(std::string_view name) {
  const std::size_t space = name.find(' ');
  if (space == std::string_view::npos) {
    const auto number = number_between(name, 1, 99);
    if (!number) return std::nullopt;
    return AxisName{std::nullopt, *number};
  }
  const auto device = number_between(name.substr(0, space), 1, 99);
  const auto axis = number_between(name.substr(space + 1), 1, 9);
  if (!device || !axis) return std::nullopt;
  return AxisName{device, *axis};
}

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  wire::check_stage_settings("Zaber", "the name", stream, settings);
  const auto& names = settings.axis_names;
  for (const std::string& name : names) {
    if (!name.empty() && !parse_axis_name(name)) {
      throw std::invalid_argument(
          fmt::format("Zaber stage: axis name \"{}\"; required: \"DEVICE AXIS\" (\"1 2\"), or one number",
                      printable(name)));
    }
  }
  if (settings.address.empty()) return;
  const auto device = number_between(settings.address, 1, 99);
  if (!device) {
    throw std::invalid_argument(
        fmt::format("Zaber stage: address \"{}\"; required: a device number from 1 to 99, or nothing",
                    printable(settings.address)));
  }
  for (const std::string& name : names) {
    if (name.empty()) continue;
    const AxisName axis = *parse_axis_name(name);
    if (axis.device && *axis.device != *device) {
      throw std::invalid_argument(fmt::format(
          "Zaber stage: axis \"{}\" is on device {}, but the address is {}", name, *axis.device, *device));
    }
  }
}

/// Numbers, each separated by one blank.
std::optional<double> first_number(std::string_view data) {
  return parse_number(data.substr(0, data.find(' ')));
}

std::optional<std::string> any_text(std::string_view data) {
  return std::string(data);
}

// A reply is recognised by its device, its axis and its message id, which runs through 0 to 99: a late reply
// has an id that is no longer awaited, and is skipped.
class ZaberAsciiController final : public wire::LineController {
 public:
  ZaberAsciiController(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : LineController("Zaber stage", std::move(stream), clock, check_line,
                       {command_line("0 0 stop"), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}),
        settings_(settings) {}

  // ---- Errors

  InstrumentError rejection(const Message& reply, std::string_view command) const {
    const std::string reason = reply.data.substr(0, reply.data.find(' '));
    return failure(Fault::kRefused, fmt::format("rejected, {} ({}), \"{}\" to device {} axis {}", reason,
                                                rejection_text(reason), command, reply.device, reply.axis));
  }

  InstrumentError flagged(Fault fault, std::string_view flag, Place place, std::string_view hint) const {
    return failure(
        fault, fmt::format("axis {} of device {} has the warning flag {} ({}){}{}", place.axis, place.device,
                           flag, warning_text(flag), hint.empty() ? "" : "; ", hint));
  }

  // ---- Messages

  /// Bytes other than the awaited reply that arrived while waiting for it.
  struct Heard {
    std::string bytes;
    bool messages = false;  ///< Some of the bytes formed a message.

    void add(std::string_view more) {
      if (bytes.size() < 2 * kLongestLine) bytes += more;
    }
  };

  int next_id() { return id_ = (id_ + 1) % kMessageIds; }

  /// The reply to message `id` from this place; nothing at the deadline. Alerts, info and replies to other
  /// messages are skipped.
  std::optional<Message> take_reply(Place place, int id, Clock::Instant deadline, Heard& heard) {
    while (const auto come = line().take_frame(deadline)) {
      auto message = find_message(*come, checksums_);
      if (message && message->kind == MessageKind::kReply && message->id == id &&
          message->device == place.device && message->axis == place.axis && !message->continues) {
        return message;
      }
      if (message) heard.messages = true;
      heard.add(*come);
    }
    return std::nullopt;
  }

  std::string what_was_heard(const Heard& heard) const {
    const std::string all = heard.bytes + line().received();
    return all.empty() ? "nothing arrived" : fmt::format("what arrived was \"{}\"", printable(all));
  }

  /// Sends a command once, or a query at most twice, and returns its reply, accepted or rejected.
  Message exchange(Place place, std::string_view data, bool is_query) {
    Heard heard;
    for (int attempt = 1; attempt <= (is_query ? 2 : 1); ++attempt) {
      const int id = next_id();
      line().send(command(place.device, place.axis, id, data));
      if (auto reply = take_reply(place, id, line().deadline_after(kReplyDeadline), heard))
        return *std::move(reply);
    }
    const Fault fault = heard.bytes.empty() && line().received().empty() ? Fault::kNoReply
                        : heard.messages                                 ? Fault::kNoReply
                                                                         : Fault::kBadFrame;
    throw failure(fault, fmt::format("no answer to \"{}\" of device {} axis {} within {} s{}; {}",
                                     data.empty() ? "status" : data, place.device, place.axis,
                                     to_seconds(kReplyDeadline),
                                     is_query ? ", asked twice" : "; whether it was accepted is unknown",
                                     what_was_heard(heard)));
  }

  /// Asks a question that the device must know.
  template <class Parse>
  auto require(Place place, std::string_view query, Parse parse) {
    const Message reply = exchange(place, query, true);
    if (!reply.accepted) throw rejection(reply, query);
    auto value = parse(reply.data);
    if (!value) {
      throw failure(Fault::kBadFrame,
                    fmt::format("\"{}\" is not an answer to \"{}\"", printable(reply.data), query));
    }
    return *std::move(value);
  }

  /// Asks a question that the device need not know; absent if it rejects the query.
  template <class Parse>
  auto ask_optional(Place place, std::string_view query, Parse parse) {
    using T = typename std::invoke_result_t<Parse, std::string_view>::value_type;
    const Message reply = exchange(place, query, true);
    return reply.accepted ? parse(reply.data) : std::optional<T>();
  }

  Message execute(Place place, std::string_view text) {
    Message reply = exchange(place, text, false);
    if (!reply.accepted) throw rejection(reply, text);
    return reply;
  }

  // ---- Who is there

  struct Device {
    int axes = 0;
  };

  /// The axis counts in the replies to one question to all devices (or to the one of the bench file).
  std::map<int, Device> ask_who_is_there(int device, Heard& heard) {
    std::map<int, Device> found;
    const int id = next_id();
    line().discard_input();
    line().send(command(device, 0, id, "get system.axiscount"));
    const Clock::Instant last = line().deadline_after(kReplyDeadline);
    Clock::Instant deadline = last;
    while (const auto come = line().take_frame(deadline)) {
      const auto message = find_message(*come, checksums_);
      if (!message || message->kind != MessageKind::kReply || message->id != id) {
        if (message) heard.messages = true;
        heard.add(*come);
        continue;
      }
      some_checksums_ = some_checksums_ || message->has_checksum;
      // A device too old for the question has one axis [unverified against a device].
      const double count = message->accepted ? parse_number(message->data).value_or(0.0) : 1.0;
      if (!(count >= 1.0 && count <= 9.0)) {
        heard.add(*come);
        continue;
      }
      found[message->device].axes = static_cast<int>(count);
      deadline = std::min(last, line().deadline_after(kQuiet));
    }
    return found;
  }

  /// Whether replies to commands with a checksum have one [unverified against a device] is seen here; from
  /// then on one without is damaged. Asked twice: a damaged line must neither hide a device nor its checksum.
  std::map<int, Device> who_is_there(int device) {
    checksums_ = some_checksums_ = false;
    Heard heard;
    std::map<int, Device> found = ask_who_is_there(device, heard);
    checksums_ = some_checksums_;
    for (const auto& [number, more] : ask_who_is_there(device, heard)) found[number] = more;
    checksums_ = some_checksums_;
    if (!found.empty()) return found;
    if (heard.bytes.empty() && line().received().empty()) {
      throw failure(
          Fault::kNoReply,
          fmt::format(
              "no answer to \"get system.axiscount\" within {} s, asked twice; is the device on and set to "
              "ASCII, and are its number and baud rate as in the bench file (115200; old A series 9600)?",
              to_seconds(kReplyDeadline)));
    }
    throw failure(heard.messages ? Fault::kNoReply : Fault::kWrongIdentity,
                  fmt::format("no Zaber device answers \"get system.axiscount\"; {}: another instrument, or "
                              "another baud rate?",
                              what_was_heard(heard)));
  }

  static std::vector<Place> places_of(const std::map<int, Device>& devices) {
    std::vector<Place> places;
    for (const auto& [number, device] : devices)
      for (int axis = 1; axis <= device.axes; ++axis) places.push_back({number, axis});
    return places;
  }

  static std::string list(const std::map<int, Device>& devices) {
    std::vector<std::string> names;
    for (const Place& place : places_of(devices))
      names.push_back(fmt::format("\"{} {}\"", place.device, place.axis));
    return fmt::format("{}", fmt::join(names, ", "));
  }

  /// Microsteps of a turn; absent: it does not rotate.
  std::optional<double> steps_per_turn(Place place) {
    const auto steps = ask_optional(place, "get limit.cycle.dist", first_number);
    return steps && *steps > 0.0 ? steps : std::nullopt;
  }

  /// All rotating axes on the line, in the form of a bench file.
  std::vector<std::string> rotating_axes() {
    std::vector<std::string> names;
    for (const Place& place : places_of(who_is_there(0)))
      if (steps_per_turn(place)) names.push_back(fmt::format("{} {}", place.device, place.axis));
    return names;
  }

  Place resolve(StageAxis axis, const std::map<int, Device>& devices) const {
    const std::string& text = settings_.axis_names[index(axis)];
    const AxisName name = *parse_axis_name(text);
    Place place;
    if (name.device) {
      place = {*name.device, name.number};
    } else if (!settings_.address.empty() || devices.size() == 1) {
      place = {devices.begin()->first, name.number};
      // The only device on the line, by its own number.
      if (settings_.address.empty() && devices.begin()->second.axes == 1 && name.number == place.device)
        place.axis = 1;
    } else {
      const auto device = devices.find(name.number);
      if (device != devices.end() && device->second.axes > 1) {
        throw failure(
            Fault::kWrongIdentity,
            fmt::format(
                "axis \"{}\" (for {}) is ambiguous because device {} has {} axes; required: one of {}", text,
                to_string(axis), name.number, device->second.axes, list(devices)));
      }
      place = {name.number, 1};
    }
    const auto device = devices.find(place.device);
    if (device == devices.end() || place.axis > device->second.axes) {
      throw failure(Fault::kWrongIdentity, fmt::format("there is no axis \"{}\" (for {}); there are {}", text,
                                                       to_string(axis), list(devices)));
    }
    return place;
  }

  /// Once, before anything else is asked: where our axes are, and that they rotate.
  void ensure_known() {
    if (known_) return;
    const int address = settings_.address.empty() ? 0 : *number_between(settings_.address, 1, 99);
    const std::map<int, Device> devices = who_is_there(address);
    for (const StageAxis axis : kStageAxes) {
      if (settings_.axis_names[index(axis)].empty()) continue;
      const Place place = resolve(axis, devices);
      const auto steps = steps_per_turn(place);
      if (!steps) {
        throw failure(
            Fault::kWrongIdentity,
            fmt::format("axis {} of device {} (for {}) has no limit.cycle.dist, so it is not a rotary axis",
                        place.axis, place.device, to_string(axis)));
      }
      places_[index(axis)] = place;
      steps_per_turn_[index(axis)] = *steps;
    }
    if (!settings_.axis_names[0].empty() && !settings_.axis_names[1].empty() &&
        places_[0].device == places_[1].device && places_[0].axis == places_[1].axis) {
      throw failure(Fault::kWrongIdentity,
                    fmt::format("X and Z are both axis {} of device {}", places_[0].axis, places_[0].device));
    }
    known_ = true;
  }

  void require_on_this_line(StageAxis axis) const {
    if (settings_.axis_names[index(axis)].empty())
      throw failure(Fault::kNotReady, fmt::format("axis {} is not on this line", to_string(axis)));
  }

  Place place_of(StageAxis axis) {
    require_on_this_line(axis);
    ensure_known();
    return places_[index(axis)];
  }

  Angle to_angle(StageAxis axis, double steps) const {
    return Angle::degrees(steps * 360.0 / steps_per_turn_[index(axis)]);
  }
  double to_steps(StageAxis axis, double degrees) const {
    return degrees * steps_per_turn_[index(axis)] / 360.0;
  }

  // ---- Warning flags

  std::vector<std::string> warnings(Place place) { return require(place, "warnings", parse_warnings); }

  static bool has(const std::vector<std::string>& flags, std::string_view flag) {
    return std::find(flags.begin(), flags.end(), flag) != flags.end();
  }

  static std::optional<std::string> first_fault(const std::vector<std::string>& flags) {
    const auto fault =
        std::find_if(flags.begin(), flags.end(), [](const std::string& f) { return is_fault(f); });
    return fault == flags.end() ? std::nullopt : std::optional(*fault);
  }

  /// A driver that is disabled shows as FD, as does one that is too hot: the device knows which.
  void enable_if_off(StageAxis axis, Place place) {
    if (enabled_[index(axis)]) return;
    if (has(warnings(place), "FD")) execute(place, "driver enable");
    enabled_[index(axis)] = true;
  }

  // ---- The calls

  StageAxisInfo axis_info(StageAxis axis) {
    const Place place = place_of(axis);
    StageAxisInfo info;
    const auto peripheral = ask_optional(place, "get peripheralid", first_number);
    if (peripheral && *peripheral > 0.0) info.stage_name = fmt::format("peripheral {:.0f}", *peripheral);
    info.travel_min = to_angle(axis, require(place, "get limit.min", first_number));
    info.travel_max = to_angle(axis, require(place, "get limit.max", first_number));
    info.resolution = to_angle(axis, 1.0);
    const double speed = require(place, "get maxspeed", first_number) / kSpeedFactor;
    info.speed_deg_per_s = settings_.speed_deg_per_s[index(axis)].value_or(to_angle(axis, speed).deg());
    // After a fault the position is not to be trusted either (a stall loses steps): home again.
    const auto flags = warnings(place);
    info.referenced = !has(flags, "WR") && !has(flags, "WH") && !first_fault(flags);
    return info;
  }

  StageInfo identify() override {
    known_ = false;  // Devices that were swapped or switched off and on since are noticed.
    enabled_ = {};
    speed_set_ = {};
    ensure_known();
    StageInfo info;
    info.maker = "Zaber";
    std::vector<int> told;
    const auto add = [](std::string& text, const std::string& more) {
      if (more.empty()) return;
      text += (text.empty() ? "" : "/") + more;
    };
    for (const StageAxis axis : kStageAxes) {
      if (settings_.axis_names[index(axis)].empty()) continue;
      const int device = places_[index(axis)].device;
      if (std::find(told.begin(), told.end(), device) == told.end()) {
        told.push_back(device);
        const Place whole{device, 0};
        const std::string id = require(whole, "get deviceid", any_text);
        add(info.model, id == "50009" ? "X-RSW60A-E03" : "device id " + id);
        add(info.serial_number, ask_optional(whole, "get system.serial", any_text).value_or(""));
        add(info.firmware, ask_optional(whole, "get version", any_text).value_or(""));
      }
      info.axes[index(axis)] = axis_info(axis);
    }
    std::string who = "stage Zaber " + info.model;
    if (!info.serial_number.empty()) who += " (SN " + info.serial_number + ")";
    line().rename(who);
    return info;
  }

  /// The device keeps its speed when it is switched off: written only where it is another one.
  void apply_speed(StageAxis axis, Place place) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)]) return;
    const double wanted = std::round(to_steps(axis, *speed) * kSpeedFactor);
    if (require(place, "get maxspeed", first_number) != wanted)
      execute(place, fmt::format("set maxspeed {:.0f}", wanted));
    speed_set_[index(axis)] = true;
  }

  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    replace_speed(settings_.speed_deg_per_s[index(axis)], usual_speed_[index(axis)], deg_per_s,
                  [&] { return axis_info(axis).speed_deg_per_s; });
    speed_set_[index(axis)] = false;
    apply_speed(axis, place_of(axis));
  }

  void home(StageAxis axis) override {
    const Place place = place_of(axis);
    halted_[index(axis)] = false;
    enabled_[index(axis)] = false;
    enable_if_off(axis, place);
    execute(place, "warnings clear");
    apply_speed(axis, place);
    execute(place, "home");
  }

  void move_to(StageAxis axis, Angle target) override {
    require_on_this_line(axis);
    if (!std::isfinite(target.deg())) {
      throw failure(Fault::kOutOfTravel, fmt::format("target {} of axis \"{}\" is not a number", target.deg(),
                                                     settings_.axis_names[index(axis)]));
    }
    const Place place = place_of(axis);
    const double steps = std::round(to_steps(axis, target.deg()));
    const double least = require(place, "get limit.min", first_number);
    const double most = require(place, "get limit.max", first_number);
    if (!(steps >= least && steps <= most)) {
      throw failure(
          Fault::kOutOfTravel,
          fmt::format("axis {} of device {} to {:.6f} deg; its limits are {:.6f} to {:.6f} deg", place.axis,
                      place.device, target.deg(), to_angle(axis, least).deg(), to_angle(axis, most).deg()));
    }
    enable_if_off(axis, place);
    const auto flags = warnings(place);
    if (const auto fault = first_fault(flags)) {
      enabled_[index(axis)] = false;
      throw flagged(Fault::kRefused, *fault, place, "home it, or clear its warnings once the cause is known");
    }
    for (const std::string_view flag : {"WR", "WH"})
      if (has(flags, flag)) throw flagged(Fault::kNotReady, flag, place, "home it");
    // Flags that appear after the move then belong to the move.
    if (!flags.empty()) execute(place, "warnings clear");
    apply_speed(axis, place);
    halted_[index(axis)] = false;
    const Message reply = execute(place, fmt::format("move abs {:.0f}", steps));
    if (is_fault(reply.warning)) throw flagged(Fault::kRefused, reply.warning, place, "");
  }

  MotionState motion_state(StageAxis axis) override {
    const Place place = place_of(axis);
    const Message status = exchange(place, "", true);
    if (!status.accepted) throw rejection(status, "status");
    if (is_fault(status.warning)) {
      enabled_[index(axis)] = false;
      throw flagged(Fault::kRefused, status.warning, place, "the axis has stopped");
    }
    if (status.busy) return MotionState::kMoving;
    if (status.warning == "--" || halted_[index(axis)]) return MotionState::kStopped;
    const auto flags = warnings(place);
    if (const auto fault = first_fault(flags))
      throw flagged(Fault::kRefused, *fault, place, "the axis has stopped");
    for (const std::string_view flag : {"WL", "WM", "NC", "NI"})
      if (has(flags, flag)) throw flagged(Fault::kRefused, flag, place, "it is not at its target");
    return MotionState::kStopped;
  }

  Angle encoder_angle(StageAxis axis) override {
    const Place place = place_of(axis);
    const Message reply = exchange(place, "get pos", true);
    if (!reply.accepted) throw rejection(reply, "get pos");
    if (is_fault(reply.warning)) throw flagged(Fault::kRefused, reply.warning, place, "");
    const auto steps = first_number(reply.data);
    if (!steps)
      throw failure(Fault::kBadFrame,
                    fmt::format("\"{}\" is not an answer to \"get pos\"", printable(reply.data)));
    return to_angle(axis, *steps);
  }

  // ---- Halt

  void forget_motion() override { halted_ = {true, true}; }

  Clock::Duration reply_deadline() const override { return kReplyDeadline; }

  bool is_here(StageAxis axis) const { return !settings_.axis_names[index(axis)].empty(); }

  /// Where an axis is, as far as that is known without asking for it.
  std::optional<Place> place_to_halt(StageAxis axis) const {
    if (known_) return places_[index(axis)];
    const AxisName name = *parse_axis_name(settings_.axis_names[index(axis)]);
    if (name.device) return Place{*name.device, name.number};
    if (!settings_.address.empty()) return Place{*number_between(settings_.address, 1, 99), name.number};
    return std::nullopt;
  }

  HaltReport stopped_axes(const HaltReport& so_far) override {
    HaltReport report = so_far;
    for (const StageAxis axis : kStageAxes) {
      AxisHalt& found = report.axes[index(axis)];
      if (!is_here(axis)) found = AxisHalt::kHalted;
      if (found == AxisHalt::kHalted) continue;
      const bool stands = says_so([&] {
        if (!place_to_halt(axis)) ensure_known();
        const Message status = exchange(*place_to_halt(axis), "", true);
        return status.accepted && !status.busy;
      });
      if (stands) found = AxisHalt::kHalted;
    }
    return report;
  }

  /// A half-written command ends in a checksum that is wrong, so that no device takes it. Each recipe stops
  /// all devices. If the devices of the axes are unknown, all devices are asked.
  std::vector<HaltRecipe> halt_recipes() const override {
    std::map<int, HaltRecipe> of_device;
    for (const StageAxis axis : kStageAxes) {
      if (!is_here(axis)) continue;
      const Place place = place_to_halt(axis).value_or(Place{});
      HaltRecipe& recipe = of_device[place.device];
      recipe.axes[index(axis)] = true;
      const bool all_are_asked = place.device == 0 && !recipe.questions.empty();
      if (!all_are_asked) add_questions(recipe, place);
    }
    std::vector<HaltRecipe> recipes;
    for (auto& [device, recipe] : of_device) {
      recipe.driver = "zaber_ascii";
      recipe.end_partial = ":??\n";
      recipe.stop = command_line("0 0 stop");
      recipe.reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kReplyDeadline);
      recipes.push_back(std::move(recipe));
    }
    return recipes;
  }

  /// Asks whether an axis is at rest; for device 0, whether all axes of all devices are.
  static void add_questions(HaltRecipe& recipe, Place place) {
    // Two message ids: late replies to a driver have at most one of them.
    for (const int id : {41, 83}) {
      const ReplyPart at = pattern::literal("@");
      const ReplyPart device = place.device == 0 ? pattern::run(pattern::kDecimalDigits, 2, 2)
                                                 : pattern::literal(fmt::format("{:02}", place.device));
      const auto says = [&](const char* status) {
        return ReplyPattern{at, device,
                            pattern::literal(fmt::format(" {} {:02} OK {} ", place.axis, id, status)),
                            pattern::text()};
      };
      const Clock::Duration listen = place.device == 0 ? kQuiet : Clock::Duration::zero();
      recipe.questions.push_back({.bytes = command(place.device, place.axis, id, ""),
                                  .reply = says("IDLE") | says("BUSY"),
                                  .standing = says("IDLE"),
                                  .listen = std::chrono::duration_cast<std::chrono::milliseconds>(listen)});
    }
  }

 private:
  StageSettings settings_;
  std::array<std::optional<double>, 2> usual_speed_{};  ///< Before set_speed().
  int id_ = 0;
  bool checksums_ = false;  ///< Replies have one; those without are damaged.
  bool some_checksums_ = false;
  bool known_ = false;
  std::array<Place, 2> places_{};
  std::array<double, 2> steps_per_turn_{};
  std::array<bool, 2> enabled_{};
  std::array<bool, 2> speed_set_{};
  std::array<bool, 2> halted_{};  ///< By us, so that an interrupted motion is expected.
};

}  // namespace

ZaberAsciiStage::ZaberAsciiStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                 const StageSettings& settings)
    : LineStage((check_settings(stream.get(), settings),
                 std::make_unique<ZaberAsciiController>(std::move(stream), clock, settings))) {}

std::vector<std::string> axes_on_line(std::unique_ptr<wire::ByteStream> stream, Clock& clock) {
  ZaberAsciiController line(std::move(stream), clock, StageSettings{});
  const std::lock_guard lock(line.line());
  return line.rotating_axes();
}

}  // namespace abcal::zaber_ascii
