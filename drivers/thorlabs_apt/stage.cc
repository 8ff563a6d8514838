#include "drivers/thorlabs_apt/stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/text.h"
#include "drivers/thorlabs_apt/codec.h"

namespace abcal::thorlabs_apt {
namespace {

using namespace std::string_literals;

constexpr Clock::Duration kHaltWaitsForExchange = kReplyDeadline + std::chrono::milliseconds(500);
constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(50);
constexpr Clock::Duration kDiscovery = std::chrono::milliseconds(300);
constexpr Clock::Duration kStartPatience = std::chrono::milliseconds(1500);
constexpr Clock::Duration kPollInterval = std::chrono::milliseconds(10);
constexpr std::string_view kIdentityName = "HW_REQ_INFO";
constexpr double kTravelDegrees = 360.0;
/// A motion that has ended this far from its target was ended by something else.
constexpr double kFarFromTargetDegrees = 0.5;
constexpr std::uint8_t kProfiled = 2;
/// The longest message that can be half written is shorter.
constexpr std::size_t kLongestHalf = 24;

/// "2 HDR50"
struct AxisName {
  std::uint8_t number = 0;  ///< 0: not on this port.
  std::string stage;        ///< Empty: the controller knows it.
};

AxisName parse_axis_name(const std::string& name) {
  const std::vector<std::string_view> words = pieces::words(name);
  if (words.empty()) return {};
  const bool one_digit = words[0].size() == 1 && words[0][0] >= '1' && words[0][0] <= '9';
  if (!one_digit || words.size() > 2)
    throw std::invalid_argument(
        fmt::format("Thorlabs stage: axis name \"{}\"; required: the number of a bay, perhaps with the stage "
                    "behind it, e.g. \"1\" or \"1 HDR50\"",
                    wire::printable(name)));
  AxisName axis{static_cast<std::uint8_t>(words[0][0] - '0'), {}};
  if (words.size() == 2) {
    axis.stage = words[1];
    if (!counts_per_degree(axis.stage))
      throw std::invalid_argument(
          fmt::format("Thorlabs stage: stage \"{}\" of axis \"{}\"; required: one of {}",
                      wire::printable(axis.stage), axis.number, known_stages()));
  }
  return axis;
}

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  wire::check_stage_settings("Thorlabs", "the number", stream, settings);
  const AxisName x = parse_axis_name(settings.axis_names[0]);
  const AxisName z = parse_axis_name(settings.axis_names[1]);
  if (x.number == z.number)
    throw std::invalid_argument(
        fmt::format("Thorlabs stage: both axes are number {}; required: two numbers", x.number));
  if (!settings.address.empty())
    throw std::invalid_argument(
        fmt::format("Thorlabs stage: address \"{}\"; required: none", wire::printable(settings.address)));
}

/// The one of the two that exists receives it: a bay of a controller, or a unit's channel.
struct Place {
  std::uint8_t destination = 0;
  std::uint8_t channel = 1;
};
Place bay(std::uint8_t number) {
  return {static_cast<std::uint8_t>(0x20 + number), 1};
}
Place channel_of_unit(std::uint8_t number) {
  return {kUnit, number};
}

/// The message six times, one byte further each time. A controller that is in the middle of a message
/// receives it once, wherever that message ends: none of its shifted copies is addressed to a controller. The
/// total length is a multiple of a message's, so the alignment of later messages does not change.
std::string in_any_step(std::string_view message) {
  std::string all;
  for (int n = 0; n < 6; ++n) all.append(message).push_back('\0');
  return all;
}

/// All places where an axis may be, as long as that is not known.
std::vector<Place> possible_places(const AxisName& axis) {
  std::vector<Place> places;
  if (axis.number > 0) places.push_back(bay(axis.number));
  if (axis.number == 1) places.push_back(channel_of_unit(1));
  return places;
}

std::string stop_all(const StageSettings& settings) {
  std::string stop;
  for (const std::string& name : settings.axis_names)
    for (const Place& place : possible_places(parse_axis_name(name)))
      stop += in_any_step(short_message(kStop, place.channel, kProfiled, place.destination));
  return stop;
}

/// Unrequested messages (a move has ended) and malformed frames are skipped.
std::string normal_frame(std::string_view frame) {
  const auto message = parse_message(frame);
  constexpr std::array<std::uint16_t, 3> kUnasked{0x0444, 0x0464, 0x0466};
  if (!message || std::find(kUnasked.begin(), kUnasked.end(), message->id) != kUnasked.end()) return {};
  return std::string(frame);
}

wire::LineExchange::Manner manner(std::uint8_t destination) {
  return {.identity_request = short_message(kRequestInfo, 0, 0, destination),
          .identity_name = kIdentityName,
          .error_request = {},
          .error_name = "status",
          .patience = kReplyDeadline,
          .normal = normal_frame,
          .show = wire::bytes_in_hex};
}

class ThorlabsAptController final : public wire::LineController {
 public:
  ThorlabsAptController(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : LineController("Thorlabs stage", std::move(stream), clock, check_message,
                       {stop_all(settings), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}),
        settings_(settings),
        clock_(clock) {
    for (const StageAxis axis : kStageAxes)
      axes_[index(axis)].name = parse_axis_name(settings.axis_names[index(axis)]);
    talk_to(kRack);
  }

  // ---- Exchange

  void talk_to(std::uint8_t destination) {
    destination_ = destination;
    replies_.emplace(
        line(), manner(destination),
        wire::LineExchange::Errors{[](std::string_view) { return 0; },
                                   [this](const std::string& frame) { return take_status(frame); }});
  }

  /// The reply to a status request that was sent along with a command: 0, or 1 if the command was refused.
  std::optional<int> take_status(const std::string& frame) {
    const auto message = parse_message(frame);
    if (!message) return std::nullopt;
    refusal_ = parse_refusal(*message);
    if (refusal_) return 1;
    if (message->source != status_of_) return std::nullopt;
    const auto status = parse_status(*message);
    if (!status) return std::nullopt;
    last_status_ = *status;
    return 0;
  }

  InstrumentError refused(const Refusal& refusal, std::string_view shown) const {
    return failure(Fault::kRefused, fmt::format("error {} ({}) to {}", refusal.code, refusal.text, shown));
  }

  /// Asks one place; `parse` makes a value of a message.
  template <class Parse>
  auto ask(Place place, std::uint16_t id, std::string_view shown, Parse parse) {
    using Value = typename decltype(parse(Message()))::value_type;
    struct Outcome {
      std::optional<Value> value{};
      std::optional<Refusal> refusal{};
    };
    const auto parse_frame = [&](const std::string& frame) -> std::optional<Outcome> {
      const auto message = parse_message(frame);
      if (!message || message->source != place.destination) return std::nullopt;
      if (const auto refusal = parse_refusal(*message)) return Outcome{{}, refusal};
      auto value = parse(*message);
      if (!value) return std::nullopt;
      return Outcome{std::move(value), {}};
    };
    const std::string request = short_message(id, place.channel, 0, place.destination);
    const Outcome outcome =
        replies_->require(request, shown, parse_frame, [this](int code, std::string_view asked) {
          return refused({code, "unknown"}, asked);
        });
    if (outcome.refusal) throw refused(*outcome.refusal, shown);
    return *outcome.value;
  }

  std::uint16_t status_id() const { return controller_.servo ? kRequestServoStatus : kRequestStatus; }

  Status status(StageAxis axis) {
    return ask(place_of(axis), status_id(), "the status request", parse_status);
  }

  /// Sends a command, once, and the status request with it: a refusal arrives before the status.
  Status command(StageAxis axis, const std::string& bytes, std::string_view shown) {
    const Place place = place_of(axis);
    status_of_ = place.destination;
    const std::string request = short_message(status_id(), place.channel, 0, place.destination);
    if (replies_->execute(bytes + request, shown) != 0) throw refused(*refusal_, shown);
    return last_status_;
  }

  // ---- Identity and axes

  struct Axis {
    AxisName name;
    std::string stage;
    double counts_per_degree = 0.0;
    bool speed_set = false;
    bool halted = false;                   ///< By us, so that a large distance from its target is expected.
    std::optional<std::int32_t> target{};  ///< Target of the motion under way, if it is a move.
  };

  /// Sends the identity request to both kinds of controller, and sees which of them answers.
  void discover() {
    for (int attempt = 1; attempt <= 2; ++attempt) {
      line().discard_input();
      line().send(short_message(kRequestInfo, 0, 0, kRack) + short_message(kRequestInfo, 0, 0, kUnit));
      const Clock::Instant deadline = line().deadline_after(kDiscovery);
      bool unit = false;
      while (const auto frame = line().take_frame(deadline)) {
        const auto message = parse_message(*frame);
        if (!message || !parse_info(*message)) continue;
        if (message->source == kRack) return talk_to(kRack);
        unit = message->source == kUnit;
        if (unit) break;
      }
      if (unit) return talk_to(kUnit);
    }
    talk_to(destination_);  // identify() asks again, and reports its silence.
  }

  void ensure_known() {
    if (known_) return;
    discover();
    const auto accept = [this](const std::string& frame) {
      const auto message = parse_message(frame);
      const auto info = message && message->source == destination_ ? parse_info(*message) : std::nullopt;
      if (info) info_ = *info;
      return info.has_value();
    };
    constexpr std::size_t kMostBytes = 4096;
    replies_->identify_twice(accept, "is the controller on, and is it the port of a Thorlabs controller?",
                             "an APT controller", kMostBytes);
    line().rename(fmt::format("stage Thorlabs {} (SN {})", info_.model, info_.serial_number));
    const auto controller = find_controller(info_.model);
    if (!controller)
      throw failure(Fault::kWrongIdentity,
                    fmt::format("the model {} is not known to drive a rotary stage; known: BBD, KBD, TBD, "
                                "KDC, TDC, K10CR, BSC20, SSC20, KST, TST101",
                                info_.model));
    controller_ = *controller;
    for (const StageAxis axis : kStageAxes)
      if (axes_[index(axis)].name.number > 0) find_stage(axis);
    known_ = true;
  }

  /// Finds which stage the channel drives: from the bench file, from the controller, or because the unit has
  /// only one.
  void find_stage(StageAxis axis) {
    Axis& a = axes_[index(axis)];
    if (destination_ == kUnit && a.name.number != 1)
      throw failure(Fault::kWrongIdentity, fmt::format("there is no axis {} (for {}) on {}, which has one; "
                                                       "for two such controllers give each axis its own port",
                                                       a.name.number, to_string(axis), info_.model));
    a.stage = a.name.stage;
    if (a.stage.empty() && info_.model.starts_with("K10CR")) a.stage = "K10CR1";
    if (a.stage.empty() && controller_.servo) {
      a.stage = ask(place(a), kRequestStageParameters, "the stage's parameters", parse_stage_name);
    }
    const auto counts = counts_per_degree(a.stage);
    if (!counts)
      throw failure(Fault::kWrongIdentity,
                    fmt::format("which stage axis {} drives is not known ({}); required: its name behind the "
                                "number in the bench file, e.g. axis = \"{} HDR50\"; known: {}",
                                a.name.number,
                                a.stage.empty() ? "the controller does not tell it"
                                                : "the controller says \"" + wire::printable(a.stage) + "\"",
                                a.name.number, known_stages()));
    a.counts_per_degree = *counts;
  }

  Place place(const Axis& axis) const {
    return destination_ == kUnit ? channel_of_unit(axis.name.number) : bay(axis.name.number);
  }

  Axis& on_this_line(StageAxis axis) {
    Axis& a = axes_[index(axis)];
    if (a.name.number == 0)
      throw failure(Fault::kNotReady, fmt::format("axis {} is not on this controller", to_string(axis)));
    return a;
  }

  /// The axis, once its place is known.
  Axis& known(StageAxis axis) {
    Axis& a = on_this_line(axis);
    ensure_known();
    return a;
  }
  Place place_of(StageAxis axis) { return place(on_this_line(axis)); }

  Angle to_angle(const Axis& axis, std::int32_t counts) const {
    return Angle::degrees(counts / axis.counts_per_degree);
  }

  double velocity_factor(const Axis& axis) const {
    return axis.counts_per_degree * controller_.velocity_per_count_s;
  }

  Velocity velocity(StageAxis axis) {
    return ask(place_of(axis), kRequestVelocity, "the velocity request", parse_velocity);
  }

  void check_faults(const Axis& axis, const Status& status) const {
    if (!status.fault().empty())
      throw failure(Fault::kRefused, fmt::format("axis {}: {} (status {:08X})", axis.name.number,
                                                 status.fault(), status.bits));
  }

  // ---- The calls

  StageInfo identify() override {
    known_ = false;  // A controller that was swapped or switched off and on since is noticed.
    ensure_known();
    StageInfo info;
    info.maker = "Thorlabs";
    info.model = info_.model;
    info.serial_number = std::to_string(info_.serial_number);
    info.firmware = info_.firmware;
    for (const StageAxis axis : kStageAxes) {
      Axis& a = axes_[index(axis)];
      if (a.name.number == 0) continue;
      a.speed_set = false;
      StageAxisInfo& told = info.axes[index(axis)];
      told.stage_name = a.stage;
      told.travel_min = Angle::degrees(-kTravelDegrees);
      told.travel_max = Angle::degrees(kTravelDegrees);
      told.resolution = to_angle(a, 1);
      const double speed = velocity(axis).maximum / velocity_factor(a);
      told.speed_deg_per_s = settings_.speed_deg_per_s[index(axis)].value_or(speed);
      told.referenced = status(axis).homed();
    }
    return info;
  }

  /// The written values are read back, because settings are not acknowledged.
  void apply_speed(StageAxis axis) {
    Axis& a = axes_[index(axis)];
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || a.speed_set) return;
    Velocity wanted = velocity(axis);
    const double maximum = std::round(*speed * velocity_factor(a));
    constexpr double kLargest = 2147483647.0;
    if (!(maximum >= 1.0 && maximum <= kLargest))
      throw failure(Fault::kRefused, fmt::format("a speed of {} deg/s cannot be set", *speed));
    if (wanted.maximum != static_cast<std::int32_t>(maximum)) {
      wanted.maximum = static_cast<std::int32_t>(maximum);
      const Place where = place(a);
      line().send(set_velocity(where.destination, where.channel, wanted));
      const Velocity read = velocity(axis);
      if (read.maximum != wanted.maximum)
        throw failure(Fault::kRefused,
                      fmt::format("the speed of axis {} was set to {:.6f} deg/s and reads {:.6f}",
                                  a.name.number, *speed, read.maximum / velocity_factor(a)));
    }
    a.speed_set = true;
  }

