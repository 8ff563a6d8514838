#include "drivers/described/stage.h"

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
#include <utility>
#include <vector>

#include "drivers/described/codec.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/stage_description.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal::described {
namespace {

constexpr Clock::Duration kHaltRetryInterval = std::chrono::milliseconds(20);
/// After [[prepare]] the axes are watched this often, this far apart, and may differ by this much.
constexpr int kLooksAfterPrepare = 3;
constexpr Clock::Duration kBetweenLooks = std::chrono::milliseconds(100);
constexpr double kAtRestDeg = 0.05;
/// A controller that still reports an error after this many questions has one that stays.
constexpr int kMostOldErrors = 20;

using Numbers = std::map<std::string, double, std::less<>>;

/// The port of a controller: keeps the least time between commands, and removes lines that answer nothing.
/// Any thread may write.
class DescribedStream final : public wire::ByteStream {
 public:
  DescribedStream(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageDescription& description)
      : stream_(std::move(stream)),
        clock_(clock),
        gap_(from_seconds(description.gap_s)),
        command_end_(description.command_end),
        filter_(description) {}

  void write(std::string_view bytes) override {
    const std::lock_guard lock(write_mutex_);
    while (!bytes.empty()) {
      const std::size_t end =
          gap_ > Clock::Duration::zero() ? bytes.find(command_end_) : std::string_view::npos;
      const std::size_t length = end == std::string_view::npos ? bytes.size() : end + command_end_.size();
      write_command(bytes.substr(0, length));
      bytes.remove_prefix(length);
    }
  }

  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    for (;;) {
      wire::ReceivedBytes got = stream_->read_until(deadline);
      if (got.bytes.empty()) return got;
      free_after(gap_);
      const std::lock_guard lock(state_mutex_);
      if (!filter_.is_needed()) return got;
      std::string rest = filter_.pass(got.bytes);
      const bool is_late = clock_.now() >= deadline;
      if (!rest.empty() || is_late) return {std::move(rest), got.arrival};
    }
  }

  void discard_input() override {
    stream_->discard_input();
    const std::lock_guard lock(state_mutex_);
    filter_.forget();
  }
  std::size_t dropped_bytes() const override { return stream_->dropped_bytes(); }
  std::string name() const override { return stream_->name(); }

 private:
  void write_command(std::string_view bytes) {
    for (;;) {
      const Clock::Instant free_at = free_instant();
      if (clock_.now() >= free_at) break;
      clock_.sleep_until(free_at);
    }
    {
      const std::lock_guard state_lock(state_mutex_);
      filter_.sent(bytes);
    }
    stream_->write(bytes);
    // Its reply, from which the gap counts, may come as late as the gap is long.
    free_after(2 * gap_);
  }

  Clock::Instant free_instant() {
    const std::lock_guard lock(state_mutex_);
    return free_at_.value_or(clock_.now());
  }
  void free_after(Clock::Duration time) {
    const std::lock_guard lock(state_mutex_);
    free_at_ = clock_.now() + time;
  }

  const std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  const Clock::Duration gap_;
  const std::string command_end_;
  std::mutex write_mutex_;  ///< Taken before the other.
  std::mutex state_mutex_;
  LineFilter filter_;
  std::optional<Clock::Instant> free_at_;  ///< When the next command is not lost.
};

/// Questions to a controller whose replies come in the order of the commands and do not name them.
///
/// A late reply must not be taken for the answer to the next command. Therefore, once a reply is missing or
/// is none, nothing else is sent before the identity has been answered, whose form is unlike that of any
/// other reply; replies before that belong to earlier commands. Of a reply with several lines the first
/// counts, and the last is awaited. All calls require that the line is locked.
class InOrder {
 public:
  /// @param identity_request  with its end
  InOrder(wire::HaltableLine& line, const StageDescription& description, std::string identity_request)
      : line_(line),
        description_(description),
        identity_(description.identify[0].expect),
        identity_request_(std::move(identity_request)),
        patience_(from_seconds(description.reply_s)) {}

  /// A reply to an earlier command may still arrive.
  void expect_stray_reply() { in_step_ = false; }

