#include "app/console/start_form.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/bench_file/bench_records.h"
#include "app/bench_file/not_real.h"
#include "app/bench_file/stage_record_file.h"
#include "app/console/access.h"
#include "app/console/chosen_run.h"
#include "app/console/interrupted_run.h"
#include "app/console/last_check.h"
#include "app/laboratory/register/register.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/session/disk_space.h"
#include "app/results/analysis/effect_words.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/result_json.h"
#include "app/results/planner/known_bench.h"
#include "app/results/planner/plan_search.h"
#include "app/system/read_file.h"
#include "protocol/plan/backlash.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal::console {
namespace {

using Json = nlohmann::ordered_json;

/// The form warns if the last check of the bench is older.
constexpr std::chrono::hours kCheckHolds{24};

/// The item with the noise of a reading, and the source of that value.
struct Noise {
  KnownItem item;
  Message source;
};

/// Puts the form together, topic by topic.
class Form {
 public:
  Form(const StartFormAsked& asked, RunLibrary& library, Clock::UtcTime now)
      : asked_(asked), library_(library), now_(now) {}

  Json make() {
    json_["form"] = make_token().substr(0, 32);
    json_["bench_file"] = asked_.bench_file.filename().string();
    try {
      const std::string text = read_file(asked_.bench_file);
      json_["bench_sha256"] = sha256_of(text);
      const BenchConfig config = read_bench(asked_.bench_file, register_records());
      json_["as_bench_file"] = plan_json(config);
      ChosenRun chosen = choose_run(config, asked_.choice);
      for (std::string& warning : chosen.config.warnings) warn(Message::bare(std::move(warning)));
      for (Message& warning : chosen.warnings) warn(std::move(warning));
      add_all(chosen.config);
    } catch (const std::exception& error) {
      problems_.push_back(message_of(error));
    }
    json_["warnings"] = texts(warnings_);
    json_["problems"] = texts(problems_);
    warnings_.insert(warnings_.end(), problems_.begin(), problems_.end());
    json_["messages"] = messages_json(warnings_);
    return std::move(json_);
  }

 private:
  static Json texts(const std::vector<Message>& messages) {
    Json list = Json::array();
    for (const Message& message : messages) list.push_back(message.english());
    return list;
  }
  void warn(Message words) { warnings_.push_back(std::move(words)); }

  static Json plan_json(const BenchConfig& config) {
    return {{"steps", config.protocol.steps},
            {"dwell_readings", config.protocol.dwell_readings},
            {"estimator", config.protocol.estimator}};
  }

  void add_all(const BenchConfig& config) {
    json_["bench"] = config.name;
    json_["simulated"] = fmt::format("{}", fmt::join(simulated_instruments(config), ", "));
    const ItemConfig& item = config.items.front().item;
    json_["item"] = {{"maker", item.maker},
                     {"model", item.model},
                     {"serial_number", item.serial_number},
                     {"customer_number", item.customer_number}};
    json_["items"] = Json::array();
    for (const BenchItemConfig& each : config.items) {
      if (!config.has_several_items()) break;
      json_["items"].push_back({{"maker", each.item.maker},
                                {"model", each.item.model},
                                {"serial_number", each.item.serial_number},
                                {"driver", each.accelerometer.driver}});
    }
    if (!config.has_several_items() && item.serial_number.empty())
      warn(Message("The item has no serial number: the run will have the one that the instrument reports."));
    add_register(config);
    add_operator(config);
    add_plan(config);
    add_check();
    add_stage_record(config);
    if (const auto run = find_interrupted_run(asked_.runs))
      warn(
          Message("Run {run} was interrupted: {measured} of {planned} angles are measured. It can be resumed "
                  "instead.",
                  run->file, run->measured, run->planned));
  }

  void add_register(const BenchConfig& config) {
    json_["register"] = nullptr;
    if (asked_.register_location.empty()) return;
    lab::Register opened = lab::Register::open(asked_.register_location, now_);
    Json items = Json::array();
    const ItemConfig& wanted = config.items.front().item;
    bool known = wanted.serial_number.empty();
    for (const lab::Item& item : opened.items()) {
      if (!item.retired.empty()) continue;
      items.push_back({{"identity", item.identity},
                       {"maker", item.maker},
                       {"model", item.model},
                       {"serial_number", item.serial_number},
                       {"owner", item.owner}});
      known = known || (item.serial_number == wanted.serial_number && item.model == wanted.model);
    }
    json_["register"] = {
        {"name", opened.facts().name}, {"training", opened.facts().training}, {"items", std::move(items)}};
    if (!known)
      warn(
          Message("The register has no item {model} {serial} in use: check the serial number, or add the "
                  "item (abcal lab add item).",
                  wanted.model, wanted.serial_number));
    for (const lab::BenchBlock& block : opened.blocks())
      if (block.holds() && block.bench == config.name)
        warn(
            Message("The check standard {standard} blocks this bench since {since}: no certificate is issued "
                    "for what is measured on it ({found}).",
                    block.check_standard, block.set_utc, block.found));
  }