  /// Waits until the status shows the motion, or its end.
  void wait_for_start(StageAxis axis, Status seen, std::string_view shown,
                      const std::function<bool(const Status&)>& done) {
    const Clock::Instant deadline = clock_.now() + kStartPatience;
    while (!seen.moving() && !done(seen)) {
      check_faults(axes_[index(axis)], seen);
      if (clock_.now() >= deadline)
        throw failure(Fault::kNoReply,
                      fmt::format("axis {} does not move {} s after {}", axes_[index(axis)].name.number,
                                  to_seconds(kStartPatience), shown));
      clock_.sleep_until(clock_.now() + kPollInterval);
      seen = status(axis);
    }
  }

  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    replace_speed(settings_.speed_deg_per_s[index(axis)], usual_speed_[index(axis)], deg_per_s,
                  [&] { return velocity(axis).maximum / velocity_factor(axes_[index(axis)]); });
    axes_[index(axis)].speed_set = false;
    apply_speed(axis);
  }

  void home(StageAxis axis) override {
    Axis& a = known(axis);
    a.target.reset();
    const Place where = place(a);
    line().send(short_message(kEnableChannel, where.channel, 1, where.destination));
    apply_speed(axis);
    a.halted = false;
    const Status seen = command(axis, short_message(kHome, where.channel, 0, where.destination),
                                "the search for the reference");
    wait_for_start(axis, seen, "it was told to search for its reference",
                   [](const Status&) { return false; });
  }