  /// Returns once the controller answers as described. @throws InstrumentError kNoReply, kWrongIdentity
  void get_in_step(std::string_view next) {
    if (in_step_) return;
    const auto heard = ask_identity();
    if (in_step_) return;
    throw line_.failure(heard.empty() ? Fault::kNoReply : Fault::kWrongIdentity,
                        fmt::format("no answer to \"{}\" within {} s, before \"{}\"; {}",
                                    shown(identity_request_), to_seconds(patience_), next,
                                    heard.empty() ? "nothing arrived"
                                                  : "what arrived was \"" + wire::printable(heard) + "\""));
  }

  /// Sends the identity query and takes its reply. @return what else was heard
  std::string ask_identity() {
    in_step_ = false;
    identity_reply_.clear();
    line_.send(identity_request_);
    const Clock::Instant deadline = line_.deadline_after(patience_);
    std::string heard;
    while (const auto reply = take(deadline)) {
      if (identity_.match(*reply)) {
        if (!takes_rest_of(*reply, deadline)) break;
        in_step_ = true;
        identity_reply_ = *reply;
        return {};
      }
      if (heard.size() < kLongestLine) heard += *reply + " ";
    }
    return heard + line_.received();
  }
  const std::string& identity_reply() const { return identity_reply_; }

  /// Sends a command and takes its reply; absent: none came in time, or another thread has halted meanwhile.
  std::optional<std::string> exchange(const std::string& command) {
    get_in_step(shown(command));
    line_.discard_input();
    const std::uint64_t halts = line_.halts();
    line_.send(command);
    const Clock::Instant deadline = line_.deadline_after(patience_);
    // A late answer to an earlier identity query is skipped.
    auto reply = take(deadline);
    while (reply && identity_.match(*reply) && takes_rest_of(*reply, deadline)) reply = take(deadline);
    if (!reply || !takes_rest_of(*reply, deadline) || line_.halts() != halts) in_step_ = false;
    return reply;
  }

  static std::string shown(const std::string& command) { return std::string(pieces::trimmed(command)); }

 private:
  /// The next line that is not empty.
  std::optional<std::string> take(Clock::Instant deadline) {
    while (const auto frame = line_.take_frame(deadline))
      if (std::string line = normal_line(*frame); !line.empty()) return line;
    return std::nullopt;
  }

  /// Takes the lines behind the first of a reply; false: the last has not come in time.
  bool takes_rest_of(std::string reply, Clock::Instant deadline) {
    const auto is_last = [&](const std::string& line) {
      return description_.last_line.empty() || description_.last_line.match(line) ||
             std::ranges::any_of(description_.errors, [&](const DescribedFault& error) {
               return error.expect.match(line).has_value();
             });
    };
    while (!is_last(reply)) {
      auto line = take(deadline);
      if (!line) return false;
      reply = *std::move(line);
    }
    return true;
  }

  wire::HaltableLine& line_;
  const StageDescription& description_;
  const ReplyForm& identity_;
  const std::string identity_request_;
  const Clock::Duration patience_;
  std::string identity_reply_;
  bool in_step_ = false;
};

class DescribedController final : public wire::LineController {
 public:
  DescribedController(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings)
      : LineController(settings.description->maker + " stage",
                       std::make_unique<DescribedStream>(std::move(stream), clock, *settings.description),
                       clock, check_line,
                       {stop_bytes(settings), kHaltDeadline,
                        2 * from_seconds(settings.description->reply_s) + std::chrono::milliseconds(500),
                        kHaltRetryInterval}),
        clock_(clock),
        settings_(settings),
        description_(*settings.description),
        of_axes_{description_.for_axis(settings.axis_names[0]),
                 description_.for_axis(settings.axis_names[1])},
        replies_(line(), description_, command_of(description_.identify[0].send, std::nullopt, {})) {}

 private:
  // ---- Commands and replies

  std::string command_of(const CommandForm& form, std::optional<StageAxis> axis,
                         const Numbers& numbers) const {
    FieldValues texts{{"address", settings_.address.empty() ? description_.address : settings_.address}};
    // The identity may be that of an axis: of either.
    const StageAxis any = is_here(StageAxis::kX) ? StageAxis::kX : StageAxis::kZ;
    texts["axis"] = settings_.axis_names[index(axis.value_or(any))];
    return form.with(texts, numbers) + description_.command_end;
  }

  static std::string shown(const std::string& command) { return InOrder::shown(command); }

