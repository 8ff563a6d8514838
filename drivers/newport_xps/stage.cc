#include "drivers/newport_xps/stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal::newport_xps {
namespace {

constexpr std::string_view kIdentityRequest = "FirmwareVersionGet(char *)";
/// Initialising a motor is slow; killing a group waits for its standstill.
constexpr Clock::Duration kLongCommand = std::chrono::seconds(5);
constexpr Clock::Duration kStartPatience = std::chrono::seconds(2);
constexpr Clock::Duration kPollInterval = std::chrono::milliseconds(10);
constexpr Clock::Duration kHaltWaitsForExchange = kLongCommand + std::chrono::milliseconds(500);
constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(50);
/// Ends a half-written command so that its last parameter is wrong.
constexpr std::string_view kEndPartial = "?)";
constexpr int kAborted = 10;
constexpr int kOutOfRange = -17;
constexpr int kNoSuchPositioner = -18;
constexpr int kNoSuchGroup = -19;
constexpr int kTravelLimits = -35;

/// "1" is "Group1.Pos".
std::string positioner_of(const std::string& name) {
  const bool number = std::all_of(name.begin(), name.end(), [](char c) { return c >= '0' && c <= '9'; });
  return number && !name.empty() ? "Group" + name + ".Pos" : name;
}

std::string group_of(const std::string& positioner) {
  return positioner.substr(0, positioner.find('.'));
}

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  wire::check_stage_settings("Newport XPS", "the positioner", stream, settings);
  std::array<std::string, 2> groups;
  for (std::size_t k = 0; k < 2; ++k) {
    const std::string name = positioner_of(settings.axis_names[k]);
    if (name.empty()) continue;
    groups[k] = group_of(name);
    const bool letters = std::all_of(name.begin(), name.end(), [](char c) {
      return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' ||
             c == '_' || c == '-';
    });
    if (!letters || groups[k].empty() || std::count(name.begin(), name.end(), '.') != 1 ||
        name.ends_with('.'))
      throw std::invalid_argument(fmt::format(
          "Newport XPS stage: axis name \"{}\"; required: GROUP.POSITIONER as the controller has it, or a "
          "number n for Groupn.Pos",
          printable(name)));
  }
  if (groups[0] == groups[1])
    throw std::invalid_argument(
        fmt::format("Newport XPS stage: both axes are in group {}; required: a group (SingleAxis or Spindle) "
                    "for each, since the motions of one group cannot be told apart",
                    groups[0]));
  if (!settings.address.empty())
    throw std::invalid_argument(
        fmt::format("Newport XPS stage: address \"{}\"; required: none", printable(settings.address)));
}

/// Stop both groups at once; stopped_axes() asks and stops again.
std::string stop_request(const StageSettings& settings) {
  std::string stop;
  for (const std::string& name : settings.axis_names)
    if (!name.empty()) stop += fmt::format("GroupMoveAbort({})", group_of(positioner_of(name)));
  return stop;
}

/// A frame in the form that is compared with the identity.
std::string normal_frame(std::string_view frame) {
  return std::string(frame);
}

wire::LineExchange::Manner manner() {
  return {.identity_request = std::string(kIdentityRequest),
          .identity_name = kIdentityRequest,
          .error_request = {},
          .error_name = "reply",
          .patience = kReplyDeadline,
          .normal = normal_frame,
          .show = printable};
}

/// The connection for the motions of one axis: replies arrive when the motion has ended.
class MotionConnection {
 public:
  explicit MotionConnection(std::unique_ptr<wire::ByteStream> stream) : stream_(std::move(stream)) {}

  /// Sends a request that blocks the connection.
  void command(std::string_view request) {
    require_stream().write(request);
    ++awaited_;
  }

  /// The reply to the last command, if it has arrived.
  std::optional<Reply> reply(Clock::Instant now) {
    take(now);
    return awaited_ == 0 ? std::exchange(last_, std::nullopt) : std::nullopt;
  }