  void add_operator(const BenchConfig& config) {
    const bool verified = asked_.who.verified();
    json_["operator"] = {{"name", verified ? asked_.who.name : config.operator_name}, {"verified", verified}};
    if (verified && !config.operator_name.empty() && config.operator_name != asked_.who.name)
      problems_.push_back(
          Message("[operator] name in the bench file is \"{stated}\", but {logged_in} is logged in; "
                  "required: the person who is logged in, or no name",
                  config.operator_name, asked_.who.name));
    if (!verified && config.operator_name.empty())
      warn(Message(
          "Nobody is the operator: the bench file has no [operator] name, and there is no register."));
  }

  void add_plan(const BenchConfig& config) {
    const std::array<KnownAxis, 2> axes = known_axes(config);
    const auto plan = make_rotation_plan(config.protocol, {axes[0].travel, axes[1].travel});
    const PlanDuration duration = estimate_duration(plan, config.protocol, {axes[0].speed, axes[1].speed},
                                                    config.items.front().accelerometer.settings.rate_hz);
    json_["plan"] = plan_json(config);
    json_["plan"]["angles"] = plan.size();
    json_["plan"]["step_choices"] = kTriedSteps;
    json_["estimators"] = estimator_names();
    json_["duration"] = {{"total_s", duration.total_s()},
                         {"moving_s", duration.moving_s},
                         {"settling_s", duration.settling_s},
                         {"dwelling_s", duration.dwelling_s},
                         {"speeds_known", axes[0].speed.deg_per_s > 0.0 && axes[1].speed.deg_per_s > 0.0}};
    if (axes[0].travel_assumed || axes[1].travel_assumed)
      warn(
          Message("The travel of the stage is not in the bench file: -360 to 360 degrees is assumed here; "
                  "the run asks the stage."));
    const Tolerances& tolerances = config.items.front().tolerances;
    if (const Message words = default_effects_words(tolerances, Advice::kForOperator); !words.empty())
      warn(Message("Sizes of effects: {effects}.", words));
    if (backlash_is_left(config.protocol, plan))
      warn(Message("Backlash: {words}.", backlash_words(tolerances.zero)));
    add_disk(config, plan.size(), duration.total_s());
    predict(config);
  }

  void add_disk(const BenchConfig& config, std::size_t angles, double duration_s) {
    const double rate_hz = config.items.front().accelerometer.settings.rate_hz;
    const DiskNeed need{angles, readings_per_dwell(config.protocol, rate_hz), duration_s, rate_hz, false};
    const std::filesystem::path file = asked_.runs / "a.run";
    const auto free = free_disk_space(file);
    json_["disk"] = {{"free_bytes", free ? Json(*free) : Json()},
                     {"needed_bytes", estimated_run_bytes(need)}};
    try {
      if (auto warning = check_disk_space(asked_.runs, need, free)) warn(*std::move(warning));
    } catch (const std::runtime_error& too_little) {
      problems_.push_back(message_of(too_little));
    }
  }

  /// The noise of a reading: as simulated, else from an earlier run of this item, else of its model.
  std::optional<Noise> known_noise(const BenchConfig& config) {
    if (const auto noise = simulated_noise(config))
      return Noise{{.noise = *noise}, Message("the simulation")};
    const ItemConfig& item = config.items.front().item;
    std::string of_model;
    for (const Json& run : library_.list()) {
      if (run.value("state", "") != "complete" || !run.value("simulated", "").empty()) continue;
      const auto name = run.at("name").get<std::string>();
      if (!item.serial_number.empty() && run.value("item", "") == item.serial_number) return noise_of(name);
      if (of_model.empty() && !item.model.empty() && run.value("model", "") == item.model) of_model = name;
    }
    return of_model.empty() ? std::nullopt : noise_of(of_model);
  }