  static std::string stop_bytes(const StageSettings& settings) {
    return fmt::format("{}",
                       fmt::join(settings.description->stops(settings.axis_names, settings.address), ""));
  }

  /// The description for an axis.
  const StageDescription& of(StageAxis axis) const { return of_axes_[index(axis)]; }

  /// The refusal that a reply is; nothing: it is none.
  std::optional<InstrumentError> refusal(const std::string& reply, std::string_view command,
                                         const std::vector<DescribedFault>& errors) const {
    for (const DescribedFault& error : errors) {
      if (!error.expect.match(reply)) continue;
      return failure(error.fault,
                     fmt::format("{}\"{}\" to \"{}\"", error.says.empty() ? "" : error.says + ": ",
                                 wire::printable(reply), command));
    }
    return std::nullopt;
  }

  /// Asks a question whose reply has one of some forms, at most twice.
  std::string ask(const std::string& command, const std::vector<const ReplyForm*>& forms) {
    for (int attempt = 1;; ++attempt) {
      const auto reply = replies_.exchange(command);
      if (reply) {
        const auto fits = [&](const ReplyForm* form) { return form->match(*reply).has_value(); };
        if (std::any_of(forms.begin(), forms.end(), fits)) return *reply;
        if (const auto refused = refusal(*reply, shown(command), description_.errors))
          throw InstrumentError(*refused);
        replies_.expect_stray_reply();
      } else {
        replies_.get_in_step(shown(command));  // Throws if the controller is silent altogether.
      }
      if (attempt == 1) continue;
      if (reply)
        throw failure(Fault::kBadFrame, fmt::format("\"{}\" is not an answer to \"{}\"",
                                                    wire::printable(*reply), shown(command)));
      throw failure(Fault::kNoReply,
                    fmt::format("no answer to \"{}\" within {} s, asked twice, although \"{}\" is answered",
                                shown(command), description_.reply_s, description_.identify[0].send.text()));
    }
  }

  FieldValues ask(const DescribedExchange& exchange, std::optional<StageAxis> axis) {
    return *exchange.expect.match(ask(command_of(exchange.send, axis, {}), {&exchange.expect}));
  }

  /// The number of a field.
  double number(const FieldValues& values, std::string_view field) const {
    const auto found = values.find(field);
    const auto value =
        found == values.end() ? std::nullopt : pieces::number<double>(pieces::without_plus(found->second));
    if (!value || !std::isfinite(*value))
      throw failure(Fault::kBadFrame, fmt::format("no number for {{{}}} in the reply", field));
    return *value;
  }

  /// Sends a command once. It is acknowledged when this returns.
  void execute(const DescribedExchange& exchange, StageAxis axis, const Numbers& numbers) {
    const std::string command = command_of(exchange.send, axis, numbers);
    if (!exchange.read_back.empty()) {
      replies_.get_in_step(shown(command));
      line().send(command);
      try {
        const FieldValues values =
            *exchange.expect.match(ask(command_of(exchange.read_back, axis, {}), {&exchange.expect}));
        compare(exchange, command, numbers, values);
      } catch (const InstrumentError&) {
        replies_.expect_stray_reply();  // A refusal may have been that of the command.
        throw;
      }
      return;
    }
    if (exchange.silent) return execute_silently(axis, command);
    const auto reply = replies_.exchange(command);
    if (!reply) {
      throw failure(Fault::kNoReply,
                    fmt::format("no reply to \"{}\" within {} s; whether it was accepted is unknown",
                                shown(command), description_.reply_s));
    }
    if (exchange.expect.match(*reply)) return;
    if (const auto refused = refusal(*reply, shown(command), description_.errors))
      throw InstrumentError(*refused);
    replies_.expect_stray_reply();
    throw failure(Fault::kBadFrame,
                  fmt::format("\"{}\" is not a reply to \"{}\"; required: \"{}\"", wire::printable(*reply),
                              shown(command), exchange.expect.text()));
  }

