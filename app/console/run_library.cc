#include "app/console/run_library.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "app/console/download.h"
#include "app/console/flag_words.h"
#include "app/console/thinned_readings.h"
#include "app/document/json_text.h"
#include "app/laboratory/certificate/certificate_json.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/compare/compare_json.h"
#include "app/laboratory/compare/compare_results.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/budget_words.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/result_json.h"
#include "app/results/export/constants.h"
#include "protocol/estimators/checks/check_meanings.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/record/message_json.h"
#include "protocol/uncertainty/control_chart.h"

namespace abcal::console {
namespace {

using Json = nlohmann::ordered_json;

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

/// The properties that a chart shows, by the estimator that the run declares.
Json charted_of(const CalibrationResult& result) {
  Json values = Json::array();
  for (Eigen::Index i = 0; i < 9; ++i) {
    const Quantity& quantity = intrinsic_property(result, i);
    values.push_back(
        {json_number(quantity.value), json_number(quantity.standard_uncertainty), quantity.unit});
  }
  return {{"verdict", to_string(result.verdict)}, {"values", std::move(values)}};
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

constexpr const char* kRun = ".run";
constexpr const char* kMeasurement = ".measurement";

/// The file of this name and kind in a folder. A name with a path in it is that of no file.
std::optional<std::filesystem::path> file_in(const std::filesystem::path& folder, const std::string& name,
                                             std::string_view extension) {
  std::error_code error;
  for (std::filesystem::directory_iterator at(folder, error), end; !error && at != end; at.increment(error))
    if (at->path().filename().string() == name && is_own_file(at->path(), extension)) return at->path();
  return std::nullopt;
}

/// Adds the parts of a page on a result: inputs that dominate it, downloads, the certificate, all estimators.
/// @param of  the file that it is of, and the number of the item
void add_result(Json& json, const AnalysedItem& shown, const ItemOfRun& of) {
  json["dominates"] = Json::array();
  if (const auto budget = budget_of_result(shown.stored.record, shown.result()))
    for (const DominatingInput& each : dominating_inputs(*budget)) {
      Json outputs = Json::array();
      for (const auto& [symbol, share] : each.outputs)
        outputs.push_back({{"output", symbol}, {"share", json_number(share)}});
      json["dominates"].push_back(
          {{"input", each.input}, {"message", message_json(each.input)}, {"outputs", std::move(outputs)}});
    }
  json["item"] = of.item;
  json["downloads"] = Json::array();
  for (const Download& download : downloads())
    if (!download.available || download.available(of))
      json["downloads"].push_back({{"name", download.name}, {"words", download.words}});
  const auto issued = current_certificate(of.run, of.item);
  json["certificate"] = issued ? certificate_json(issued->xml) : Json(nullptr);
  json["results"] = Json::array();
  json["meanings"] = Json::object();
  for (const CalibrationResult& result : shown.results) {
    json["results"].push_back(result_json(result));
    for (const Check& check : result.diagnostics.checks)
      json["meanings"][check.name] = meaning_of_check(check.name);
    for (const FlagCount& flag : result.diagnostics.flags)
      json["meanings"][flag.flag] = meaning_of_flag(flag.flag);
  }
}

}  // namespace

RunLibrary::RunLibrary(std::filesystem::path folder) : folder_(std::move(folder)), index_(folder_) {}

std::optional<std::filesystem::path> RunLibrary::find_in(const std::filesystem::path& folder,
                                                         const std::string& name) {
  return file_in(folder, name, kRun);
}

Json RunLibrary::list(std::chrono::milliseconds patience) {
  PageAsked all;
  all.count = std::numeric_limits<std::ptrdiff_t>::max();
  return index_.page(all, patience).runs;
}

Json RunLibrary::page(const PageAsked& asked) {
  RunIndex::Page page = index_.page(asked, kPatience);
  return {{"all", page.all},
          {"found", page.found},
          {"unread", page.unread},
          {"verdicts", page.verdicts},
          {"first_utc", page.first_utc},
          {"last_utc", page.last_utc},
          {"runs", std::move(page.runs)}};
}

Json RunLibrary::result(const std::filesystem::path& path, int item) {
  const AnalysedRun all = analyse_run(RunFile::load_items(path));
  const AnalysedItem& shown = all.item(shown_item(all.items.front().stored, item));
  const StoredRun& run = shown.stored;
  Json json = {{"run", run_summary(path.filename().string(), run)}};
  for (std::size_t i = 0; i < all.items.size(); ++i)
    json["run"]["items"][i]["verdict"] = to_string(all.items[i].result().verdict);
  add_result(json, shown, {path, run.item});
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
  json["norms"] = norms_of(run, shown.result());
  return json;
}

std::optional<std::filesystem::path> RunLibrary::find_measurement(const std::string& name) const {
  return file_in(folder_, name, kMeasurement);
}

Json RunLibrary::measurements() {
  std::vector<Json> list;
  std::error_code error;
  for (std::filesystem::directory_iterator at(folder_, error), end; !error && at != end;
       at.increment(error)) {
    const std::filesystem::path& path = at->path();
    if (!is_own_file(path, kMeasurement)) continue;
    Json json = {{"name", path.filename().string()}};
    try {
      const MeasurementFile measurement = listed_measurement(path);
      json["created_utc"] = measurement.created_utc;
      json["items"] = measurement.items;
      json["runs"] = measurement.runs.size();
      json["verdict"] = kept_verdict(path, std::string(kDefaultEstimator));
      const Json first = measurement.runs.empty()
                             ? Json(nullptr)
                             : index_.summary(measurement.runs.front().path.filename().string());
      json["simulated"] = first.is_null() ? Json(nullptr) : first.value("simulated", Json(nullptr));
    } catch (const std::exception& problem) {
      json["why"] = problem.what();
    }
    list.push_back(std::move(json));
  }
  std::ranges::stable_sort(list, std::ranges::greater(), [](const Json& each) {
    return std::pair(each.value("created_utc", ""), each.at("name").get<std::string>());
  });
  return list;
}

Json RunLibrary::measurement(const std::filesystem::path& path, int item) {
  const AnalysedRun all = analyse_file(path);
  const int count = static_cast<int>(all.items.size()), shown = std::max(item, 1);
  if (shown > count)
    throw std::invalid_argument(
        fmt::format("{}: item {}; required: 1 to {}", path.filename().string(), shown, count));
  Json json = {
      {"measurement", {{"name", path.filename().string()}, {"items", count}, {"runs", Json::array()}}}};
  for (const RunOfMeasurement& run : all.runs) {
    const std::filesystem::path file = run.file;
    json["measurement"]["runs"].push_back(run_summary(file.filename().string(), run.stored()));
    // A page shows the run only where it is in the folder of the console.
    json["measurement"]["runs"].back()["is_here"] = find(file.filename().string()) == file;
    json["measurement"]["runs"].back()["sha256"] = run.sha256;
  }
  add_result(json, all.item(shown), {path, shown});
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

bool RunLibrary::is_charted(const std::string& property) {
  return std::find(kIntrinsicSymbols.begin(), kIntrinsicSymbols.end(), property) != kIntrinsicSymbols.end();
}

Json RunLibrary::history(const std::string& serial_number, const std::string& property,
                         const std::stop_token& stop) {
  const auto index = static_cast<std::size_t>(
      std::find(kIntrinsicSymbols.begin(), kIntrinsicSymbols.end(), property) - kIntrinsicSymbols.begin());
  Json list = Json::array();
  for (RunIndex::RunOfItem& run : index_.runs_of_item(serial_number, stop)) {
    try {
      std::optional<AnalysedRun> analysed;  // Once for all items of the run.
      for (const int item : run.items) {
        if (!run.charted.contains(item)) {
          if (!analysed) analysed = analyse_run(RunFile::load_items(folder_ / run.name), run.estimator);
          run.charted[item] = charted_of(analysed->item(item).results.front());
          index_.keep_charted(run, item, run.charted[item]);
        }
        const Json& charted = run.charted[item];
        const Json& value = charted.at("values").at(index);
        list.push_back({{"name", run.name},
                        {"created_utc", run.created_utc},
                        {"simulated", run.simulated},
                        {"estimator", run.estimator},
                        {"item", item},
                        {"verdict", charted.at("verdict")},
                        {"value", value.at(0)},
                        {"standard_uncertainty", value.at(1)},
                        {"unit", value.at(2)}});
      }
    } catch (const RunFileError&) {
      continue;  // list() reports the reason.
    }
  }
  // Stable: runs in simulated time may all begin at one time.
  std::stable_sort(list.begin(), list.end(), [](const Json& a, const Json& b) {
    return a["created_utc"].get_ref<const std::string&>() < b["created_utc"].get_ref<const std::string&>();
  });
  Json limits = limits_of(list);
  return {{"runs", std::move(list)}, {"limits", std::move(limits)}};
}

}  // namespace abcal::console
