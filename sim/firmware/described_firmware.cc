#include "sim/firmware/described_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "sim/firmware/reply_queue.h"

namespace abcal::sim {
namespace {

constexpr std::size_t kLongestDescribedCommand = 1024;
constexpr Clock::Duration kShortestSearch = std::chrono::milliseconds(200);
/// Units of a degree where the scale is asked for.
constexpr double kUnitsOfADegree = 1000.0;
/// A target that is sent again differs by less than this.
constexpr double kSameTargetDeg = 1e-3;

double field_number(const FieldValues& values, std::string_view field) {
  const auto found = values.find(field);
  return found == values.end() ? 0.0
                               : pieces::number<double>(pieces::without_plus(found->second)).value_or(0.0);
}

}  // namespace

class DescribedFirmware::Controller final : public Firmware {
 public:
  Controller(std::shared_ptr<SimBench> bench, std::shared_ptr<const StageDescription> description,
             DescribedSettings settings, UnservedCommands& unserved)
      : bench_(std::move(bench)),
        description_(std::move(description)),
        settings_(std::move(settings)),
        unserved_(unserved) {
    for (const int sign : settings_.sign)
      if (sign != 1 && sign != -1)
        throw std::invalid_argument("simulated described stage: a sign is not 1 or -1");
    now_ = bench_->start();
    texts_["address"] = {settings_.address.empty() ? description_->address : settings_.address};
    for (const std::string& name : settings_.axis_names)
      if (!name.empty()) texts_["axis"].push_back(name);
    for (const std::string& stop : description_->stops(settings_.axis_names, settings_.address))
      halt_ += stop;
    halt_ = pieces::trimmed(std::string(halt_));
    power_on();
  }

  void receive(std::string_view bytes, Clock::Instant now) override {
    now_ = std::max(now_, now);
    // A halt without an end works at once, also in the middle of a command.
    if (!description_->halt.ends_with(description_->command_end) && !halt_.empty()) {
      for (std::size_t at = bytes.find(halt_); at != std::string_view::npos; at = bytes.find(halt_)) {
        read(bytes.substr(0, at));
        halt_all();
        line_.clear();
        bytes.remove_prefix(at + halt_.size());
      }
    }
    read(bytes);
  }
  std::string transmit(Clock::Instant now) override {
    now_ = std::max(now_, now);
    return replies_.take(now);
  }
  std::optional<Clock::Instant> next_due() const override { return replies_.next_due(); }
  void session_starts() override {
    line_.clear();
    replies_.clear();
  }
  void power(bool on, Clock::Instant now) override {
    now_ = std::max(now_, now);
    session_starts();
    on ? power_on() : halt_all();
  }
  std::optional<unsigned> line_speed() const override { return description_->baud; }

 private:
  struct Axis {
    bool prepared = false;
    bool referenced = false;
    std::optional<Clock::Instant> searches_until;
  };

  void read(std::string_view bytes) {
    for (const char c : bytes) {
      line_ += c;
      if (line_.ends_with(description_->command_end)) {
        if (description_->echoes) replies_.push(line_, now_);
        line_.resize(line_.size() - description_->command_end.size());
        take(std::string(pieces::trimmed(std::exchange(line_, {}))));
      } else if (line_.size() > kLongestDescribedCommand) {
        line_.clear();
      }
    }
  }

  void power_on() {
    for (std::size_t k = 0; k < 2; ++k) {
      axes_[k] = {description_->prepare.empty(),
                  description_->always_referenced || description_->referenced_by_hand, std::nullopt};
      MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
      limits.speed_deg_per_s = bench_->stage().axis(kStageAxes[k]).speed_deg_per_s;
      bench_->set_motion_limits(kStageAxes[k], limits);
    }
  }

  void halt(std::size_t k) {
    axes_[k].searches_until.reset();
    if (bench_->moving(kStageAxes[k], now_)) bench_->halt(kStageAxes[k], now_);
  }
  void halt_all() {
    for (std::size_t k = 0; k < 2; ++k) halt(k);
  }