  /// Waits until no earlier reply can arrive any more. @return false if it does not answer.
  bool settle(Clock& clock) {
    take(clock.now());
    if (awaited_ > 0) {
      command(kIdentityRequest);
      const Clock::Instant deadline = clock.now() + kReplyDeadline;
      // The answer to the identity request arrives last.
      while (!is_identity_ && clock.now() < deadline && take(deadline)) continue;
      if (!is_identity_) return false;
    }
    awaited_ = 0;
    last_.reset();
    return true;
  }

 private:
  wire::ByteStream& require_stream() {
    if (!stream_) throw std::logic_error("Newport XPS stage: made for identify() only, without connections");
    return *stream_;
  }

  /// @return whether anything arrived by `until`
  bool take(Clock::Instant until) {
    const std::string bytes = require_stream().read_until(until).bytes;
    received_ += bytes;
    is_identity_ = false;
    for (;;) {
      const wire::FrameVerdict verdict = check_reply(received_);
      if (verdict.check == wire::FrameCheck::kInvalid) received_.clear();
      if (verdict.check != wire::FrameCheck::kComplete) return !bytes.empty();
      last_ = parse_reply(std::string_view(received_).substr(0, verdict.length));
      is_identity_ = last_ && parse_identity(last_->values).has_value();
      received_.erase(0, verdict.length);
      if (awaited_ > 0) --awaited_;
    }
  }

  std::unique_ptr<wire::ByteStream> stream_;
  std::string received_;
  std::optional<Reply> last_;
  bool is_identity_ = false;
  int awaited_ = 0;
};

class NewportXpsController final : public wire::LineController {
 public:
  NewportXpsController(std::vector<std::unique_ptr<wire::ByteStream>> streams, Clock& clock,
                       const StageSettings& settings)
      : LineController("Newport XPS stage", std::move(streams.at(0)), clock, check_reply,
                       {stop_request(settings), kHaltDeadline, kHaltWaitsForExchange, kHaltRetryInterval}),
        settings_(settings),
        clock_(clock),
        motions_{MotionConnection(streams.size() > 1 ? std::move(streams[1]) : nullptr),
                 MotionConnection(streams.size() > 2 ? std::move(streams[2]) : nullptr)},
        replies_(line(), manner(),
                 {[](std::string_view) { return 0; },  // Every reply has its error with it.
                  [](const std::string& frame) -> std::optional<int> {
                    const auto reply = parse_reply(frame);
                    return reply ? std::optional(reply->code) : std::nullopt;
                  }}) {}

  // ---- Requests

  InstrumentError refusal(int code, std::string_view request) const {
    Fault fault = Fault::kRefused;
    if (code == kOutOfRange || code == kTravelLimits) fault = Fault::kOutOfTravel;
    if (code == kNoSuchPositioner || code == kNoSuchGroup) fault = Fault::kWrongIdentity;
    return failure(fault, fmt::format("error {} ({}) to \"{}\"", code, error_text(code), request));
  }

  /// Asks a question that the controller must know; `parse` returns the value of the values in its reply.
  template <class Parse>
  auto require(const std::string& request, Parse parse) {
    using Value = typename decltype(parse(std::string_view()))::value_type;
    struct Outcome {
      int code = 0;
      Value value{};
    };
    const auto parse_frame = [&parse](const std::string& frame) -> std::optional<Outcome> {
      const auto reply = parse_reply(frame);
      if (!reply) return std::nullopt;
      if (reply->code != 0) return Outcome{reply->code, {}};
      auto value = parse(std::string_view(reply->values));
      if (!value) return std::nullopt;
      return Outcome{0, *std::move(value)};
    };
    const Outcome outcome =
        replies_.require(request, request, parse_frame,
                         [this](int code, std::string_view asked) { return refusal(code, asked); });
    if (outcome.code != 0) throw refusal(outcome.code, request);
    return outcome.value;
  }

