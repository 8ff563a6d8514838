#include "app/console/live_view.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "app/console/visible_text.h"
#include "app/results/result_json.h"
#include "protocol/analysis/harmonic_fit.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kKeptStrip = 400;  // groups of readings: 20 s
constexpr std::size_t kKeptLog = 200;    // lines
constexpr std::size_t kIntervals = 15;   // their median gives the remaining time

Json degrees(const std::optional<Angle>& angle) {
  return angle ? json_number(angle->deg()) : Json(nullptr);
}
Json vector(const Eigen::Vector3d& v) {
  return Json::array({json_number(v[0]), json_number(v[1]), json_number(v[2])});
}

std::string_view name(Activity activity) {
  switch (activity) {
    case Activity::kIdle:
      return "idle";
    case Activity::kChecking:
      return "checking";
    case Activity::kRunning:
      return "running";
    case Activity::kJogging:
      return "jogging";
    case Activity::kAnalysing:
      return "analysing";
  }
  return "";
}

std::string_view name(LogLine::Grade grade) {
  switch (grade) {
    case LogLine::Grade::kInfo:
      return "info";
    case LogLine::Grade::kWarning:
      return "warning";
    case LogLine::Grade::kProblem:
      return "problem";
  }
  return "";
}

std::string_view name(Finding::Grade grade) {
  switch (grade) {
    case Finding::Grade::kGood:
      return "good";
    case Finding::Grade::kWarning:
      return "warning";
    case Finding::Grade::kProblem:
      return "problem";
    case Finding::Grade::kLeftOut:
      return "left out";
  }
  return "";
}

Json planned_json(const PlannedAngle& angle) {
  return {{"experiment", angle.experiment},
          {"n", angle.n},
          {"closing", angle.closing},
          {"alpha_deg", angle.alpha.deg()},
          {"x_deg", angle.x.deg()},
          {"z_deg", angle.z.deg()},
          {"check", angle.check}};
}

Json dwell_json(std::size_t position, const ItemDwell& measured) {
  const DwellRecord& dwell = measured.dwell;
  return {{"position", position},
          {"item", measured.item},
          {"experiment", dwell.experiment},
          {"n", dwell.n},
          {"closing", dwell.closing},
          {"alpha_deg", dwell.alpha.deg()},
          {"mean", vector(dwell.mean)},
          {"spread", vector(dwell.spread)},
          {"u_mean", dwell.u_mean ? vector(*dwell.u_mean) : Json(nullptr)},
          {"count", dwell.count},
          {"settle_s", json_number(dwell.settle_time_s)},
          {"temperature_degc", dwell.temperature_degc ? json_number(*dwell.temperature_degc) : Json(nullptr)},
          {"flags", describe_flags(dwell.flags)}};
}

Json stage_json(const StageSeen& seen) {
  return {{"encoder_deg", degrees(seen.encoder)}, {"target_deg", degrees(seen.target)}};
}

Json ended_json(const RunEnded& ended) {
  return {{"file", ended.file}, {"complete", ended.complete}, {"words", ended.words}};
}

Json activity_json(const ActivitySeen& seen) {
  return {
      {"activity", name(seen.activity)}, {"hold_asked", seen.hold_asked}, {"stop_asked", seen.stop_asked}};
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
  return {{"instrument", seen.instrument}, {"fault", seen.fault}, {"words", seen.words}};
}

Json interrupted_json(const InterruptedRun& run) {
  return {{"file", run.file},       {"words", run.words}, {"measured", run.measured},
          {"planned", run.planned}, {"angle", run.angle}, {"items", run.items}};
}

/// What instruments say of themselves need not be UTF-8.
std::string text_of(const Json& message) {
  return with_visible_direction_controls(message.dump(-1, ' ', false, Json::error_handler_t::replace));
}

}  // namespace

nlohmann::ordered_json findings_json(const std::vector<Finding>& findings) {
  Json list = Json::array();
  for (const Finding& finding : findings) {
    list.push_back({{"grade", name(finding.grade)},
                    {"what", finding.what},
                    {"found", finding.found},
                    {"advice", finding.advice}});
  }
  return list;
}

LiveView::LiveView(Json about, const Clock& clock) : about_(std::move(about)), clock_(clock) {}

std::string LiveView::apply(const Event& event) {
  if (const auto* began = std::get_if<RunBegan>(&event)) {
    begin(*began);
    return snapshot();  // Everything changes: the snapshot for new pages serves the others as well.
  }
  return text_of(std::visit([this](const auto& seen) { return on(seen); }, event));
}

Json LiveView::on(const ActivitySeen& seen) {
  // The readings begin again, and their time with them.
  if (seen.activity == Activity::kChecking && activity_.activity != Activity::kChecking) strip_.clear();
  if (activity_.activity == Activity::kIdle && seen.activity != Activity::kIdle) {
    fault_.reset();
    halt_.reset();
  }
  activity_ = seen;
  if (seen.activity == Activity::kIdle) phase_.reset();
  Json message = activity_json(seen);
  message["type"] = "activity";
  return message;
}