  double units(std::size_t k) const {
    if (description_->scale_in_bench) return settings_.units_per_degree[k].value_or(kUnitsOfADegree);
    return description_->scale.empty() ? description_->units_per_degree : kUnitsOfADegree;
  }
  double controller_deg(std::size_t k, Angle protocol) const {
    return settings_.zero[k].deg() + settings_.sign[k] * protocol.deg();
  }
  Angle protocol_angle(std::size_t k, double controller) const {
    return Angle::degrees(settings_.sign[k] * (controller - settings_.zero[k].deg()));
  }

  /// Homing ends with the reference.
  void advance() {
    for (std::size_t k = 0; k < 2; ++k) {
      Axis& axis = axes_[k];
      const bool stands = !bench_->moving(kStageAxes[k], now_);
      if (axis.searches_until && now_ >= *axis.searches_until && stands) {
        axis.referenced = true;
        axis.searches_until.reset();
      }
      if (bench_->fault_at(FaultKind::kLostReference, now_, kStageAxes[k])) axis.referenced = false;
    }
  }

  void take(const std::string& command) {
    if (command.empty()) return;
    const Clock::Duration gap = from_seconds(description_->gap_s) - std::chrono::milliseconds(1);
    const bool is_lost = traffic_ && gap > Clock::Duration::zero() && now_ < *traffic_ + gap;
    traffic_ = now_;
    if (is_lost) {
      unserved_.note(command, "sent earlier than gap_s: lost");
      return;
    }
    advance();
    const auto halted = axis_of_halt(command);
    if (command == halt_ || halted) {
      halted ? halt(*halted) : halt_all();
      if (!description_->halt_reply.empty()) answer(description_->halt_reply.reply({}));
      return;
    }
    if (!carry_out(command)) {
      unserved_.note(command, "not in the description");
      if (description_->emulator_unknown.empty()) return;
      if (description_->error_query) {
        errors_.push_back(description_->emulator_unknown);
      } else {
        answer(description_->emulator_unknown);
      }
    }
  }

  /// A stop of each axis is a command for each.
  std::optional<std::size_t> axis_of_halt(const std::string& command) const {
    if (!CommandForm(description_->halt).has("axis")) return std::nullopt;
    for (std::size_t k = 0; k < 2; ++k) {
      const std::string& name = settings_.axis_names[k];
      if (!name.empty() &&
          command == pieces::trimmed(description_->stops({name, ""}, settings_.address).front()))
        return k;
    }
    return std::nullopt;
  }

  void answer(const std::string& reply) {
    const Clock::Instant due = now_ + settings_.reply_delay;
    const ReplyForm& last = description_->last_line;
    const bool is_error = std::ranges::any_of(description_->errors, [&](const DescribedFault& error) {
      return error.expect.match(reply).has_value();
    });
    const bool has_more = !last.empty() && !last.match(reply) && !is_error;
    replies_.push(reply + "\r\n" + (has_more ? last.reply({}) + "\r\n" : ""), due);
    traffic_ = due;
  }

  /// The reply of a refusal; or that to the next question for the last error, if the command has no reply.
  void refuse(const DescribedExchange& exchange, Fault fault) {
    const std::vector<DescribedFault>& all =
        exchange.silent ? description_->queried_errors : description_->errors;
    if (all.empty()) return;
    const auto same =
        std::ranges::find_if(all, [&](const DescribedFault& error) { return error.fault == fault; });
    const std::string reply = (same == all.end() ? all.front() : *same).expect.reply({});
    if (!exchange.silent) return answer(reply);
    errors_.push_back(reply);
  }

  /// The reply to a question, from that for an axis: a reply for all axes has one for each place.
  template <class ReplyOfAxis>
  std::string reply_to(const ReplyForm& form, std::size_t k, const ReplyOfAxis& reply_of) const {
    if (!form.has_places()) return reply_of(k, false);
    std::vector<std::string> items;
    for (const std::string& name : description_->axis_names) {
      const bool is_z = name == settings_.axis_names[1], is_x = name == settings_.axis_names[0];
      items.push_back(is_x || is_z ? reply_of(is_z ? 1U : 0U, true) : form.item().reply({}));
    }
    return form.reply_of(items);
  }