  std::vector<double> numbers(const std::string& function, StageAxis axis, std::size_t count) {
    std::string request = function + "(" + positioner(axis);
    for (std::size_t n = 0; n < count; ++n) request += ",double *";
    return require(request + ")", [count](std::string_view v) { return parse_numbers(v, count); });
  }

  int group_state(StageAxis axis) {
    return require(fmt::format("GroupStatusGet({},int *)", group(axis)), parse_state);
  }

  void execute(const std::string& request) {
    if (const int code = replies_.execute(request, request); code != 0) throw refusal(code, request);
  }

  // ---- Names

  bool has(StageAxis axis) const { return !settings_.axis_names[index(axis)].empty(); }

  std::string positioner(StageAxis axis) const {
    if (!has(axis))
      throw failure(Fault::kNotReady, fmt::format("axis {} is not on this controller", to_string(axis)));
    return positioner_of(settings_.axis_names[index(axis)]);
  }
  std::string group(StageAxis axis) const { return group_of(positioner(axis)); }

  // ---- The calls

  void ensure_known() {
    if (known_) return;
    const auto accept = [this](const std::string& frame) {
      const auto reply = parse_reply(frame);
      const auto identity = reply && reply->code == 0 ? parse_identity(reply->values) : std::nullopt;
      if (identity) identity_ = *identity;
      return identity.has_value();
    };
    replies_.identify_twice(accept, "is the controller on and started, and is its port 5001 meant?",
                            "an XPS controller", kLongestReply);
    known_ = true;
  }

  StageAxisInfo axis_info(StageAxis axis) {
    StageAxisInfo info;
    info.stage_name = positioner(axis);
    const auto travel = numbers("PositionerUserTravelLimitsGet", axis, 2);
    info.travel_min = Angle::degrees(travel[0]);
    info.travel_max = Angle::degrees(travel[1]);
    const double speed = numbers("PositionerSGammaParametersGet", axis, 4)[0];
    info.speed_deg_per_s = settings_.speed_deg_per_s[index(axis)].value_or(speed);
    const int state = group_state(axis);
    const GroupState meaning = meaning_of(state);
    info.referenced = meaning == GroupState::kReady || meaning == GroupState::kMoving || state == 20;
    return info;
  }

  StageInfo identify() override {
    known_ = false;  // A controller that was swapped or started again since is noticed.
    speed_set_ = {};
    ensure_known();
    StageInfo info;
    info.maker = "Newport";
    info.model = identity_.model;
    info.firmware = identity_.firmware;
    for (const StageAxis axis : kStageAxes)
      if (has(axis)) info.axes[index(axis)] = axis_info(axis);
    return info;
  }