  /// Sends a command without a reply, and asks for the controller's last error, which is then cleared: so it
  /// is asked once.
  void execute_silently(StageAxis axis, const std::string& command) {
    const std::string query = command_of(description_.error_query->send, axis, {});
    // Errors from before, such as that of a command which a halt has spoiled.
    std::optional<std::string> error;
    for (int n = 0; n < kMostOldErrors && (n == 0 || error); ++n)
      error = last_error(query, command, "not sent");
    if (error)
      throw failure(Fault::kNotReady,
                    fmt::format("\"{}\" is still answered \"{}\" after {} questions, so that \"{}\" was not "
                                "sent; required: \"{}\"",
                                shown(query), wire::printable(*error), kMostOldErrors, shown(command),
                                description_.error_query->expect.text()));
    line().send(command);
    error = last_error(query, command, "perhaps not accepted");
    if (error) throw InstrumentError(*refusal(*error, shown(command), description_.queried_errors));
  }

  /// The controller's last error; absent: it has none.
  std::optional<std::string> last_error(const std::string& query, const std::string& command,
                                        std::string_view consequence) {
    const auto reply = replies_.exchange(query);
    if (!reply)
      throw failure(Fault::kNoReply,
                    fmt::format("no answer to \"{}\" within {} s, so that \"{}\" was {}", shown(query),
                                description_.reply_s, shown(command), consequence));
    if (description_.error_query->expect.match(*reply)) return std::nullopt;
    if (refusal(*reply, shown(query), description_.queried_errors)) return reply;
    replies_.expect_stray_reply();
    throw failure(Fault::kBadFrame,
                  fmt::format("\"{}\" is not an answer to \"{}\", so that \"{}\" was {}",
                              wire::printable(*reply), shown(query), shown(command), consequence));
  }

  /// Whether the controller has set what it was sent.
  void compare(const DescribedExchange& exchange, const std::string& command, const Numbers& numbers,
               const FieldValues& values) const {
    for (const auto& [field, sent] : numbers) {
      if (!exchange.send.has(field) || !exchange.expect.has(field)) continue;
      const double found = number(values, field);
      const double allowed = 1.001 * exchange.send.half_place(field) + 1e-6 * std::abs(sent);
      if (std::abs(found - sent) > allowed)
        throw failure(Fault::kRefused,
                      fmt::format("\"{}\" was not accepted: {} is read back as {}, sent was {}",
                                  shown(command), field, found, sent));
    }
  }

  void execute_all(const std::vector<DescribedExchange>& all, StageAxis axis, const Numbers& numbers) {
    for (const DescribedExchange& each : all) execute(each, axis, numbers);
  }

  // ---- Axes

  bool is_here(StageAxis axis) const { return !settings_.axis_names[index(axis)].empty(); }

  void require_here(StageAxis axis) const {
    if (!is_here(axis))
      throw failure(Fault::kNotReady, fmt::format("axis {} is not on this line", to_string(axis)));
  }

  /// Asks once how many units a degree has.
  double units_per_degree(StageAxis axis) {
    std::optional<double>& known = units_per_degree_[index(axis)];
    if (known) return *known;
    if (description_.scale_in_bench) return settings_.units_per_degree[index(axis)].value();
    const std::vector<DescribedExchange>& scale = of(axis).scale;
    if (scale.empty()) return description_.units_per_degree;
    const double per_turn = number(ask(scale[0], axis), "units_per_turn");
    if (!(per_turn > 0.0))
      throw failure(Fault::kWrongIdentity,
                    fmt::format("axis {} has {} units per turn, so it is not a rotary axis", to_string(axis),
                                per_turn));
    known = per_turn / 360.0;
    return *known;
  }

  double speed_on_line(StageAxis axis, double deg_per_s) {
    return deg_per_s * units_per_degree(axis) * description_.speed_factor;
  }

  std::string status(StageAxis axis) {
    std::vector<const ReplyForm*> forms{&of(axis).moving, &of(axis).stopped};
    for (const DescribedFault& fault : of(axis).status_faults) forms.push_back(&fault.expect);
    return ask(command_of(description_.status.send, axis, {}), forms);
  }

  /// A state of the axis that is a fault.
  void require_sound(const std::string& status, StageAxis axis) const {
    for (const DescribedFault& fault : of(axis).status_faults) {
      if (!fault.expect.match(status)) continue;
      throw failure(fault.fault, fmt::format("axis {}: {}", to_string(axis),
                                             fault.says.empty() ? "status \"" + status + "\"" : fault.says));
    }
  }