  FieldValues identity() const {
    FieldValues values = description_->emulator_values;
    values.try_emplace("maker", description_->maker);
    if (!values.contains("model")) {
      std::string model = description_->models.empty() ? "" : description_->models.front();
      std::erase(model, '*');
      if (model.empty()) model = "1";
      values["model"] = model;
    }
    values["serial"] = settings_.serial_number;
    values.try_emplace("firmware", "1");
    return values;
  }

  /// The axis that a command names; X of one without a name.
  std::size_t axis_of(const FieldValues& values) const {
    const auto name = values.find("axis");
    if (name != values.end() && name->second == settings_.axis_names[1]) return 1;
    return settings_.axis_names[0].empty() ? 1 : 0;
  }

  /// @return false: no command of the description
  bool carry_out(const std::string& command) {
    for (const DescribedExchange& each : description_->identify)
      if (each.send.match(command, texts_)) return answer(each.expect.reply(identity())), true;
    if (description_->error_query && description_->error_query->send.match(command, texts_)) {
      answer(errors_.empty() ? description_->error_query->expect.reply({}) : errors_.front());
      if (!errors_.empty()) errors_.pop_front();
      return true;
    }
    if (const auto values = description_->status.send.match(command, texts_)) {
      if (description_->status_of_all) return answer(state_of_all(command)), true;
      answer(reply_to(description_->stopped, axis_of(*values),
                      [&](std::size_t k, bool is_item) { return state_of(k, command, is_item); }));
      return true;
    }
    if (description_->referenced) {
      if (const auto values = description_->referenced->send.match(command, texts_)) {
        answer(reply_to(
            description_->is_referenced.front(), axis_of(*values),
            [&](std::size_t k, bool is_item) { return part_of(reference_of(k), is_item).reply({}); }));
        return true;
      }
    }
    std::vector<DescribedExchange> questions = description_->travel;
    questions.push_back(description_->position);
    questions.insert(questions.end(), description_->scale.begin(), description_->scale.end());
    if (description_->speed) questions.push_back(*description_->speed);
    for (const DescribedExchange& each : questions) {
      const auto values = each.send.match(command, texts_);
      if (!values) continue;
      answer(reply_to(each.expect, axis_of(*values), [&](std::size_t k, bool is_item) {
        return part_of(each.expect, is_item).reply(numbers_of(k));
      }));
      return true;
    }
    return change(command);
  }

  static ReplyForm part_of(const ReplyForm& form, bool is_item) { return is_item ? form.item() : form; }

  const ReplyForm& reference_of(std::size_t k) const {
    return (axes_[k].referenced ? description_->is_referenced : description_->is_not_referenced).front();
  }

  /// The reply to the question for the state. One question may be that for the reference as well: its reply
  /// says both.
  std::string state_of(std::size_t k, const std::string& command, bool is_item) {
    const bool moves = bench_->moving(kStageAxes[k], now_) || axes_[k].searches_until;
    const ReplyForm& whole = moves ? description_->moving : description_->stopped;
    const ReplyForm motion = part_of(whole, is_item);
    std::string reply = motion.reply(numbers_of(k));
    if (!description_->referenced || !description_->referenced->send.match(command, texts_)) return reply;
    const ReplyForm reference = part_of(reference_of(k), is_item);
    if (reference.match(reply)) return reply;
    const auto [known, is_new] = common_.try_emplace({&whole, &reference_of(k)});
    if (is_new) known->second = common_reply(motion.pattern(), reference.pattern());
    return known->second.value_or(reply);
  }

  /// The reply of a controller that reports one state for all axes.
  std::string state_of_all(const std::string& command) {
    bool moves = false, referenced = true;
    for (std::size_t k = 0; k < 2; ++k) {
      if (settings_.axis_names[k].empty()) continue;
      moves = moves || bench_->moving(kStageAxes[k], now_) || axes_[k].searches_until;
      referenced = referenced && axes_[k].referenced;
    }
    const ReplyForm& state = moves ? description_->moving : description_->stopped;
    const bool asks_position = description_->position.send.match(command, texts_).has_value();
    const bool asks_reference =
        description_->referenced && description_->referenced->send.match(command, texts_);
    // At rest without a reference the reply says so.
    const ReplyForm& said =
        asks_reference && !moves && !referenced ? description_->is_not_referenced.front() : state;
    if (asks_position)
      return common_reply(said.pattern(), position_now().pattern()).value_or(state.reply({}));
    return said.reply({});
  }