void LiveView::begin(const RunBegan& began) {
  run_ = began;
  dwells_.clear();
  items_.clear();
  for (const ItemSummary& item : began.items) items_.push_back({item, item.measured, {}, item.missing});
  for (const DwellSeen& measured : began.measured) store(measured);
  phase_.reset();
  ended_.reset();
  interrupted_.reset();
  strip_.clear();
  last_dwell_.reset();
  dwell_intervals_s_.clear();
}

Json LiveView::on(const PhaseSeen& seen) {
  phase_ = seen;
  if (seen.phase == RunPhase::kHolding) last_dwell_.reset();
  Json message = phase_json();
  message["type"] = "phase";
  return message;
}

void LiveView::store(const DwellSeen& seen) {
  const int item = seen.items.empty() ? 1 : seen.items.front().k;
  dwells_.insert_or_assign(seen.position, ItemDwell{item, seen.dwell, {}});
}

void LiveView::store_items(const DwellSeen& seen) {
  std::vector<ItemReading> readings = seen.items;
  if (readings.empty())
    readings.push_back({1, seen.dwell.mean, seen.dwell.flags, seen.dwell.temperature_degc});
  for (ItemSeen& item : items_) {
    const auto reading = std::ranges::find(readings, item.summary.k, &ItemReading::k);
    if (reading == readings.end()) continue;
    // An angle that is measured again counts once.
    if (!dwells_.contains(seen.position)) ++item.measured;
    item.last = *reading;
  }
}

Json LiveView::item_json(const ItemSeen& item) {
  return {
      {"k", item.summary.k},
      {"name", item.summary.name},
      {"model", item.summary.model},
      {"unit", item.summary.unit},
      {"measured", item.measured},
      {"mean", item.last ? vector(item.last->mean) : Json(nullptr)},
      {"flags", item.last ? describe_flags(item.last->flags) : ""},
      {"temperature_degc",
       item.last && item.last->temperature_degc ? json_number(*item.last->temperature_degc) : Json(nullptr)},
      {"dropped", item.dropped.empty() ? Json(nullptr) : Json(item.dropped)}};
}

Json LiveView::items_json() const {
  Json list = Json::array();
  for (const ItemSeen& item : items_) list.push_back(item_json(item));
  return list;
}

Json LiveView::on(const ItemDropped& seen) {
  for (ItemSeen& item : items_)
    if (item.summary.k == seen.k) item.dropped = seen.words;
  return {{"type", "items"}, {"items", items_json()}};
}

Json LiveView::on(const DwellSeen& seen) {
  // The small turn of a check is no run.
  if (activity_.activity != Activity::kRunning) return {{"type", "nothing"}};
  store_items(seen);
  store(seen);
  const Clock::Instant now = clock_.now();
  if (last_dwell_) {
    dwell_intervals_s_.push_back(to_seconds(now - *last_dwell_));
    if (dwell_intervals_s_.size() > kIntervals) dwell_intervals_s_.pop_front();
  }
  last_dwell_ = now;
  return {{"type", "dwell"},
          {"dwell", dwell_json(seen.position, dwells_.at(seen.position))},
          {"told_us", std::chrono::floor<std::chrono::microseconds>(seen.told).time_since_epoch().count()},
          {"fit", fit_of(seen.dwell.experiment)},
          {"items", items_json()},
          {"progress", progress()}};
}