  std::optional<Noise> noise_of(const std::string& run) {
    try {
      return Noise{item_of_run(asked_.runs / (run + "#1")), Message("run {run}", run)};
    } catch (const std::exception& error) {
      warn(Message("The noise of a reading is not known from run {run}: {why}", run, message_of(error)));
      return std::nullopt;
    }
  }

  void predict(const BenchConfig& config) {
    json_["predicted"] = Json::array();
    json_["noise"] = nullptr;
    if (config.protocol.estimator == "norm") return;  // Its results have no orientation to predict.
    const std::optional<Noise> noise = known_noise(config);
    if (!noise) return;
    const PlanPrediction plan = predict_plan(planning_bench(config, noise->item), config.protocol);
    for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
      const auto output = static_cast<PlannedOutput>(group);
      json_["predicted"].push_back({{"symbol", symbol_of(output)},
                                    {"standard_uncertainty", json_number(plan.u[group])},
                                    {"unit", unit_of(output)},
                                    {"largest_part", plan.limits[group].name.english()},
                                    {"messages", messages_json({plan.limits[group].name})},
                                    {"share", json_number(plan.limits[group].share)}});
    }
    json_["noise"] = {{"value", noise->item.noise},
                      {"source", noise->source.english()},
                      {"messages", messages_json({noise->source})}};
  }

  void add_check() {
    json_["last_check"] = nullptr;
    const auto check = last_check(asked_.runs, asked_.bench_file);
    if (!check) return warn(Message("This bench has not been checked from the console yet."));
    const bool outdated = check->utc < format_utc(now_ - kCheckHolds);
    json_["last_check"] = {{"utc", check->utc},
                           {"by", check->by},
                           {"with_motion", check->with_motion},
                           {"good", check->good},
                           {"warnings", check->warnings},
                           {"problems", check->problems},
                           {"outdated", outdated}};
    if (check->problems > 0)
      warn(Message("The last check of this bench found {problems} problems.", check->problems));
    if (outdated) warn(Message("The last check of this bench is older than {hours} h.", kCheckHolds.count()));
  }

  /// The record of the stage: its age, how long it is good for, and whether the last run agreed with it.
  void add_stage_record(const BenchConfig& config) {
    json_["stage_record"] = nullptr;
    if (config.stage.record.empty()) return;
    const StageRecord record = read_stage_record(config.stage.record);
    const double age = months_between(record.learned_utc(), format_utc(now_));
    const double validity = validity_months(record);
    Json& shown = json_["stage_record"] = {
        {"file", config.stage.record}, {"learned_utc", record.learned_utc()}, {"runs", record.runs()},
        {"age_months", age},           {"validity_months", validity},         {"last_run", nullptr}};
    if (age > validity)
      warn(
          Message("The record of the stage is {age:.1f} months old and good for {validity:.1f}: learn the "
                  "stage again (abcal stage learn).",
                  age, validity));
    const std::optional<Json> last = last_test(config, record.sha256);
    if (!last) return;
    shown["last_run"] = *last;
    if (!last->at("agrees"))
      warn(
          Message("Run {run} contradicts the record of the stage: learn the stage again (abcal stage learn).",
                  last->at("name").get<std::string>()));
  }

  /// Whether the newest complete run on this bench agrees with this record; nullopt if it did not use it.
  std::optional<Json> last_test(const BenchConfig& config, const std::string& sha256) {
    for (const Json& run : library_.list()) {
      if (run.value("state", "") != "complete" || run.value("bench", "") != config.name) continue;
      const auto name = run.at("name").get<std::string>();
      const Json analysed = library_.result(asked_.runs / name, 0);
      for (const Json& result : analysed.at("results"))
        if (const auto used = result.find("stage_record");
            used != result.end() && used->at("sha256") == sha256)
          return Json{{"name", name}, {"created_utc", run.at("created_utc")}, {"agrees", used->at("agrees")}};
      return std::nullopt;  // It did not use this record: nothing is known of it.
    }
    return std::nullopt;
  }

  const StartFormAsked& asked_;
  RunLibrary& library_;
  Clock::UtcTime now_;
  Json json_ = Json::object();
  std::vector<Message> warnings_, problems_;
};

}  // namespace

Json start_form(const StartFormAsked& asked, RunLibrary& library, Clock::UtcTime now) {
  return Form(asked, library, now).make();
}

}  // namespace abcal::console