  /// Whether the axis moves. A reply that is neither motion nor rest is no answer.
  bool moves(const std::string& status, StageAxis axis) const {
    if (of(axis).moving.match(status)) return true;
    if (of(axis).stopped.match(status)) return false;
    throw failure(Fault::kBadFrame, fmt::format("axis {}: status \"{}\" is neither motion nor rest",
                                                to_string(axis), wire::printable(status)));
  }

  /// Sends [[prepare]] once, and sees that it moves nothing.
  void ensure_prepared(StageAxis axis) {
    if (prepared_[index(axis)]) return;
    const double before = encoder_angle(axis).deg();
    execute_all(description_.prepare, axis, {});
    for (int look = 0; look < kLooksAfterPrepare; ++look) {
      if (look > 0 && !description_.prepare.empty()) clock_.sleep_until(clock_.now() + kBetweenLooks);
      const std::string now = status(axis);
      const double turned = std::remainder(encoder_angle(axis).deg() - before, 360.0);
      // A state of all axes may be the motion of the other one.
      const bool is_other = description_.status_of_all && motion_begun_;
      if ((!is_other && moves_or_fault(now, axis)) || std::abs(turned) > kAtRestDeg) {
        line().send(stop_bytes(settings_));
        forget_motion();
        throw failure(
            Fault::kRefused,
            fmt::format("axis {} moved by {:.3f} deg on [[prepare]], before any move was commanded, and "
                        "was halted; required: commands in [[prepare]] that move nothing, as by setting "
                        "the demand to the present position before the mode is entered",
                        to_string(axis), turned));
      }
      require_sound(now, axis);
      if (description_.prepare.empty()) break;
    }
    prepared_[index(axis)] = true;
  }

  bool moves_or_fault(const std::string& status, StageAxis axis) const {
    const bool is_fault =
        std::any_of(of(axis).status_faults.begin(), of(axis).status_faults.end(),
                    [&](const DescribedFault& fault) { return fault.expect.match(status); });
    return of(axis).moving.match(status) || (!is_fault && moves(status, axis));
  }

  bool is_referenced(StageAxis axis) {
    if (description_.always_referenced) return true;
    std::vector<const ReplyForm*> forms;
    for (const ReplyForm& form : of(axis).is_referenced) forms.push_back(&form);
    for (const ReplyForm& form : of(axis).is_not_referenced) forms.push_back(&form);
    const std::string reply = ask(command_of(description_.referenced->send, axis, {}), forms);
    return std::none_of(of(axis).is_not_referenced.begin(), of(axis).is_not_referenced.end(),
                        [&](const ReplyForm& form) { return form.match(reply); });
  }

  void find_travel(StageAxis axis, StageAxisInfo& info) {
    double lower = description_.lower_deg.value_or(0.0), upper = description_.upper_deg.value_or(360.0);
    for (const DescribedExchange& query : of(axis).travel) {
      const FieldValues values = ask(query, axis);
      if (query.expect.has("lower")) lower = number(values, "lower") / units_per_degree(axis);
      if (query.expect.has("upper")) upper = number(values, "upper") / units_per_degree(axis);
    }
    info.travel_min = Angle::degrees(lower);
    info.travel_max = Angle::degrees(upper);
  }

  StageAxisInfo axis_info(StageAxis axis) {
    StageAxisInfo info;
    find_travel(axis, info);
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (speed) {
      info.speed_deg_per_s = *speed;
    } else if (description_.speed) {
      info.speed_deg_per_s = number(ask(*of(axis).speed, axis), "speed") / speed_on_line(axis, 1.0);
    } else if (description_.usual_speed_deg_per_s) {
      info.speed_deg_per_s = *description_.usual_speed_deg_per_s;
    }
    info.referenced = is_referenced(axis);
    return info;
  }

