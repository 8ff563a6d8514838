#include "app/console/live_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <set>
#include <utility>

#include "app/console/flag_words.h"
#include "app/console/visible_text.h"
#include "app/document/json_text.h"
#include "app/measure/guard/guarded_stage.h"
#include "app/results/analysis/result_json.h"
#include "drivers/text/names.h"
#include "protocol/estimators/circle/harmonic_fit.h"
#include "protocol/plan/faces.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"
#include "protocol/statistics/median.h"

namespace abcal::console {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kKeptStrip = 400;  // groups of readings: 20 s
constexpr std::size_t kKeptLog = 200;    // lines
constexpr std::size_t kIntervals = 15;   // their median gives the remaining time

Json degrees(const std::optional<Angle>& angle) {
  return json_number(angle ? std::optional(angle->deg()) : std::nullopt);
}
Json vector(const Eigen::Vector3d& v) {
  return Json::array({json_number(v[0]), json_number(v[1]), json_number(v[2])});
}

constexpr auto kActivities = names<Activity>({{Activity::kIdle, "idle"},
                                              {Activity::kChecking, "checking"},
                                              {Activity::kRunning, "running"},
                                              {Activity::kJogging, "jogging"},
                                              {Activity::kAnalysing, "analysing"}});

constexpr auto kGrades = names<LogLine::Grade>({{LogLine::Grade::kInfo, "info"},
                                                {LogLine::Grade::kWarning, "warning"},
                                                {LogLine::Grade::kProblem, "problem"}});

Json stage_json(const StageSeen& seen) {
  return {{"encoder_deg", degrees(seen.encoder)}, {"target_deg", degrees(seen.target)}};
}

Json activity_json(const ActivitySeen& seen) {
  return {{"activity", kActivities.of(seen.activity)},
          {"hold_asked", seen.hold_asked},
          {"stop_asked", seen.stop_asked}};
}

Json halt_json(const HaltSeen& seen) {
  const auto word = [&](StageAxis axis) {
    return seen.report.axes[index(axis)] == AxisHalt::kHalted ? "halted" : "unreachable";
  };
  return {{"axes", {{"x", word(StageAxis::kX)}, {"z", word(StageAxis::kZ)}}},
          {"took_s", json_number(seen.took_s)},
          {"since", format_utc(seen.since)}};
}

Json fault_json(const FaultSeen& seen) {
  return {{"instrument", seen.instrument},
          {"fault", seen.fault},
          {"words", seen.words.english()},
          {"messages", messages_json({seen.words})}};
}

Message verdict_word(const FinishedEvent& end) {
  static constexpr std::array<Term, 3> kVerdicts{"usable", "doubtful", "not usable"};
  return word_of(kVerdicts, end.verdict);
}

/// How a run ended, in words: the verdict and its reason, or the cause of the interruption.
Json outcome_json(const FinishedEvent& end) {
  Message words = end.reason;
  if (end.complete)
    words = end.verdict.empty() ? Message() : Message("{verdict}: {reason}", verdict_word(end), end.reason);
  return {{"words", words.english()}, {"messages", messages_json({words})}};
}

Json ended_json(const FinishedEvent& end) {
  Json json = to_json_object(end);
  json["outcome"] = outcome_json(end);
  return json;
}

Json interrupted_json(const InterruptedRun& run) {
  return {{"file", run.file},
          {"words", run.words.english()},
          {"measured", run.measured},
          {"planned", run.planned},
          {"angle", run.angle.english()},
          {"messages", messages_json({run.words, run.angle})},
          {"items", run.items},
          {"acknowledged_by", run.acknowledged_by},
          {"acknowledged_utc", run.acknowledged_utc}};
}

/// How long a phase may last before the run gives up.
struct TimeLimit {
  double seconds = 0.0;  ///< In the time of the bench.
  Term words;            ///< Its consequence or its reference, for people.
};

std::optional<TimeLimit> limit_of(RunPhase phase, const ProtocolConfig& protocol) {
  switch (phase) {
    case RunPhase::kHoming:
      return TimeLimit{protocol.homing_timeout_s, "for each axis"};
    case RunPhase::kMoving:
    case RunPhase::kParking:
      return TimeLimit{protocol.motion_timeout_s, "beyond the time that the speed of the stage needs"};
    case RunPhase::kSettling:
      return TimeLimit{(protocol.settle_auto ? 0.0 : protocol.settle_s) + protocol.quiet_timeout_s,
                       "until the angle is flagged"};
    case RunPhase::kDwelling:
      return TimeLimit{protocol.reading_timeout_s, "without any reading"};
    case RunPhase::kReconnecting:
      return TimeLimit{protocol.replug_timeout_s, "until the run ends and can be resumed"};
    case RunPhase::kWarmingUp:
      return TimeLimit{protocol.warm_up_s, "of warming up"};
    case RunPhase::kTemperature:
      return TimeLimit{protocol.stability_timeout_s, "for outputs and temperature to be stable"};
    case RunPhase::kHolding:
      return std::nullopt;
  }
  return std::nullopt;
}

/// The log line of an event of a session, if the event has one.
struct LineOf {
  using Line = std::optional<LogLine>;
  Line operator()(const RunBeganEvent& began) const {
    if (!began.resumed)
      return info(Message("Run {run} begins: {angles} angles.", began.file, began.plan.size()));
    return info(Message("Run {run} continues: {measured} of {planned} angles are measured.", began.file,
                        began.measured.size(), began.plan.size()));
  }
  Line operator()(const FlagEvent& flag) const { return warning(flag.text); }
  Line operator()(const PortLostEvent& lost) const { return warning(lost.text); }
  Line operator()(const PortBackEvent& back) const { return warning(back.text); }
  Line operator()(const NoticeEvent& notice) const {
    return notice.kind == kGuardEvent ? info(notice.text) : warning(notice.text);
  }
  Line operator()(const NoteStoredEvent& note) const {
    return info(Message("Note, stored in the event log: {note}", note.text));
  }
  Line operator()(const FinishedEvent& end) const {
    if (end.measured_before)
      return info(
          Message("All angles of run {run} were measured already; it is closed and analysed now: {verdict}.",
                  end.file, verdict_word(end)));
    if (!end.complete) return std::nullopt;
    if (end.verdict.empty()) return info(Message("Run {run} is complete: a levelling.", end.file));
    return info(Message("Run {run} is complete: {verdict}.", end.file, verdict_word(end)));
  }
  template <class Other>
  Line operator()(const Other&) const {
    return std::nullopt;
  }