  void apply_speed(StageAxis axis) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)]) return;
    const auto now = numbers("PositionerSGammaParametersGet", axis, 4);
    if (now[0] != *speed)
      execute(fmt::format("PositionerSGammaParametersSet({},{:.13g},{:.13g},{:.13g},{:.13g})",
                          positioner(axis), *speed, now[1], now[2], now[3]));
    speed_set_[index(axis)] = true;
  }

  /// Sends a request that blocks the axis' connection.
  MotionConnection& command_motion(StageAxis axis, const std::string& request) {
    MotionConnection& motion = motions_[index(axis)];
    if (!motion.settle(clock_))
      throw failure(Fault::kNoReply,
                    fmt::format("no answer on the connection for the motions of {} within {} s",
                                to_string(axis), to_seconds(kReplyDeadline)));
    if (line().halting())
      throw failure(Fault::kNotReady, "the stage is being halted; nothing else is sent until this is done");
    motion.command(request);
    return motion;
  }

  /// Sends a slow command that is not a motion, and waits until it is done.
  void prepare(StageAxis axis, const std::string& request) {
    MotionConnection& motion = command_motion(axis, request);
    const Clock::Instant deadline = clock_.now() + kLongCommand;
    for (;;) {
      if (const auto reply = motion.reply(clock_.now())) {
        if (reply->code != 0) throw refusal(reply->code, request);
        return;
      }
      if (line().halting() || clock_.now() >= deadline)
        throw failure(Fault::kNoReply,
                      fmt::format("\"{}\" was not answered within {} s", request, to_seconds(kLongCommand)));
      clock_.sleep_until(clock_.now() + kPollInterval);
    }
  }

  /// Commands a motion, and waits until the group reports that it has begun.
  void start_motion(StageAxis axis, const std::string& request) {
    halted_[index(axis)] = false;
    MotionConnection& motion = command_motion(axis, request);
    const Clock::Instant deadline = clock_.now() + kStartPatience;
    for (;;) {
      const int state = group_state(axis);
      if (const auto reply = motion.reply(clock_.now())) {
        if (reply->code != 0) throw refusal(reply->code, request);
        break;
      }
      const GroupState meaning = meaning_of(state);
      if (meaning == GroupState::kHoming || meaning == GroupState::kMoving) break;
      if (clock_.now() >= deadline)
        throw failure(Fault::kNoReply,
                      fmt::format("\"{}\" was not answered within {} s, and the group does not move (state "
                                  "{}: {})",
                                  request, to_seconds(kStartPatience), state, state_text(state)));
      clock_.sleep_until(clock_.now() + kPollInterval);
    }
    active_[index(axis)] = true;
  }

  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    replace_speed(settings_.speed_deg_per_s[index(axis)], usual_speed_[index(axis)], deg_per_s,
                  [&] { return axis_info(axis).speed_deg_per_s; });
    speed_set_[index(axis)] = false;
    apply_speed(axis);
  }

  void home(StageAxis axis) override {
    const std::string name = group(axis);
    ensure_known();
    active_[index(axis)] = false;
    GroupState state = meaning_of(group_state(axis));
    if (state != GroupState::kNotInitialised && state != GroupState::kNotReferenced) {
      prepare(axis, fmt::format("GroupKill({})", name));
      state = GroupState::kNotInitialised;
    }
    if (state == GroupState::kNotInitialised) prepare(axis, fmt::format("GroupInitialize({})", name));
    apply_speed(axis);
    start_motion(axis, fmt::format("GroupHomeSearch({})", name));
  }

  void move_to(StageAxis axis, Angle target) override {
    const std::string name = positioner(axis);
    if (!std::isfinite(target.deg()))
      throw failure(Fault::kOutOfTravel, fmt::format("target {} of {} is not a number", target.deg(), name));
    ensure_known();
    const auto travel = numbers("PositionerUserTravelLimitsGet", axis, 2);
    if (!(target.deg() >= travel[0] && target.deg() <= travel[1]))
      throw failure(Fault::kOutOfTravel, fmt::format("{} to {:.6f} deg; its limits are {:.6f} to {:.6f} deg",
                                                     name, target.deg(), travel[0], travel[1]));
    const int state = group_state(axis);
    if (state == 20) {
      execute(fmt::format("GroupMotionEnable({})", group(axis)));
    } else if (meaning_of(state) != GroupState::kReady) {
      throw failure(
          Fault::kNotReady,
          fmt::format("group {} is in state {} ({}); {}", group(axis), state, state_text(state),
                      meaning_of(state) == GroupState::kMoving || meaning_of(state) == GroupState::kHoming
                          ? "wait until it stands still, or halt it"
                          : "home it"));
    }
    apply_speed(axis);
    start_motion(axis, fmt::format("GroupMoveAbsolute({},{:.13g})", name, target.deg()));
  }

  MotionState motion_state(StageAxis axis) override {
    ensure_known();
    const int state = group_state(axis);
    const GroupState meaning = meaning_of(state);
    if (meaning == GroupState::kHoming || meaning == GroupState::kMoving) return MotionState::kMoving;
    const bool was_active = std::exchange(active_[index(axis)], false);
    const bool arrived = meaning == GroupState::kReady && state != kAborted;
    if (was_active && !arrived && !halted_[index(axis)])
      throw failure(Fault::kRefused,
                    fmt::format("the motion of {} has ended before its target: state {} ({})",
                                positioner(axis), state, state_text(state)));
    return MotionState::kStopped;
  }

  Angle encoder_angle(StageAxis axis) override {
    ensure_known();
    return Angle::degrees(numbers("GroupPositionCurrentGet", axis, 1)[0]);
  }

  // ---- Halt

  void forget_motion() override { halted_ = {true, true}; }

  Clock::Duration reply_deadline() const override { return kReplyDeadline; }

  HaltReport stopped_axes(const HaltReport& /*so_far*/) override {
    ensure_known();
    replies_.expect_stray_reply();  // The stop is answered, too.
    bool all = true;
    for (const StageAxis axis : kStageAxes) {
      if (!has(axis)) continue;
      const GroupState state = meaning_of(group_state(axis));
      if (state != GroupState::kMoving && state != GroupState::kHoming) continue;
      all = false;
      const std::string request =
          fmt::format("{}({})", state == GroupState::kHoming ? "GroupKill" : "GroupMoveAbort", group(axis));
      replies_.execute(request, request);
    }
    return HaltReport::of_both(all);
  }

  /// Without the driver a home search is not ended (that takes GroupKill, which switches the motor off): the
  /// halt is not acknowledged before it has ended.
  std::vector<HaltRecipe> halt_recipes() const override {
    HaltRecipe recipe{.driver = "newport_xps",
                      .axes = {has(StageAxis::kX), has(StageAxis::kZ)},
                      .end_partial = std::string(kEndPartial),
                      .stop = stop_request(settings_),
                      .questions = {},
                      .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(kReplyDeadline),
                      .reply_end = std::string(kReplyEnd)};
    // Bytes before this reply answer earlier requests.
    recipe.questions.push_back({.bytes = std::string(kIdentityRequest),
                                .reply = ReplyPattern{pattern::literal("0,XPS"), pattern::text()} |
                                         ReplyPattern{pattern::literal("0,HXP"), pattern::text()},
                                .standing = {}});
    for (const StageAxis axis : kStageAxes) {
      if (!has(axis)) continue;
      recipe.questions.push_back(
          {.bytes = fmt::format("GroupMoveAbort({})", group(axis)),
           .reply = ReplyPattern{pattern::literal("0,")} |
                    ReplyPattern{pattern::literal("-"), pattern::run(pattern::kDecimalDigits),
                                 pattern::literal(","), pattern::text()},
           .standing = {}});
      recipe.questions.push_back({.bytes = fmt::format("GroupStatusGet({},int *)", group(axis)),
                                  .reply = {pattern::literal("0,"), pattern::run(pattern::kDecimalDigits)},
                                  .standing = ReplyPattern{pattern::literal("0,"), pattern::number(0, 39)} |
                                              ReplyPattern{pattern::literal("0,42")} |
                                              ReplyPattern{pattern::literal("0,50")} |
                                              ReplyPattern{pattern::literal("0,63")}});
    }
    return {recipe};
  }

 private:
  StageSettings settings_;
  std::array<std::optional<double>, 2> usual_speed_{};  ///< Before set_speed().
  Clock& clock_;
  std::array<MotionConnection, 2> motions_;
  wire::LineExchange replies_;
  Identity identity_;
  bool known_ = false;
  std::array<bool, 2> speed_set_{};
  std::array<bool, 2> active_{};  ///< A motion that we commanded may be under way.
  std::array<bool, 2> halted_{};  ///< By us, so that an aborted motion is expected.
};

}  // namespace

NewportXpsStage::NewportXpsStage(std::vector<std::unique_ptr<wire::ByteStream>> streams, Clock& clock,
                                 const StageSettings& settings)
    : LineStage((check_settings(streams.empty() ? nullptr : streams[0].get(), settings),
                 std::make_unique<NewportXpsController>(std::move(streams), clock, settings))) {}

}  // namespace abcal::newport_xps