  /// Asks for the identity until the same reply has come twice, as replies have no checksum.
  void find_identity() {
    constexpr int kTries = 4;
    const ReplyForm& form = description_.identify[0].expect;
    std::string last, heard;
    int answers = 0;
    for (int n = 0; n < kTries && (n < 2 || answers > 0 || !heard.empty()); ++n) {
      line().discard_input();
      replies_.expect_stray_reply();
      heard += replies_.ask_identity();
      const std::string& reply = replies_.identity_reply();
      if (reply.empty()) continue;
      if (form.match(reply) == form.match(last)) return;
      last = reply;
      ++answers;
    }
    const std::string asked = description_.identify[0].send.text();
    if (answers > 1)
      throw failure(Fault::kBadFrame,
                    fmt::format("\"{}\" was answered differently each time, last with \"{}\"", asked,
                                wire::printable(last)));
    if (answers == 0 && !heard.empty())
      throw failure(
          Fault::kWrongIdentity,
          fmt::format("\"{}\" is not an answer of {} to \"{}\": another instrument is on this port, or the "
                      "line settings are wrong",
                      wire::printable(heard), description_.maker, asked));
    throw failure(
        Fault::kNoReply,
        fmt::format("{} to \"{}\" within {} s, asked twice and more; is it connected, switched "
                    "on, and set to these line settings?",
                    answers == 0 ? "no answer" : "one answer and no other", asked, description_.reply_s));
  }

  // ---- The calls

  StageInfo identify() override {
    units_per_degree_ = {};
    prepared_ = {};
    speed_set_ = {};
    find_identity();
    StageInfo info;
    info.maker = description_.maker;
    for (std::size_t k = 0; k < description_.identify.size(); ++k) {
      const DescribedExchange& each = description_.identify[k];
      const FieldValues values =
          k == 0 ? *each.expect.match(replies_.identity_reply()) : ask(each, std::nullopt);
      for (const auto& [field, value] : values) {
        if (field == "maker") info.maker = value;
        if (field == "model") info.model = value;
        if (field == "serial") info.serial_number = value;
        if (field == "firmware") info.firmware = value;
      }
    }
    if (!description_.accepts_model(info.model))
      throw failure(Fault::kWrongIdentity,
                    fmt::format("it is a {}, and the description {} is of other models", info.model,
                                description_.source));
    const std::string identity = info.maker + " " + info.model + " " + info.serial_number;
    const auto& tried = description_.tried_with;
    if (!tried.empty() && std::find(tried.begin(), tried.end(), identity) == tried.end())
      throw failure(
          Fault::kWrongIdentity,
          fmt::format("it is \"{}\", and the description was tried with \"{}\"; required: abcal stage "
                      "try with this stage",
                      identity, fmt::join(tried, "\", \"")));
    for (const StageAxis axis : kStageAxes)
      if (is_here(axis)) info.axes[index(axis)] = axis_info(axis);
    std::string who = "stage " + info.maker + " " + info.model;
    if (!info.serial_number.empty()) who += " (SN " + info.serial_number + ")";
    line().rename(who);
    return info;
  }