  void move_to(StageAxis axis, Angle target) override {
    on_this_line(axis);
    if (!(std::abs(target.deg()) <= kTravelDegrees))
      throw failure(Fault::kOutOfTravel,
                    fmt::format("axis {} to {:.6f} deg; required: at most {:.0f} deg either way",
                                axes_[index(axis)].name.number, target.deg(), kTravelDegrees));
    Axis& a = known(axis);
    const Status before = status(axis);
    check_faults(a, before);
    if (!before.homed())
      throw failure(Fault::kNotReady, fmt::format("axis {} has no reference; home it", a.name.number));
    apply_speed(axis);
    const Place where = place(a);
    const auto counts = static_cast<std::int32_t>(std::llround(target.deg() * a.counts_per_degree));
    a.halted = false;
    const Status seen = command(axis, move_absolute(where.destination, where.channel, counts), "the move");
    const auto arrived = [&a, counts](const Status& status) {
      return std::abs(static_cast<double>(status.position) - counts) <=
             kFarFromTargetDegrees * a.counts_per_degree;
    };
    wait_for_start(axis, seen, "it was told to move", arrived);
    a.target = counts;
  }

  MotionState motion_state(StageAxis axis) override {
    Axis& a = known(axis);
    const Status now = status(axis);
    if (now.moving()) return MotionState::kMoving;
    const auto target = std::exchange(a.target, std::nullopt);
    check_faults(a, now);
    if (target && !a.halted) {
      const double off = (static_cast<double>(now.position) - *target) / a.counts_per_degree;
      if (std::abs(off) > kFarFromTargetDegrees)
        throw failure(Fault::kRefused,
                      fmt::format("axis {} has stopped {:.3f} deg from its target", a.name.number, off));
    }
    return MotionState::kStopped;
  }