 private:
  static Line info(Message text) { return LogLine{LogLine::Grade::kInfo, std::move(text)}; }
  static Line warning(Message text) { return LogLine{LogLine::Grade::kWarning, std::move(text)}; }
};

/// Whether an event needs no message: pages know it from the phase or the activity, and see no replay.
bool needs_no_message(const SessionEvent& event) {
  return std::holds_alternative<AngleBegunEvent>(event) || std::holds_alternative<HeldEvent>(event) ||
         std::holds_alternative<ContinuedEvent>(event) || std::holds_alternative<AllMeasuredEvent>(event) ||
         std::holds_alternative<ReplayComparedEvent>(event);
}

/// The text of a message. Replaces bytes that are not UTF-8, which instruments may report.
std::string text_of(const Json& message) {
  return with_visible_direction_controls(json_text(message));
}

}  // namespace

nlohmann::ordered_json findings_json(const std::vector<Finding>& findings) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const Finding& finding : findings) {
    list.push_back({{"grade", to_string(finding.grade)},
                    {"what", finding.what.english()},
                    {"found", finding.found.english()},
                    {"advice", finding.advice.english()},
                    {"messages", messages_json({finding.what, finding.found, finding.advice})}});
  }
  return list;
}

LiveView::LiveView(const nlohmann::ordered_json& about, const Clock& clock) : about_(about), clock_(clock) {
  about_["flags"] = flag_words();
}

std::string LiveView::apply(const Event& event, Clock::UtcTime seen) {
  Json message = std::visit([this](const auto& each) { return on(each); }, event);
  if (message.is_null()) return {};
  const auto* of_session = std::get_if<SessionEvent>(&event);
  if (of_session != nullptr && std::holds_alternative<RunBeganEvent>(*of_session)) return snapshot();
  if (of_session != nullptr && std::holds_alternative<DwellDoneEvent>(*of_session))
    message["told_us"] = std::chrono::floor<std::chrono::microseconds>(seen).time_since_epoch().count();
  return text_of(message);
}

Json LiveView::on(const SessionEvent& event) {
  // The small turn of a check belongs to no run.
  const bool is_dwell = std::holds_alternative<DwellDoneEvent>(event);
  if (is_dwell && (activity_.activity != Activity::kRunning || !run_)) return nullptr;
  if (needs_no_message(event)) return nullptr;
  const Json more = std::visit([this](const auto& each) { return fold(each); }, event);
  Json message = to_json_object(event);
  message.update(more);
  if (const auto line = std::visit(LineOf{}, event)) message["line"] = keep(*line);
  if (std::holds_alternative<PhaseEvent>(event)) phase_ = message;
  return message;
}

Json LiveView::on(const ActivitySeen& seen) {
  // The readings start again, and their time starts at zero.
  if (seen.activity == Activity::kChecking && activity_.activity != Activity::kChecking) strip_.clear();
  if (activity_.activity == Activity::kIdle && seen.activity != Activity::kIdle) {
    fault_.reset();
    halt_.reset();
  }
  activity_ = seen;
  if (seen.activity == Activity::kIdle) phase_ = nullptr;
  Json message = activity_json(seen);
  message["type"] = "activity";
  return message;
}