  /// The form of the reply with the angles, which are those of now.
  ReplyForm position_now() const {
    const ReplyForm& form = description_->position.expect;
    std::string text = form.text();
    if (!form.has_places()) {
      const std::size_t at = text.find("{angle}");
      return ReplyForm(
          text.replace(at, std::string_view("{angle}").size(), numbers_of(axis_of({})).at("angle")));
    }
    const std::size_t begin = text.find("{before"), end = text.find('}', text.find("{after")) + 1;
    const ReplyForm angles(text.substr(begin, end - begin));
    const std::string written = reply_to(
        angles, axis_of({}), [&](std::size_t k, bool) { return angles.item().reply(numbers_of(k)); });
    return ReplyForm(text.replace(begin, end - begin, written));
  }

  std::string number(double value) const { return fmt::format("{:.6f}", value); }

  /// All numbers of an axis, in the units of the line.
  FieldValues numbers_of(std::size_t k) const {
    const StageAxis axis = kStageAxes[k];
    double angle = controller_deg(k, bench_->encoder_angle(axis, now_));
    if (description_->wraps) angle -= 360.0 * std::floor(angle / 360.0);
    const double one = controller_deg(k, bench_->stage().axis(axis).travel_min);
    const double other = controller_deg(k, bench_->stage().axis(axis).travel_max);
    const double speed = bench_->motion_limits(axis).speed_deg_per_s * units(k) * description_->speed_factor;
    return {{"angle", number(angle * units(k))},
            {"lower", number(std::min(one, other) * units(k))},
            {"upper", number(std::max(one, other) * units(k))},
            {"speed", number(speed)},
            {"units_per_turn", number(360.0 * units(k))}};
  }

  /// A command that changes something, or the question that reads it back.
  bool change(const std::string& command) {
    using Change = bool (Controller::*)(std::size_t, const DescribedExchange&, const FieldValues&);
    const std::array<std::pair<const std::vector<DescribedExchange>*, Change>, 4> all{
        std::pair{&description_->prepare, &Controller::prepare},
        std::pair{&description_->home, &Controller::home}, std::pair{&description_->move, &Controller::move},
        std::pair{&description_->set_speed, &Controller::set_speed}};
    for (const auto& [exchanges, carry_it_out] : all) {
      for (const DescribedExchange& each : *exchanges) {
        if (!each.read_back.empty()) {
          if (const auto values = each.read_back.match(command, texts_)) {
            FieldValues numbers = numbers_of(axis_of(*values));
            if (const auto set = set_.find(each.send.text()); set != set_.end())
              for (const auto& [field, value] : set->second) numbers.insert_or_assign(field, value);
            answer(each.expect.reply(numbers));
            return true;
          }
        }
        const auto values = each.send.match(command, texts_);
        if (!values) continue;
        if (!(this->*carry_it_out)(axis_of(*values), each, *values)) return true;
        set_[each.send.text()] = *values;
        if (each.read_back.empty() && !each.silent) answer(each.expect.reply({}));
        return true;
      }
    }
    return false;
  }

  bool prepare(std::size_t k, const DescribedExchange&, const FieldValues&) {
    return axes_[k].prepared = true;
  }

  bool home(std::size_t k, const DescribedExchange& exchange, const FieldValues&) {
    if (!is_ready(k, exchange)) return false;
    if (exchange.send.text() != description_->home.back().send.text()) return true;
    axes_[k].referenced = false;
    axes_[k].searches_until = now_ + kShortestSearch;
    bench_->move(kStageAxes[k], protocol_angle(k, 0.0), now_);
    return true;
  }