  void apply_speed(StageAxis axis) {
    const auto& speed = settings_.speed_deg_per_s[index(axis)];
    if (!speed || speed_set_[index(axis)] || description_.usual_speed_deg_per_s) return;
    if (description_.set_speed.empty())
      throw failure(Fault::kRefused, "the description has no [[set_speed]], so its speed cannot be set");
    execute_all(description_.set_speed, axis, {{"speed", speed_on_line(axis, *speed)}});
    speed_set_[index(axis)] = true;
  }

  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    require_here(axis);
    if (!description_.speed && !description_.usual_speed_deg_per_s &&
        !settings_.speed_deg_per_s[index(axis)] && !usual_speed_[index(axis)])
      throw failure(Fault::kRefused,
                    "the description has no [speed], so the present speed is not known; "
                    "required: [speed], or speed_deg_per_s in the bench file");
    replace_speed(settings_.speed_deg_per_s[index(axis)], usual_speed_[index(axis)], deg_per_s,
                  [&] { return axis_info(axis).speed_deg_per_s; });
    speed_set_[index(axis)] = false;
    apply_speed(axis);
  }

  void home(StageAxis axis) override {
    require_here(axis);
    if (description_.referenced_by_hand && !is_referenced(axis))
      throw failure(Fault::kNotReady,
                    fmt::format("axis {} has no reference, and the description {} has no search of it; "
                                "required: the search at the controller, with a person at the stage",
                                to_string(axis), description_.source));
    ensure_prepared(axis);
    apply_speed(axis);
    motion_begun_ = true;
    if (!description_.home.empty()) target_[index(axis)].reset();
    execute_all(description_.home, axis, {});
  }

  void move_to(StageAxis axis, Angle target) override {
    require_here(axis);
    if (!std::isfinite(target.deg()))
      throw failure(Fault::kOutOfTravel,
                    fmt::format("target {} of axis {} is not a number", target.deg(), to_string(axis)));
    StageAxisInfo travel;
    find_travel(axis, travel);
    if (!(target >= travel.travel_min && target <= travel.travel_max))
      throw failure(Fault::kOutOfTravel,
                    fmt::format("axis {} to {:.6f} deg; its limits are {:.6f} to {:.6f} deg", to_string(axis),
                                target.deg(), travel.travel_min.deg(), travel.travel_max.deg()));
    ensure_prepared(axis);
    require_sound(status(axis), axis);
    if (!is_referenced(axis))
      throw failure(Fault::kNotReady, fmt::format("axis {} has no reference; home it", to_string(axis)));
    apply_speed(axis);
    Numbers numbers{{"angle", target.deg() * units_per_degree(axis)}};
    if (description_.usual_speed_deg_per_s)
      numbers["speed"] = speed_on_line(
          axis, settings_.speed_deg_per_s[index(axis)].value_or(*description_.usual_speed_deg_per_s));
    add_targets_of_all(axis, target, numbers);
    if (description_.by_increments)
      numbers["increment"] =
          std::remainder(target.deg() - encoder_angle(axis).deg(), 360.0) * units_per_degree(axis);
    motion_begun_ = true;
    target_[index(axis)].reset();  // Whether a move that fails has begun is not known.
    execute_all(description_.move, axis, numbers);
    target_[index(axis)] = target;
  }

  MotionState motion_state(StageAxis axis) override {
    require_here(axis);
    const std::string now = status(axis);
    if (!description_.status_faults.empty()) {
      try {
        require_sound(now, axis);
      } catch (const InstrumentError&) {
        prepared_[index(axis)] = false;  // Its cause may have switched the servo off.
        throw;
      }
    }
    return moves(now, axis) || has_not_begun(axis) ? MotionState::kMoving : MotionState::kStopped;
  }

  /// Whether the axis is farther from its target than a status of rest allows.
  bool has_not_begun(StageAxis axis) {
    const auto& target = target_[index(axis)];
    if (!description_.window_deg || !target) return false;
    double left_deg = encoder_angle(axis).deg() - target->deg();
    if (description_.wraps) left_deg = std::remainder(left_deg, 360.0);
    return std::abs(left_deg) > *description_.window_deg;
  }

  /// The targets of all axes of the controller, for a command that needs them: an axis that is not to move
  /// keeps its last target, or its angle if it has none.
  void add_targets_of_all(StageAxis axis, Angle target, Numbers& numbers) {
    if (std::ranges::none_of(description_.move, [](const auto& each) { return each.send.has("angles"); }))
      return;
    const std::string reply =
        ask(command_of(description_.position.send, axis, {}), {&of(axis).position.expect});
    for (std::size_t k = 0; k < description_.axis_names.size(); ++k) {
      const std::string& name = description_.axis_names[k];
      double& number_of_axis = numbers[fmt::format("angle{}", k + 1)];
      const auto values = description_.for_axis(name).position.expect.match(reply);
      number_of_axis = number(values.value_or(FieldValues{}), "angle");
      for (const StageAxis each : kStageAxes) {
        if (settings_.axis_names[index(each)] != name) continue;
        if (each == axis) number_of_axis = target.deg() * units_per_degree(axis);
        if (each != axis && target_[index(each)])
          number_of_axis = target_[index(each)]->deg() * units_per_degree(each);
      }
    }
  }

  Angle encoder_angle(StageAxis axis) override {
    require_here(axis);
    const double scale = units_per_degree(axis);
    return Angle::degrees(number(ask(of(axis).position, axis), "angle") / scale);
  }

  // ---- Halt

  void forget_motion() override {
    replies_.expect_stray_reply();
    target_ = {};
    motion_begun_ = false;
  }

  Clock::Duration reply_deadline() const override {
    return from_seconds(description_.reply_s + 2.0 * description_.gap_s);
  }

  HaltReport stopped_axes(const HaltReport& so_far) override {
    HaltReport report = so_far;
    replies_.expect_stray_reply();  // The stop has one.
    for (const StageAxis axis : kStageAxes) {
      AxisHalt& found = report.axes[index(axis)];
      if (!is_here(axis)) found = AxisHalt::kHalted;
      if (found == AxisHalt::kHalted) continue;
      if (says_so([&] { return of(axis).stopped.match(status(axis)).has_value(); }))
        found = AxisHalt::kHalted;
    }
    return report;
  }

  /// The replies also with blanks around them, as normal_line() removes them.
  static ReplyPattern with_blanks(ReplyPattern pattern) {
    for (std::vector<ReplyPart>& parts : pattern.alternatives) {
      parts.insert(parts.begin(), pattern::spaces());
      parts.push_back(pattern::spaces());
    }
    return pattern;
  }

  std::vector<HaltRecipe> halt_recipes() const override {
    HaltRecipe recipe;
    recipe.driver = "described";
    // Where nothing spoils a half-written command, it is carried out, and the stop follows at once.
    recipe.end_partial = description_.spoil + description_.command_end;
    recipe.further_stops = description_.stops(settings_.axis_names, settings_.address);
    recipe.stop = recipe.further_stops.front();
    recipe.further_stops.erase(recipe.further_stops.begin());
    recipe.reply_time = std::chrono::ceil<std::chrono::milliseconds>(from_seconds(description_.reply_s));
    // From a command, whose reply may come as late as the gap is long.
    recipe.gap = std::chrono::ceil<std::chrono::milliseconds>(2 * from_seconds(description_.gap_s));
    // Replies before the identity belong to commands of the owner.
    const DescribedExchange& identity = description_.identify[0];
    recipe.questions.push_back({.bytes = command_of(identity.send, std::nullopt, {}),
                                .reply = with_blanks(identity.expect.pattern()),
                                .standing = {}});
    for (const StageAxis axis : kStageAxes) {
      if (!is_here(axis)) continue;
      ReplyPattern any = of(axis).moving.pattern() | of(axis).stopped.pattern();
      for (const DescribedFault& fault : of(axis).status_faults)
        any = std::move(any) | fault.expect.pattern();
      recipe.axes[index(axis)] = true;
      recipe.questions.push_back({.bytes = command_of(description_.status.send, axis, {}),
                                  .reply = with_blanks(any),
                                  .standing = with_blanks(of(axis).stopped.pattern())});
    }
    return {recipe};
  }

  Clock& clock_;
  StageSettings settings_;
  const StageDescription& description_;            ///< A member of the settings.
  const std::array<StageDescription, 2> of_axes_;  ///< With the places of the axes in replies for all.
  InOrder replies_;
  std::array<std::optional<double>, 2> units_per_degree_{}, usual_speed_{};
  std::array<bool, 2> prepared_{}, speed_set_{};
  std::array<std::optional<Angle>, 2> target_{};  ///< For the last move, until a halt.
  bool motion_begun_ = false;                     ///< Since the last halt.
};

