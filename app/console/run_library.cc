#include "app/console/run_library.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <sstream>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/not_real.h"
#include "app/console/download.h"
#include "app/console/flag_words.h"
#include "app/console/thinned_readings.h"
#include "app/document/json_text.h"
#include "app/laboratory/certificate/certificate_json.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/compare/compare_json.h"
#include "app/laboratory/compare/compare_results.h"
#include "app/measure/bench/make_bench.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/budget_words.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/result_json.h"
#include "app/results/export/constants.h"
#include "app/system/output_file.h"
#include "app/system/version.h"
#include "drivers/text/text.h"
#include "protocol/estimators/checks/check_meanings.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_label.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/run_seal.h"
#include "protocol/uncertainty/control_chart.h"

namespace abcal::console {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kNotReadYet = "not read yet";

bool has_item(const Json& run, const std::string& serial_number) {
  return std::ranges::any_of(run.value("items", Json::array()), [&](const Json& item) {
    return item.value("serial_number", "") == serial_number;
  });
}

std::vector<std::string> words_of(const std::string& text) {
  std::istringstream stream(text);
  return {std::istream_iterator<std::string>(stream), {}};
}

/// Format of the stored summaries; those of another format are made again.
constexpr int kSummaryFormat = 5;

/// A file NAME.run itself: a link would lead out of the folder.
bool is_run(const std::filesystem::path& path) {
  std::error_code ignored;
  return path.extension() == ".run" &&
         std::filesystem::is_regular_file(std::filesystem::symlink_status(path, ignored));
}

/// The serial number of each item as the person stated it, else as the accelerometer reported it.
std::string serial_numbers_of(const RunHeader& header) {
  std::vector<std::string> of_items;
  for (const RunItem& item : header.items) of_items.push_back(item.serial_number);
  return fmt::format("{}", fmt::join(of_items, ", "));
}

/// Which instruments of a run were simulated, by its bench file: "stage, accelerometer"; empty: none.
std::string simulated_of(const RunHeader& header) {
  try {
    return fmt::format("{}", fmt::join(simulated_instruments(parse_bench(header.bench_toml, "run")), ", "));
  } catch (const std::exception&) {
    return "";  // An imported run has no bench file.
  }
}

/// The items of a run, and how far each was measured.
Json items_of(const StoredRun& run) {
  Json items = Json::array();
  for (std::size_t i = 0; i < run.items.size(); ++i) {
    const ItemProgress& item = run.items[i];
    items.push_back({{"k", item.k},
                     {"serial_number", run.header.items[i].serial_number},
                     {"model", run.header.items[i].model},
                     {"measured", item.measured},
                     {"dropped", item.dropped_at ? Json(item.reason) : Json(nullptr)}});
  }
  return items;
}

/// The verdict of the estimator that was chosen for a run, as stored when the run was closed; empty: the run
/// is not analysed, or its results cannot be read.
std::string kept_verdict(const std::filesystem::path& path, const std::string& estimator) {
  std::string verdict;
  try {
    for (const StoredAnalysis& each : stored_analyses(path))
      if (each.estimator == estimator)
        verdict = Json::parse(each.result_json).at("verdict").get<std::string>();
  } catch (const std::exception&) {
    return "";  // The run's own page shows the reason.
  }
  return verdict;
}

/// Reads a number that json_number() wrote; null is NaN.
double number_from(const Json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

/// |a| - g_loc at each angle at rest, m/s2: of the readings as the instrument gives them, and corrected by
/// the constants that `abcal export` writes for this result. Null where the result gives no constants.
Json norms_of(const StoredRun& run, const CalibrationResult& result) {
  std::optional<CorrectionConstants> constants;
  try {
    constants = constants_of(result, ExportFrame::kItem);
  } catch (const std::invalid_argument&) {
    return nullptr;  // Not usable, or without local gravity: the result itself says so.
  }
  Json json = {{"position", Json::array()}, {"before", Json::array()}, {"after", Json::array()}};
  for (std::size_t i = 0; i < run.dwells.size(); ++i) {
    const DwellRecord& dwell = run.dwells[i];
    if (dwell.motion) continue;
    const double corrected = (constants->M * (dwell.mean - constants->b)).norm();
    std::optional<double> before;  // Absent: the output is no acceleration.
    if (constants->unit_mps2) before = dwell.mean.norm() * *constants->unit_mps2 - constants->g_loc_mps2;
    json["position"].push_back(run.measured[i]);
    json["before"].push_back(json_number(before));
    json["after"].push_back(json_number(std::optional(corrected - constants->g_loc_mps2)));
  }
  return json;
}

/// The limits of a chart of single values; null where there are too few.
Json limits_of(const Json& runs) {
  std::vector<double> series;
  for (const Json& run : runs)
    if (run["value"].is_number()) series.push_back(run["value"]);
  if (series.size() < 2) return nullptr;
  const ControlChart chart = individuals_chart(series);
  int outside = 0;
  for (std::size_t k = 0; k < chart.points.size(); ++k) outside += chart.inside(k) ? 0 : 1;
  return {{"centre", chart.centre},
          {"standard_deviation", chart.standard_deviation},
          {"lower", chart.points.front().lower},
          {"upper", chart.points.front().upper},
          {"outside", outside}};
}

}  // namespace

/// The items of a run with this serial number that were measured to the end, from 1.
std::vector<int> RunLibrary::whole_items_of(const Summary& summary, const std::string& serial_number) {
  std::vector<int> items;
  for (const Json& item : Json::parse(summary.items))
    if (item.at("serial_number") == serial_number && item.at("dropped").is_null())
      items.push_back(item.at("k").get<int>());
  return items;
}

RunLibrary::Summary RunLibrary::summary_of(const StoredRun& run) {
  const RunHeader& header = run.header;
  Summary summary;
  summary.state = to_string(run.state);
  summary.created_utc = header.created_utc;
  summary.item = serial_numbers_of(header);
  summary.items = items_of(run).dump();
  summary.maker = label_of(header.labels, "item.maker");
  summary.model = label_of(header.labels, "item.model");
  summary.bench = label_of(header.labels, "bench.name");
  summary.operators = describe(operators_of(run));
  summary.unit = header.response_unit;
  summary.measured = run.measured.size();
  summary.planned = header.plan.size();
  summary.duration_s = run.timing.total_s();
  summary.simulated = simulated_of(header);
  return summary;
}

Json RunLibrary::to_json(const std::string& name, const Summary& summary) {
  return {{"name", name},
          {"state", summary.state},
          {"created_utc", summary.created_utc},
          {"item", summary.item},
          {"items", Json::parse(summary.items)},
          {"maker", summary.maker},
          {"model", summary.model},
          {"bench", summary.bench},
          {"operator", summary.operators},
          {"unit", summary.unit},
          {"measured", summary.measured},
          {"planned", summary.planned},
          {"duration_s", json_number(summary.duration_s)},
          {"simulated", summary.simulated},
          {"verdict", summary.verdict}};
}

RunLibrary::Summary RunLibrary::summary_from(const Json& kept) {
  const auto text = [&kept](const char* key) { return kept.at(key).get<std::string>(); };
  Summary summary;
  summary.state = text("state");
  summary.created_utc = text("created_utc");
  summary.item = text("item");
  summary.items = kept.at("items").dump();
  summary.maker = text("maker");
  summary.model = text("model");
  summary.bench = text("bench");
  summary.operators = text("operator");
  summary.unit = text("unit");
  summary.measured = kept.at("measured").get<std::size_t>();
  summary.planned = kept.at("planned").get<std::size_t>();
  summary.duration_s = number_from(kept.at("duration_s"));
  summary.simulated = text("simulated");
  summary.verdict = text("verdict");
  return summary;
}

RunLibrary::RunLibrary(std::filesystem::path folder) : folder_(std::move(folder)) {
  read_summaries();
}

/// Reads the stored summaries. They are only a copy: unreadable ones are made again from the runs.
void RunLibrary::read_summaries() {
  std::ifstream file(folder_ / kSummaries);
  const Json json = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  try {
    if (!json.is_object() || json.value("program", "") != program_version() ||
        json.value("format", 0) != kSummaryFormat)
      return;
    for (const auto& [name, kept] : json.at("runs").items()) {
      Entry entry;
      entry.time = std::filesystem::file_time_type(
          std::filesystem::file_time_type::duration(kept.at("time").get<std::int64_t>()));
      entry.size = kept.at("size").get<std::uintmax_t>();
      entry.summary = summary_from(kept.at("summary"));
      entry.estimator = kept.at("estimator").get<std::string>();
      const Json charts = kept.value("charted", Json::object());
      for (const auto& [item, charted] : charts.items())
        entry.charted[std::stoi(item)] = charted_from(charted);
      entry.closed = true;
      known_[name] = std::move(entry);
    }
  } catch (const std::exception&) {  // JSON, or a key that is not a number
    known_.clear();
  }
}

void RunLibrary::keep_summaries() {
  if (!std::exchange(have_new_, false)) return;
  Json runs = Json::object();
  for (const auto& [name, entry] : known_) {
    if (!entry.closed) continue;
    Json& kept = runs[name];
    kept = {{"time", entry.time.time_since_epoch().count()},
            {"size", entry.size},
            {"estimator", entry.estimator},
            {"summary", to_json(name, entry.summary)}};
    for (const auto& [item, charted] : entry.charted)
      kept["charted"][std::to_string(item)] = to_json(charted);
  }
  const Json json = {{"program", program_version()}, {"format", kSummaryFormat}, {"runs", std::move(runs)}};
  try {
    OutputFile(folder_ / kSummaries).write(json_text(json));
  } catch (const std::exception&) {
    return;  // The next console reads the runs again, which only takes longer.
  }
}

bool RunLibrary::is_known(const std::string& name) const {
  const auto known = known_.find(name);
  std::error_code ignored;
  return known != known_.end() && known->second.closed &&
         known->second.time == std::filesystem::last_write_time(folder_ / name, ignored) &&
         known->second.size == std::filesystem::file_size(folder_ / name, ignored);
}

std::vector<std::string> RunLibrary::names() const {
  std::vector<std::pair<std::filesystem::file_time_type, std::string>> found;
  std::error_code error;
  for (std::filesystem::directory_iterator at(folder_, error), end; !error && at != end;
       at.increment(error)) {
    std::error_code ignored;
    if (!is_run(at->path())) continue;
    found.emplace_back(at->last_write_time(ignored), at->path().filename().string());
  }
  std::sort(found.rbegin(), found.rend());
  std::vector<std::string> names;
  names.reserve(found.size());
  for (auto& [time, name] : found) names.push_back(std::move(name));
  return names;
}

std::optional<std::filesystem::path> RunLibrary::find_in(const std::filesystem::path& folder,
                                                         const std::string& name) {
  std::error_code error;
  for (std::filesystem::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    if (at->path().filename().string() == name && is_run(at->path())) return at->path();
  }
  return std::nullopt;
}

/// Reads a run unless it was read already and has not changed since. Throws RunFileError.
RunLibrary::Entry& RunLibrary::entry(const std::string& name) {
  const std::filesystem::path path = folder_ / name;
  std::error_code ignored;
  const auto time = std::filesystem::last_write_time(path, ignored);
  const auto size = std::filesystem::file_size(path, ignored);
  Entry& known = known_[name];
  if (known.closed && known.time == time && known.size == size) return known;
  const StoredRun run = RunFile::load(path);
  const bool closed = run.state == RunState::kComplete || run.state == RunState::kAbandoned;
  known = {.time = time, .size = size, .summary = summary_of(run), .closed = closed, .charted = {}};
  known.estimator = declared_estimator(run.record).name;
  have_new_ = have_new_ || closed;
  return known;
}

/// Finds the verdict of a closed run, unless it is known or the results file has not changed since.
void RunLibrary::find_verdict(const std::string& name, Entry& known) {
  if (!known.closed || !known.summary.verdict.empty()) return;
  std::error_code ignored;
  const auto time = std::filesystem::last_write_time(ResultsFile::path_beside(folder_ / name), ignored);
  if (known.results_time == time) return;
  known.results_time = time;
  known.summary.verdict = kept_verdict(folder_ / name, known.estimator);
  have_new_ = have_new_ || !known.summary.verdict.empty();
}

Json RunLibrary::list(std::chrono::milliseconds patience) {
  const std::lock_guard lock(mutex_);
  Json list = Json::array();
  const std::vector<std::string> all = names();
  const auto deadline = std::chrono::steady_clock::now() + patience;
  for (const std::string& name : all) {
    if (std::chrono::steady_clock::now() > deadline && !is_known(name)) {
      list.push_back({{"name", name}, {"state", kNotReadYet}});
      continue;
    }
    try {
      Entry& known = entry(name);
      // Not if the program ended before the analysis; resuming the run analyses it.
      const bool analysed = std::filesystem::exists(ResultsFile::path_beside(folder_ / name));
      if (analysed) find_verdict(name, known);
      Json summary = to_json(name, known.summary);
      summary["analysed"] = analysed;
      list.push_back(std::move(summary));
    } catch (const RunFileError& error) {
      list.push_back({{"name", name}, {"state", "unreadable"}, {"why", error.what()}});
    }
  }
  // Forgets deleted runs.
  std::vector<std::string> sorted = all;
  std::sort(sorted.begin(), sorted.end());
  std::erase_if(known_, [&](const auto& known) {
    return !std::binary_search(sorted.begin(), sorted.end(), known.first);
  });
  keep_summaries();
  return list;
}

Json RunLibrary::page(const PageAsked& asked) {
  const Json all = list();
  const std::vector<std::string> words = words_of(pieces::lower(asked.search));
  std::vector<const Json*> found;
  std::size_t unread = 0;
  for (const Json& run : all) {
    if (run["state"] == kNotReadYet) ++unread;
    if (!asked.state.empty() && run["state"] != asked.state) continue;
    if (!asked.item.empty() && !has_item(run, asked.item)) continue;
    if (!asked.bench.empty() && run.value("bench", "") != asked.bench) continue;
    const std::string text = words.empty() ? "" : pieces::lower(run.dump());
    if (std::ranges::all_of(words,
                            [&](const std::string& word) { return text.find(word) != std::string::npos; }))
      found.push_back(&run);
  }
  if (!asked.sort.empty())
    std::ranges::stable_sort(found, [&](const Json* a, const Json* b) {
      const Json first = a->value(asked.sort, Json()), second = b->value(asked.sort, Json());
      return asked.descending ? second < first : first < second;
    });
  Json json = {{"all", all.size()}, {"found", found.size()}, {"unread", unread}};
  std::map<std::string, int> verdicts;
  std::string first, last;
  for (const Json* run : found) {
    if (const std::string verdict = run->value("verdict", ""); !verdict.empty()) ++verdicts[verdict];
    const std::string begun = run->value("created_utc", "");
    if (begun.empty()) continue;
    if (first.empty() || begun < first) first = begun;
    last = std::max(last, begun);
  }
  json["verdicts"] = verdicts;
  json["first_utc"] = first;
  json["last_utc"] = last;
  json["runs"] = Json::array();
  for (std::size_t i = asked.from; i < found.size() && i - asked.from < asked.count; ++i)
    json["runs"].push_back(*found[i]);
  return json;
}

Json RunLibrary::result(const std::filesystem::path& path, int item) {
  const AnalysedRun all = analyse_run(RunFile::load_items(path));
  const AnalysedItem& shown = all.item(shown_item(all.items.front().stored, item));
  const StoredRun& run = shown.stored;
  Json json = {{"run", to_json(path.filename().string(), summary_of(run))}};
  for (std::size_t i = 0; i < all.items.size(); ++i)
    json["run"]["items"][i]["verdict"] = to_string(all.items[i].result().verdict);
  json["dominates"] = Json::array();
  if (const auto budget = budget_of_result(run.record, shown.result()))
    for (const DominatingInput& each : dominating_inputs(*budget)) {
      Json outputs = Json::array();
      for (const auto& [symbol, share] : each.outputs)
        outputs.push_back({{"output", symbol}, {"share", json_number(share)}});
      json["dominates"].push_back(
          {{"input", each.input}, {"message", message_json(each.input)}, {"outputs", std::move(outputs)}});
    }
  json["item"] = run.item;
  json["program_version"] = run.header.program_version;
  json["timing"] = {{"moving_s", run.timing.moving_s},
                    {"settling_s", run.timing.settling_s},
                    {"dwelling_s", run.timing.dwelling_s},
                    {"overhead_s", run.timing.overhead_s}};
  json["instruments"] = Json::array();
  for (const InstrumentIdentity& i : run.header.instruments) {
    json["instruments"].push_back({{"role", i.role},
                                   {"maker", i.maker},
                                   {"model", i.model},
                                   {"serial_number", i.serial_number},
                                   {"firmware", i.firmware},
                                   {"details", i.details}});
  }
  json["events"] = Json::array();
  for (const RunEvent& event : run.events)
    json["events"].push_back({{"utc", event.utc}, {"kind", event.kind}, {"text", event.text.english()}});
  std::vector<Message> texts;
  for (const RunEvent& event : run.events) texts.push_back(event.text);
  json["messages"] = messages_json(texts);
  json["downloads"] = Json::array();
  for (const Download& download : downloads()) {
    if (!download.available || download.available({path, run.item}))
      json["downloads"].push_back({{"name", download.name}, {"words", download.words}});
  }
  const auto issued = current_certificate(path, run.item);
  json["certificate"] = issued ? certificate_json(issued->xml) : Json(nullptr);
  json["norms"] = norms_of(run, shown.result());
  json["results"] = Json::array();
  json["meanings"] = Json::object();
  for (const CalibrationResult& result : shown.results) {
    json["results"].push_back(result_json(result));
    for (const Check& check : result.diagnostics.checks)
      json["meanings"][check.name] = meaning_of_check(check.name);
    for (const FlagCount& flag : result.diagnostics.flags)
      json["meanings"][flag.flag] = meaning_of_flag(flag.flag);
  }
  return json;
}

Json RunLibrary::angles(const std::filesystem::path& path, int item) {
  StoredRun run = RunFile::load(path);
  if (const int shown = shown_item(run, item); shown != run.item) run = RunFile::load(path, shown);
  Json json = {{"item", run.item}, {"unit", run.header.response_unit}, {"flag_words", flag_words()}};
  // Without a UTC of the beginning (simulated time) events have no place on the axis of the times of angles.
  json["begun_utc"] = run.sessions.empty() || !run.sessions.front().begun
                          ? Json(nullptr)
                          : Json(format_utc(*run.sessions.front().begun));
  const auto column = [&](const char* name, const auto& value) {
    Json& values = json[name] = Json::array();
    for (std::size_t i = 0; i < run.dwells.size(); ++i) values.push_back(value(i));
  };
  const auto of_outputs = [&](const char* name, const auto& value) {
    json[name] = Json::array();
    for (int j = 0; j < 3; ++j) {
      Json values = Json::array();
      for (const DwellRecord& dwell : run.dwells) values.push_back(json_number(value(dwell, j)));
      json[name].push_back(std::move(values));
    }
  };
  column("position", [&](std::size_t i) { return run.measured[i]; });
  column("experiment", [&](std::size_t i) { return run.dwells[i].experiment; });
  column("face", [&](std::size_t i) { return run.dwells[i].face; });
  column("alpha_deg", [&](std::size_t i) { return json_number(run.dwells[i].alpha.deg()); });
  column("closing", [&](std::size_t i) { return run.dwells[i].closing; });
  const auto encoder = [](const std::optional<Angle>& angle) {
    return json_number(angle ? std::optional(angle->deg()) : std::nullopt);
  };
  column("encoder_x_deg", [&](std::size_t i) { return encoder(run.dwells[i].encoder_x); });
  column("encoder_z_deg", [&](std::size_t i) { return encoder(run.dwells[i].encoder_z); });
  column("time_s", [&](std::size_t i) { return json_number(run.dwells[i].time_s); });
  column("readings", [&](std::size_t i) { return run.dwells[i].count; });
  column("temperature_degc", [&](std::size_t i) { return json_number(run.dwells[i].temperature_degc); });
  column("flags", [&](std::size_t i) { return run.dwells[i].flags; });
  column("rate_deg_per_s", [&](std::size_t i) {
    const auto& motion = run.dwells[i].motion;
    return json_number(motion ? std::optional(motion->rate_deg_per_s) : std::nullopt);
  });
  of_outputs("mean", [](const DwellRecord& dwell, int j) { return std::optional(dwell.mean[j]); });
  of_outputs("u_mean", [](const DwellRecord& dwell, int j) {
    return dwell.u_mean ? std::optional((*dwell.u_mean)[j]) : std::nullopt;
  });
  return json;
}

Json RunLibrary::readings(const std::filesystem::path& path, int item, std::optional<std::size_t> position,
                          std::size_t columns) {
  const StoredRun run = RunFile::load(path);
  const int shown = shown_item(run, item);
  ThinnedReadings thinned(position ? 1 : run.measured.size(), columns);
  RunFile::read_dwells(
      path,
      [&](const StoredDwell& dwell) {
        if (dwell.repeat || (position && dwell.plan_position != *position)) return;
        thinned.add(dwell.readings);
      },
      shown);
  Json json = {{"item", shown},
               {"unit", run.header.items.at(static_cast<std::size_t>(shown) - 1).response_unit},
               {"readings", thinned.count()},
               {"thinned", thinned.count() > thinned.points().size()},
               {"time_s", Json::array()},
               {"lowest", {Json::array(), Json::array(), Json::array()}},
               {"highest", {Json::array(), Json::array(), Json::array()}}};
  for (const ThinnedReadings::Point& point : thinned.points()) {
    json["time_s"].push_back(json_number(point.time_s));
    for (std::size_t j = 0; j < 3; ++j) {
      json["lowest"][j].push_back(json_number(point.lowest[static_cast<Eigen::Index>(j)]));
      json["highest"][j].push_back(json_number(point.highest[static_cast<Eigen::Index>(j)]));
    }
  }
  return json;
}

std::optional<std::string> RunLibrary::find_item(const std::string& name) const {
  if (const auto run = find(name)) return run->string();
  const std::size_t mark = std::min(name.rfind('#'), name.size());
  const auto run = find(name.substr(0, mark));
  return run ? std::optional(run->string() + name.substr(mark)) : std::nullopt;
}

Json RunLibrary::compare(const std::string& first, const std::string& second, bool shared_stage) {
  std::vector<ComparedResult> results =
      load_compared({first, second}, estimator_to_compare({}, shared_stage), ResultSource::kStored);
  for (ComparedResult& result : results)  // A page refers to runs by name.
    result.file = std::filesystem::path(result.file).filename().string();
  CompareOptions options;
  options.shared_stage = shared_stage;
  options.any_item = true;  // The person has chosen them.
  return compare_json(compare_results(std::move(results), options));
}

RunLibrary::Charted RunLibrary::charted_of(const CalibrationResult& result) {
  Charted charted{std::string(to_string(result.verdict)), {}};
  for (std::size_t i = 0; i < charted.values.size(); ++i) {
    const Quantity& quantity = intrinsic_property(result, static_cast<Eigen::Index>(i));
    charted.values[i] = {quantity.value, quantity.standard_uncertainty, quantity.unit};
  }
  return charted;
}

Json RunLibrary::to_json(const Charted& charted) {
  Json values = Json::array();
  for (const Charted::Value& each : charted.values)
    values.push_back({json_number(each.value), json_number(each.standard_uncertainty), each.unit});
  return {{"verdict", charted.verdict}, {"values", std::move(values)}};
}

RunLibrary::Charted RunLibrary::charted_from(const Json& kept) {
  Charted charted{kept.at("verdict").get<std::string>(), {}};
  for (std::size_t i = 0; i < charted.values.size(); ++i) {
    const Json& each = kept.at("values").at(i);
    charted.values[i] = {number_from(each.at(0)), number_from(each.at(1)), each.at(2).get<std::string>()};
  }
  return charted;
}

/// The lock is held while a summary is looked up or stored, never while a run is analysed: the list of runs
/// waits for nobody's chart.
std::vector<Json> RunLibrary::points_of_chart(const std::string& name, const std::string& serial_number,
                                              std::size_t index) {
  Json point;
  std::vector<int> items;
  std::map<int, Charted> charted;
  std::filesystem::file_time_type time;
  {
    const std::lock_guard lock(mutex_);
    const Entry& known = entry(name);
    const Summary& summary = known.summary;
    if (summary.state != to_string(RunState::kComplete)) return {};
    items = whole_items_of(summary, serial_number);
    if (items.empty()) return {};
    time = known.time;
    charted = known.charted;
    point = {{"name", name},
             {"created_utc", summary.created_utc},
             {"simulated", summary.simulated},
             {"estimator", known.estimator}};
  }
  std::vector<Json> points;
  std::optional<AnalysedRun> analysed;  // Analysed once for all items of the run.
  for (const int item : items) {
    auto found = charted.find(item);
    if (found == charted.end()) {
      if (!analysed)
        analysed = analyse_run(RunFile::load_items(folder_ / name), point["estimator"].get<std::string>());
      found = charted.emplace(item, charted_of(analysed->item(item).results.front())).first;
      const std::lock_guard lock(mutex_);
      const auto known = known_.find(name);  // It may have been deleted or have changed meanwhile.
      if (known != known_.end() && known->second.time == time) {
        known->second.charted.insert(*found);
        have_new_ = true;
      }
    }
    const Charted::Value& value = found->second.values.at(index);
    point["item"] = item;
    point["verdict"] = found->second.verdict;
    point["value"] = json_number(value.value);
    point["standard_uncertainty"] = json_number(value.standard_uncertainty);
    point["unit"] = value.unit;
    points.push_back(point);
  }
  return points;
}

bool RunLibrary::is_charted(const std::string& property) {
  return std::find(kIntrinsicSymbols.begin(), kIntrinsicSymbols.end(), property) != kIntrinsicSymbols.end();
}

Json RunLibrary::history(const std::string& serial_number, const std::string& property) {
  const auto index = static_cast<std::size_t>(
      std::find(kIntrinsicSymbols.begin(), kIntrinsicSymbols.end(), property) - kIntrinsicSymbols.begin());
  Json list = Json::array();
  std::vector<std::string> oldest_first = names();
  std::reverse(oldest_first.begin(), oldest_first.end());
  for (const std::string& name : oldest_first) {
    try {
      for (Json& point : points_of_chart(name, serial_number, index)) list.push_back(std::move(point));
    } catch (const RunFileError&) {
      continue;  // list() reports the reason.
    }
  }
  {
    const std::lock_guard lock(mutex_);
    keep_summaries();
  }
  // Stable: runs in simulated time may all begin at one time.
  std::stable_sort(list.begin(), list.end(), [](const Json& a, const Json& b) {
    return a["created_utc"].get_ref<const std::string&>() < b["created_utc"].get_ref<const std::string&>();
  });
  Json limits = limits_of(list);
  return {{"runs", std::move(list)}, {"limits", std::move(limits)}};
}

}  // namespace abcal::console