Json LiveView::on(const BenchOpened& opened) {
  bench_ = opened;
  return nullptr;
}

// ---- The run

Json LiveView::fold(const RunBeganEvent& began) {
  run_ = began;
  run_->measured.clear();
  for (const DwellDoneEvent& done : began.measured) store(done);
  phase_ = nullptr;
  ended_.reset();
  interrupted_.reset();
  strip_.clear();
  last_dwell_.reset();
  dwell_intervals_s_.clear();
  return Json::object();
}

Json LiveView::fold(const PhaseEvent& phase) {
  if (phase.phase == RunPhase::kHolding) last_dwell_.reset();
  const auto limit = limit_of(phase.phase, bench_.protocol);
  return {{"limit_s", json_number(limit ? std::optional(limit->seconds) : std::nullopt)},
          {"limit_words", limit ? Json(limit->words.english()) : Json(nullptr)},
          {"limit_simulated", limit && bench_.simulated_time}};
}

/// @return whether the angle is new; one that is measured again replaces the earlier one
bool LiveView::store(const DwellDoneEvent& done) {
  std::vector<DwellDoneEvent>& measured = run_->measured;
  const auto at = std::ranges::lower_bound(measured, done.position, {}, &DwellDoneEvent::position);
  if (at != measured.end() && at->position == done.position) {
    *at = done;
    return false;
  }
  measured.insert(at, done);
  return true;
}

Json LiveView::fold(const DwellDoneEvent& done) {
  if (store(done))
    for (ItemSummary& item : run_->items)
      if (done.dwells.contains(item.k)) ++item.measured;
  const Clock::Instant now = clock_.now();
  if (last_dwell_) {
    dwell_intervals_s_.push_back(to_seconds(now - *last_dwell_));
    if (dwell_intervals_s_.size() > kIntervals) dwell_intervals_s_.pop_front();
  }
  last_dwell_ = now;
  return {{"fit", fit_of(done.first().experiment)}, {"progress", progress()}};
}

Json LiveView::fold(const NoticeEvent& notice) {
  if (notice.kind == kGuardEvent) guard_ = notice.text;
  if (run_ && notice.kind == kItemDroppedEvent)
    for (ItemSummary& item : run_->items)
      if (item.k == notice.item) item.missing = notice.text;
  return Json::object();
}

Json LiveView::fold(const FinishedEvent& end) {
  ended_ = end;
  interrupted_.reset();
  if (!end.complete && run_) {
    std::set<std::size_t> measured;
    for (const DwellDoneEvent& done : run_->measured) measured.insert(done.position);
    interrupted_ = describe_interrupted(end.file, end.reason, run_->plan, measured);
    if (!run_->items.empty())
      interrupted_->items = static_cast<std::size_t>(
          std::ranges::count_if(run_->items, [](const ItemSummary& item) { return item.missing.empty(); }));
  }
  return {{"outcome", outcome_json(end)},
          {"interrupted", interrupted_ ? interrupted_json(*interrupted_) : Json(nullptr)}};
}

/// The one-harmonic curve through the angles of an experiment that are measured so far. It is that of the
/// item measured last, as the first of several may have been dropped.
Json LiveView::fit_of(int experiment) const {
  std::vector<Angle> alpha;
  std::array<std::vector<double>, 3> readings;
  for (const DwellDoneEvent& done : run_->measured) {
    const DwellRecord& dwell = done.first();
    if (done.first_item() != run_->measured.back().first_item()) continue;
    if (dwell.experiment != experiment || dwell.closing || !dwell.mean.allFinite()) continue;
    alpha.push_back(angle_in_face_1(dwell.experiment, dwell.face, dwell.alpha));
    for (std::size_t j = 0; j < 3; ++j) readings[j].push_back(dwell.mean[static_cast<Eigen::Index>(j)]);
  }
  Json outputs = Json::array();
  for (const std::vector<double>& output : readings) {
    try {
      const HarmonicFit fit = fit_harmonics(alpha, output, {}, 1);
      outputs.push_back({{"constant", json_number(fit.coefficients[0])},
                         {"sine", json_number(fit.coefficients[1])},
                         {"cosine", json_number(fit.coefficients[2])},
                         {"residual_rms", json_number(std::sqrt(fit.residual_sum_squares /
                                                                static_cast<double>(alpha.size())))}});
    } catch (const UndeterminedFit&) {
      outputs.push_back(nullptr);  // Too few angles so far.
    }
  }
  return {{"experiment", experiment}, {"outputs", std::move(outputs)}};
}