  Angle encoder_angle(StageAxis axis) override {
    const Axis& a = known(axis);
    return to_angle(a, status(axis).position);
  }

  // ---- Halt

  void forget_motion() override {
    for (Axis& axis : axes_) axis.halted = true;
  }

  Clock::Duration reply_deadline() const override { return kReplyDeadline; }

  HaltReport stopped_axes(const HaltReport& /*so_far*/) override {
    ensure_known();
    const bool all = std::all_of(kStageAxes.begin(), kStageAxes.end(), [this](StageAxis axis) {
      return axes_[index(axis)].name.number == 0 || !status(axis).moving();
    });
    return HaltReport::of_both(all);
  }

  std::vector<HaltRecipe> halt_recipes() const override {
    HaltRecipe recipe{.driver = "thorlabs_apt",
                      .axes = {axes_[0].name.number > 0, axes_[1].name.number > 0},
                      // Ends a half-written command. If its position is incomplete, it is then near zero, and
                      // the stop follows at once.
                      .end_partial = std::string(kLongestHalf, '\0'),
                      .stop = stop_all(settings_),
                      .questions = {},
                      .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kReplyDeadline),
                      .binary = true};
    for (const Axis& axis : axes_) {
      if (axis.name.number == 0) continue;
      const std::vector<Place> places = known_ ? std::vector{place(axis)} : possible_places(axis.name);
      HaltRecipe::Question question;
      std::string sources;
      for (const Place& where : places) {
        question.bytes += in_any_step(short_message(kRequestStatusBits, where.channel, 0, where.destination));
        sources += static_cast<char>(where.destination);
      }
      // A message of status bits to the host, from one of the sources; the number of its channel is 1.
      const ReplyPart head = pattern::literal("\x2a\x04\x06\x00\x81"s),
                      channel = pattern::literal("\x01\x00"s);
      const ReplyPart source = pattern::run(sources, 1, 1);
      question.reply = {head, source, channel, pattern::any_bytes(4)};
      // Bits 4 to 7 and 9: turning, jogging, homing.
      question.standing = {head, source, channel, pattern::zero_bits("\xf0\x02\x00\x00"s)};
      recipe.questions.push_back(std::move(question));
    }
    return {recipe};
  }

 private:
  StageSettings settings_;
  std::array<std::optional<double>, 2> usual_speed_{};  ///< Before set_speed().
  Clock& clock_;
  std::array<Axis, 2> axes_;
  std::optional<wire::LineExchange> replies_;
  std::uint8_t destination_ = kRack;  ///< Address that the identity is requested from.
  std::uint8_t status_of_ = 0;        ///< Address whose status was requested along with a command.
  Status last_status_;
  std::optional<Refusal> refusal_;
  HardwareInfo info_;
  Controller controller_;
  bool known_ = false;
};

}  // namespace

ThorlabsAptStage::ThorlabsAptStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                   const StageSettings& settings)
    : LineStage((check_settings(stream.get(), settings),
                 std::make_unique<ThorlabsAptController>(std::move(stream), clock, settings))) {}

}  // namespace abcal::thorlabs_apt