  bool move(std::size_t k, const DescribedExchange& exchange, const FieldValues& values) {
    if (exchange.send.has("angles")) return move_all(exchange, values);
    const bool has_angle = exchange.send.has("angle"), has_increment = exchange.send.has("increment");
    if (!has_angle && !has_increment) return true;
    if (!is_ready(k, exchange)) return false;
    if (!axes_[k].referenced) return refuse(exchange, Fault::kNotReady), false;
    const StageAxis axis = kStageAxes[k];
    const double here = controller_deg(k, bench_->commanded_angle(axis, now_));
    const double wanted = field_number(values, has_angle ? "angle" : "increment") / units(k);
    double target = has_increment ? here + wanted : wanted;
    if (has_angle && description_->wraps) target = here + std::remainder(wanted - here, 360.0);
    const Angle protocol = protocol_angle(k, target);
    const AxisTruth& truth = bench_->stage().axis(axis);
    if (!description_->wraps && !(protocol >= truth.travel_min && protocol <= truth.travel_max))
      return refuse(exchange, Fault::kOutOfTravel), false;
    if (exchange.send.has("speed") && !set_speed(k, exchange, values)) return false;
    bench_->move(axis, protocol, now_);
    return true;
  }

  /// A move with the targets of all axes: those whose target is new begin to move.
  bool move_all(const DescribedExchange& exchange, const FieldValues& values) {
    const std::vector<std::string_view> words = pieces::words(values.at("angles"));
    const auto& names = description_->axis_names;
    if (words.size() != names.size()) return refuse(exchange, Fault::kRefused), false;
    std::array<std::optional<Angle>, 2> targets;
    for (std::size_t k = 0; k < 2; ++k) {
      const auto place = std::ranges::find(names, settings_.axis_names[k]);
      if (place == names.end()) continue;
      const double wanted = field_number(
          {{"angle", std::string(words[static_cast<std::size_t>(place - names.begin())])}}, "angle");
      const Angle target = protocol_angle(k, wanted / units(k));
      if (std::abs(target.deg() - bench_->target(kStageAxes[k], now_).deg()) < kSameTargetDeg) continue;
      const AxisTruth& truth = bench_->stage().axis(kStageAxes[k]);
      if (!is_ready(k, exchange)) return false;
      if (!axes_[k].referenced) return refuse(exchange, Fault::kNotReady), false;
      if (!(target >= truth.travel_min && target <= truth.travel_max))
        return refuse(exchange, Fault::kOutOfTravel), false;
      targets[k] = target;
    }
    for (std::size_t k = 0; k < 2; ++k)
      if (targets[k]) bench_->move(kStageAxes[k], *targets[k], now_);
    return true;
  }

  bool set_speed(std::size_t k, const DescribedExchange& exchange, const FieldValues& values) {
    if (!exchange.send.has("speed")) return true;
    const double speed = field_number(values, "speed") / units(k) / description_->speed_factor;
    if (!(speed > 0.0)) return refuse(exchange, Fault::kRefused), false;
    MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    limits.speed_deg_per_s = speed;
    bench_->set_motion_limits(kStageAxes[k], limits);
    return true;
  }

  bool is_ready(std::size_t k, const DescribedExchange& exchange) {
    if (bench_->fault_at(FaultKind::kRefusedMove, now_, kStageAxes[k]))
      return refuse(exchange, Fault::kRefused), false;
    if (!axes_[k].prepared) return refuse(exchange, Fault::kNotReady), false;
    return true;
  }

  const std::shared_ptr<SimBench> bench_;
  const std::shared_ptr<const StageDescription> description_;
  const DescribedSettings settings_;
  UnservedCommands& unserved_;
  Clock::Instant now_;
  std::map<std::string, std::vector<std::string>> texts_;
  std::string halt_;  ///< Without its end.
  std::string line_;
  ReplyQueue replies_;
  std::optional<Clock::Instant> traffic_;
  std::array<Axis, 2> axes_;
  std::deque<std::string> errors_;  ///< Replies to the question for the last error.
  /// Replies that are of two forms; none if there is none.
  std::map<std::pair<const ReplyForm*, const ReplyForm*>, std::optional<std::string>> common_;
  std::map<std::string, FieldValues> set_;  ///< By the command: what it set last.
};

DescribedFirmware::DescribedFirmware(std::shared_ptr<SimBench> bench,
                                     std::shared_ptr<const StageDescription> description,
                                     DescribedSettings settings) {
  encase(std::make_unique<Controller>(std::move(bench), std::move(description), std::move(settings),
                                      unserved()));
}

}  // namespace abcal::sim