/// The one-harmonic curve through the angles of an experiment that are measured so far. Of several items
/// through those of the item that was measured last: the first may have been dropped.
Json LiveView::fit_of(int experiment) const {
  std::vector<Angle> alpha;
  std::array<std::vector<double>, 3> readings;
  for (const auto& [position, measured] : dwells_) {
    const DwellRecord& dwell = measured.dwell;
    if (measured.item != dwells_.rbegin()->second.item) continue;
    if (dwell.experiment != experiment || dwell.closing || !dwell.mean.allFinite()) continue;
    alpha.push_back(dwell.alpha);
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

Json LiveView::progress() const {
  const std::size_t total = run_ ? run_->plan.size() : 0;
  const std::size_t measured = dwells_.size();
  Json left = nullptr;
  if (run_ && total > 0) {
    const auto missing = static_cast<double>(total - std::min(total, measured));
    double each = run_->estimated_s / static_cast<double>(total);
    if (dwell_intervals_s_.size() >= 3) {
      std::vector<double> intervals(dwell_intervals_s_.begin(), dwell_intervals_s_.end());
      const auto middle = intervals.begin() + static_cast<std::ptrdiff_t>(intervals.size() / 2);
      std::nth_element(intervals.begin(), middle, intervals.end());
      each = *middle;
    }
    left = json_number(missing * each);
  }
  return {{"measured", measured}, {"total", total}, {"left_s", left}};
}

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
  // The readings of this item have begun again, and their time with them.
  if (const auto known = streams_.find(seen.item); known == streams_.end() || known->second != seen.stream)
    std::erase_if(strip_, [&](const Json& group) { return group["item"] == seen.item; });
  streams_[seen.item] = seen.stream;
  const Json group = {
      {"item", seen.item},
      {"stream", seen.stream},
      {"time_s", json_number(seen.time_s)},
      {"mean", vector(seen.mean)},
      {"lowest", vector(seen.lowest)},
      {"highest", vector(seen.highest)},
      {"readings", seen.readings},
      {"unit", seen.unit},
      {"temperature_degc", seen.temperature_degc ? json_number(*seen.temperature_degc) : Json(nullptr)}};
  strip_.push_back(group);
  if (strip_.size() > kKeptStrip) strip_.pop_front();
  return {{"type", "strip"}, {"group", group}};
}

Json LiveView::on(const LogLine& line) {
  const Json entry = {
      {"utc", format_utc(clock_.utc_now())}, {"grade", name(line.grade)}, {"text", line.text}};
  log_.push_back(entry);
  if (log_.size() > kKeptLog) log_.pop_front();
  return {{"type", "log"}, {"line", entry}};
}

Json LiveView::on(const ChecksSeen& seen) {
  checks_ = seen;
  return {{"type", "checks"}, {"findings", findings_json(seen.findings)}};
}

Json LiveView::on(const ItemChecked& seen) {
  return on(ChecksSeen{seen.check.findings});
}

Json LiveView::on(const QueueSeen& seen) {
  queue_ = seen.queue;
  Json message = seen.queue;
  message["type"] = "queue";
  return message;
}

Json LiveView::on(const PortsSeen& seen) {
  ports_ = {{"type", "ports"}, {"ports", seen.ports}};
  return ports_;
}

Json LiveView::on(const LevelSeen& seen) {
  levelling_ = {
      {"type", "levelling"}, {"file", seen.file}, {"levelling", seen.levelling}, {"words", seen.words}};
  return levelling_;
}

Json LiveView::on(const RunEnded& ended) {
  ended_ = ended;
  interrupted_.reset();
  if (!ended.complete && run_) {
    std::set<std::size_t> measured;
    for (const auto& [position, dwell] : dwells_) measured.insert(position);
    interrupted_ = describe_interrupted(ended.file, ended.words, run_->plan, measured);
    if (!items_.empty())
      interrupted_->items = static_cast<std::size_t>(
          std::ranges::count_if(items_, [](const ItemSeen& item) { return item.dropped.empty(); }));
  }
  Json message = ended_json(ended);
  message["type"] = "ended";
  message["interrupted"] = interrupted_ ? interrupted_json(*interrupted_) : Json(nullptr);
  return message;
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

Json LiveView::on(const GuardSeen& seen) {
  guard_ = seen.words;
  return {{"type", "guard"}, {"words", guard_}};
}

Json LiveView::on(const InterruptedSeen& seen) {
  interrupted_ = seen.run;
  return {{"type", "interrupted"}, {"run", interrupted_ ? interrupted_json(*interrupted_) : Json(nullptr)}};
}

Json LiveView::phase_json() const {
  if (!phase_) return nullptr;
  Json json = {{"position", phase_->position}, {"phase", to_string(phase_->phase)}};
  json["limit_s"] = phase_->limit ? json_number(phase_->limit->seconds) : Json(nullptr);
  json["limit_words"] = phase_->limit ? Json(phase_->limit->words) : Json(nullptr);
  json["limit_simulated"] = phase_->limit && phase_->limit->simulated;
  return json;
}

std::string LiveView::snapshot() const {
  Json json = {{"type", "snapshot"}, {"about", about_}, {"activity", activity_json(activity_)}};
  json["run"] = nullptr;
  if (run_) {
    Json plan = Json::array();
    for (const PlannedAngle& angle : run_->plan) plan.push_back(planned_json(angle));
    Json dwells = Json::array();
    for (const auto& [position, dwell] : dwells_) dwells.push_back(dwell_json(position, dwell));
    json["run"] = {{"file", run_->file},
                   {"bench", run_->bench},
                   {"item", run_->item},
                   {"operator", run_->operator_name},
                   {"unit", run_->unit},
                   {"simulated", run_->simulated},
                   {"pace", run_->pace ? Json(*run_->pace) : Json(nullptr)},
                   {"stage", run_->stage},
                   {"accelerometer", run_->accelerometer},
                   {"plan", std::move(plan)},
                   {"dwells", std::move(dwells)},
                   {"fits", {fit_of(1), fit_of(2), fit_of(3)}},
                   {"items", items_json()},
                   {"progress", progress()},
                   {"ended", ended_ ? ended_json(*ended_) : Json(nullptr)}};
  }
  json["phase"] = phase_json();
  json["halt"] = halt_ ? halt_json(*halt_) : Json(nullptr);
  json["fault"] = fault_ ? fault_json(*fault_) : Json(nullptr);
  json["guard"] = guard_;
  json["interrupted"] = interrupted_ ? interrupted_json(*interrupted_) : Json(nullptr);
  json["stage"] = {{"x", stage_json(stage_[0])}, {"z", stage_json(stage_[1])}};
  json["strip"] = strip_;
  json["log"] = log_;
  json["checks"] = checks_ ? findings_json(checks_->findings) : Json(nullptr);
  json["queue"] = queue_;
  json["ports"] = ports_;
  json["levelling"] = levelling_;
  return text_of(json);
}

}  // namespace abcal::console