/// The ratio of simulated time to real time.
double LiveView::pace() const {
  return run_->simulated_time ? about_.value("pace", 1.0) : 1.0;
}

Json LiveView::progress() const {
  const std::size_t total = run_->plan.size();
  const std::size_t measured = run_->measured.size();
  Json remaining = nullptr;
  if (total > 0) {
    const auto missing = static_cast<double>(total - std::min(total, measured));
    double each = run_->estimated_s / pace() / static_cast<double>(total);
    if (dwell_intervals_s_.size() >= 3) each = median({dwell_intervals_s_.begin(), dwell_intervals_s_.end()});
    remaining = json_number(missing * each);
  }
  return {{"measured", measured}, {"total", total}, {"left_s", remaining}};
}

// ---- The bench

Json LiveView::on(const StageSeen& seen) {
  StageSeen& axis = stage_[index(seen.axis)];
  if (seen.encoder) axis.encoder = seen.encoder;
  if (seen.target) axis.target = seen.target;
  Json message = stage_json(axis);
  message["type"] = "stage";
  message["axis"] = seen.axis == StageAxis::kX ? "x" : "z";
  return message;
}

Json LiveView::on(const StripSeen& seen) {
  // The readings of this item have started again, and their time at zero.
  if (const auto known = streams_.find(seen.item); known == streams_.end() || known->second != seen.stream)
    std::erase_if(strip_, [&](const Json& group) { return group["item"] == seen.item; });
  streams_[seen.item] = seen.stream;
  const Json group = {{"item", seen.item},
                      {"stream", seen.stream},
                      {"time_s", json_number(seen.time_s)},
                      {"mean", vector(seen.mean)},
                      {"lowest", vector(seen.lowest)},
                      {"highest", vector(seen.highest)},
                      {"readings", seen.readings},
                      {"unit", seen.unit},
                      {"temperature_degc", json_number(seen.temperature_degc)}};
  strip_.push_back(group);
  if (strip_.size() > kKeptStrip) strip_.pop_front();
  return {{"type", "strip"}, {"group", group}};
}

Json LiveView::keep(const LogLine& line) {
  Json entry = {{"utc", format_utc(clock_.utc_now())},
                {"grade", kGrades.of(line.grade)},
                {"text", line.text.english()},
                {"messages", messages_json({line.text})}};
  log_.push_back(entry);
  if (log_.size() > kKeptLog) log_.pop_front();
  return entry;
}

Json LiveView::on(const LogLine& line) {
  return {{"type", "log"}, {"line", keep(line)}};
}

Json LiveView::on(const ChecksSeen& seen) {
  checks_ = seen;
  return {{"type", "checks"}, {"findings", findings_json(seen.findings)}};
}

Json LiveView::on(const StateSeen& seen) {
  Json message = seen.contents;
  message["type"] = seen.type;
  states_[seen.type] = message;
  return message;
}

Json LiveView::on(const InterruptionAcknowledged& seen) {
  interrupted_ = seen.run;
  return {{"type", "acknowledged"}, {"interrupted", interrupted_json(seen.run)}};
}

Json LiveView::on(const HaltSeen& seen) {
  halt_ = seen;
  Json message = halt_json(seen);
  message["type"] = "halt";
  return message;
}

Json LiveView::on(const FaultSeen& seen) {
  fault_ = seen;
  Json message = fault_json(seen);
  message["type"] = "fault";
  return message;
}

std::string LiveView::snapshot() const {
  Json json = {{"type", "snapshot"}, {"about", about_}, {"activity", activity_json(activity_)}};
  Json& run = json["run"];
  if (run_) {
    run = to_json_object(*run_);
    run["fits"] = {fit_of(1), fit_of(2), fit_of(3)};
    run["progress"] = progress();
    run["ended"] = ended_ ? ended_json(*ended_) : Json(nullptr);
  }
  json["phase"] = phase_;
  json["halt"] = halt_ ? halt_json(*halt_) : Json(nullptr);
  json["fault"] = fault_ ? fault_json(*fault_) : Json(nullptr);
  json["guard"] = guard_.english();
  json["messages"] = messages_json({guard_});
  json["interrupted"] = interrupted_ ? interrupted_json(*interrupted_) : Json(nullptr);
  json["stage"] = {{"x", stage_json(stage_[0])}, {"z", stage_json(stage_[1])}};
  json["strip"] = strip_;
  json["log"] = log_;
  json["checks"] = checks_ ? Json(findings_json(checks_->findings)) : Json(nullptr);
  for (const char* type : {"queue", "ports", "levelling"}) {
    const auto known = states_.find(type);
    json[type] = known == states_.end() ? Json(nullptr) : known->second;
  }
  return text_of(json);
}

}  // namespace abcal::console