void check_settings(const wire::ByteStream* stream, const StageSettings& settings) {
  if (!settings.description) throw std::invalid_argument("described stage: no description");
  const StageDescription& description = *settings.description;
  wire::check_stage_settings(description.maker, "the name", stream, settings);
  for (const StageAxis axis : kStageAxes)
    if (description.scale_in_bench && !settings.axis_names[index(axis)].empty() &&
        !settings.units_per_degree[index(axis)])
      throw std::invalid_argument(
          fmt::format("{} stage: axis {} without units_per_degree; required: a number, "
                      "as the description {} leaves it to the bench file",
                      description.maker, to_string(axis), description.source));
  for (const std::string& name : settings.axis_names) {
    const auto& known = description.axis_names;
    if (name.empty() || known.empty() || std::find(known.begin(), known.end(), name) != known.end()) continue;
    std::string names;
    for (const std::string& each : known) names += (names.empty() ? "\"" : ", \"") + each + "\"";
    throw std::invalid_argument(
        fmt::format("{} stage: axis \"{}\"; required: {}, as the description {} names them",
                    description.maker, wire::printable(name), names, description.source));
  }
}

}  // namespace

DescribedStage::DescribedStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                               const StageSettings& settings)
    : LineStage((check_settings(stream.get(), settings),
                 std::make_unique<DescribedController>(std::move(stream), clock, settings))) {}

}  // namespace abcal::described
