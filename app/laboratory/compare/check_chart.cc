#include "app/laboratory/compare/check_chart.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "protocol/record/run_label.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kRulesOfAPoint = 9 * 3;    // Nine properties by three rules.
constexpr double kFalseOutliers = 0.01;  // Probability for a sound baseline, all properties together.
constexpr const char* kSchema = "abcal.chart_baseline/1";

std::string joined(const std::string& first, const std::string& second) {
  return first.empty() || second.empty() ? first + second : first + " " + second;
}

std::string item_of(const ChartSubject& subject) {
  return joined(joined(subject.maker, subject.model), subject.serial_number);
}

/// Adds the differences between a run and the first of its chart.
void add_differences(const CheckRun& first, const CheckRun& run, std::vector<std::string>& problems) {
  std::vector<ChartDifference> found = differences(first, run);
  if (run.estimator != first.estimator) found.push_back({"estimator", run.estimator, first.estimator});
  if (run.response_unit != first.response_unit)
    found.push_back({"response unit", run.response_unit, first.response_unit});
  for (const ChartDifference& each : found)
    problems.push_back(fmt::format("{}: {} {}; required: {}, as the chart has", run.file, each.what,
                                   each.found, each.required));
}

std::vector<std::string> problems_of(const std::vector<CheckRun>& runs) {
  std::vector<std::string> problems;
  if (runs.size() < kFewestBaselineRuns)
    problems.push_back(
        fmt::format("{} runs; a baseline needs at least {}", runs.size(), kFewestBaselineRuns));
  std::set<std::string> seen;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (!seen.insert(runs[i].sha256).second)
      problems.push_back(fmt::format("{}: stands twice", runs[i].file));
    if (!runs[i].doubtful.empty())
      problems.push_back(fmt::format("{}: its result is doubtful: {}", runs[i].file, runs[i].doubtful));
    if (i > 0) add_differences(runs.front(), runs[i], problems);
  }
  return problems;
}

void add_scatter_problems(const CheckBaseline& baseline, std::vector<std::string>& problems) {
  const double limit = outlier_limit(static_cast<int>(baseline.runs.size()), kFalseOutliers / 9.0);
  const std::array<std::string, 9> units = baseline.units();
  for (Eigen::Index i = 0; i < 9; ++i) {
    const std::string_view name = kIntrinsicSymbols[static_cast<std::size_t>(i)];
    const double s = baseline.standard_deviation(i);
    if (!(s > 0.0) || !std::isfinite(s)) {
      problems.push_back(fmt::format("{}: does not scatter at all (standard deviation {} {})", name, s,
                                     units[static_cast<std::size_t>(i)]));
      continue;
    }
    for (const CheckRun& run : baseline.runs) {
      const double distance = std::abs(run.values(i) - baseline.centre(i)) / s;
      if (distance > limit)
        problems.push_back(
            fmt::format("{}: {} is {:.2f} standard deviations from the mean; required: at most {:.2f} "
                        "(outlier by Grubbs' test)",
                        run.file, name, distance, limit));
    }
  }
}

Json to_json(const CheckRun& run) {
  return {{"file", run.file},
          {"sha256", run.sha256},
          {"date", run.date},
          {"values", Json::parse(values_json(run.values))}};
}

}  // namespace

ChartSubject subject_of(const StoredRun& run) {
  const auto label = [&](const char* key) { return label_of(run.header.labels, key); };
  ChartSubject subject{
      label("item.maker"), label("item.model"), label("item.serial_number"), {{}, label("bench.name")}};
  for (const InstrumentIdentity& instrument : run.header.instruments) {
    if (instrument.role != "stage") continue;
    subject.bench.stage = joined(instrument.model, instrument.serial_number);
    subject.bench.stage_serial_number = instrument.serial_number;
  }
  return subject;
}

std::vector<ChartDifference> differences(const ChartSubject& of_chart, const ChartSubject& of_run) {
  std::vector<ChartDifference> found{{"item", item_of(of_run), item_of(of_chart)},
                                     {"stage", of_run.bench.stage, of_chart.bench.stage},
                                     {"bench", of_run.bench.name, of_chart.bench.name}};
  std::erase_if(found, [](const ChartDifference& each) { return each.found == each.required; });
  return found;
}

CheckRun check_run_of(const ReportData& data) {
  const std::string file = data.path.string();
  if (!data.run) throw CheckChartError(file + ": is no run file; required: a run");
  std::vector<std::string> problems;
  if (!data.complete() || !data.sha256)
    problems.push_back(fmt::format("is {}; required: complete", to_string(data.run->state)));
  if (data.complete()) {
    for (const IntegrityCheck& check : data.integrity)
      if (!check.good) problems.push_back(fmt::format("{}: {}", check.what, check.found));
  }
  if (!data.label("replay.of").empty())
    problems.push_back("repeats the recording of " + data.label("replay.of") + "; required: measured");
  const CalibrationResult& result = data.result();
  CheckRun run;
  run.values = intrinsic_values(result);
  if (result.verdict == Verdict::kNotUsable || !run.values.allFinite())
    problems.push_back("has no usable result: " + result.why);
  static_cast<ChartSubject&>(run) = subject_of(*data.run);
  if (run.bench.stage.empty() && run.bench.name.empty())
    problems.emplace_back(
        "does not say on which bench; required: [bench] name, or a stage that tells what it is");
  if (!problems.empty()) throw CheckChartError(fmt::format("{}: {}", file, fmt::join(problems, "; ")));
  if (result.verdict == Verdict::kDoubtful) run.doubtful = result.why;
  run.file = file;
  run.sha256 = *data.sha256;
  run.date = data.started_utc();
  run.estimator = data.estimator;
  run.response_unit = result.response_unit;
  run.simulated = !data.simulated.empty();
  return run;
}

std::array<std::string, 9> CheckBaseline::units() const {
  const std::string& unit = first().response_unit;
  const std::string per_g = (unit.find('/') == std::string::npos ? unit : "(" + unit + ")") + "/g_loc";
  return {per_g, per_g, per_g, "degree", "degree", "degree", unit, unit, unit};
}

CheckBaseline make_baseline(std::vector<CheckRun> runs, double run_length) {
  std::vector<std::string> problems = problems_of(runs);
  if (!problems.empty()) throw CheckChartError(fmt::format("baseline: {}", fmt::join(problems, "; ")));
  std::stable_sort(runs.begin(), runs.end(),
                   [](const CheckRun& a, const CheckRun& b) { return a.date < b.date; });
  CheckBaseline baseline;
  baseline.runs = std::move(runs);
  const auto n = static_cast<double>(baseline.runs.size());
  baseline.centre.setZero();
  for (const CheckRun& run : baseline.runs) baseline.centre += run.values / n;
  IntrinsicValues squares = IntrinsicValues::Zero();
  for (const CheckRun& run : baseline.runs) squares += (run.values - baseline.centre).cwiseAbs2();
  baseline.standard_deviation = (squares / (n - 1.0)).cwiseSqrt();
  add_scatter_problems(baseline, problems);
  if (!problems.empty()) throw CheckChartError(fmt::format("baseline: {}", fmt::join(problems, "; ")));
  baseline.demand = {static_cast<int>(baseline.runs.size()), kRulesOfAPoint, run_length, 0.9};
  baseline.rules = design_rules(baseline.demand);
  return baseline;
}

std::string values_json(const IntrinsicValues& values) {
  Json json = Json::object();
  for (std::size_t i = 0; i < 9; ++i) json[kIntrinsicSymbols[i]] = values(static_cast<Eigen::Index>(i));
  return json.dump();
}

namespace {

IntrinsicValues values_of(const nlohmann::json& json) {
  IntrinsicValues values;
  for (std::size_t i = 0; i < 9; ++i)
    values(static_cast<Eigen::Index>(i)) = json.at(kIntrinsicSymbols[i]).get<double>();
  return values;
}

template <class Read>
auto read_json(const std::string& text, const Read& read) {
  try {
    return read(nlohmann::json::parse(text));
  } catch (const nlohmann::json::exception& error) {
    throw CheckChartError(std::string("what the register keeps of a chart cannot be read: ") + error.what());
  }
}

}  // namespace

IntrinsicValues values_from_json(const std::string& text) {
  return read_json(text, [](const nlohmann::json& json) { return values_of(json); });
}

std::string baseline_json(const CheckBaseline& baseline) {
  const CheckRun& first = baseline.first();
  Json json{
      {"schema", kSchema},
      {"item", {{"maker", first.maker}, {"model", first.model}, {"serial_number", first.serial_number}}},
      {"stage", first.bench.stage},
      {"bench", first.bench.name},
      {"estimator", first.estimator},
      {"response_unit", first.response_unit},
      {"runs", Json::array()},
      {"centre", Json::parse(values_json(baseline.centre))},
      {"standard_deviation", Json::parse(values_json(baseline.standard_deviation))},
      {"rules",
       {{"shewhart", baseline.rules.shewhart},
        {"ewma_weight", baseline.rules.ewma_weight},
        {"ewma", baseline.rules.ewma},
        {"cusum_allowance", baseline.rules.cusum_allowance},
        {"cusum", baseline.rules.cusum}}},
      {"run_length", baseline.demand.run_length},
      {"certainty", baseline.demand.certainty}};
  for (const CheckRun& run : baseline.runs) json["runs"].push_back(to_json(run));
  return json.dump();
}

CheckBaseline baseline_from_json(const std::string& text) {
  return read_json(text, [](const nlohmann::json& json) {
    if (json.value("schema", "") != kSchema)
      throw CheckChartError(fmt::format("a chart's baseline has schema \"{}\"; required: {}",
                                        json.value("schema", ""), kSchema));
    CheckBaseline baseline;
    CheckRun common;
    common.maker = json.at("item").at("maker");
    common.model = json.at("item").at("model");
    common.serial_number = json.at("item").at("serial_number");
    common.bench = {json.at("stage"), json.at("bench")};
    common.estimator = json.at("estimator");
    common.response_unit = json.at("response_unit");
    for (const auto& one : json.at("runs")) {
      CheckRun run = common;
      run.file = one.at("file");
      run.sha256 = one.at("sha256");
      run.date = one.at("date");
      run.values = values_of(one.at("values"));
      baseline.runs.push_back(std::move(run));
    }
    if (baseline.runs.empty()) throw CheckChartError("a chart's baseline has no runs");
    baseline.centre = values_of(json.at("centre"));
    baseline.standard_deviation = values_of(json.at("standard_deviation"));
    const auto& rules = json.at("rules");
    baseline.rules = {rules.at("shewhart"), rules.at("ewma_weight"), rules.at("ewma"),
                      rules.at("cusum_allowance"), rules.at("cusum")};
    baseline.demand = {static_cast<int>(baseline.runs.size()), kRulesOfAPoint, json.at("run_length"),
                       json.at("certainty")};
    return baseline;
  });
}

std::vector<JudgedPoint> judge_points(const CheckBaseline& baseline, const std::vector<ChartValue>& points) {
  std::array<ChartState, 9> states{};
  std::vector<JudgedPoint> judged;
  for (const ChartValue& point : points) {
    if (point.begins_anew) states = {};
    JudgedPoint& now = judged.emplace_back();
    for (std::size_t i = 0; i < 9; ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      now[i] = judge(baseline.rules,
                     (point.values(at) - baseline.centre(at)) / baseline.standard_deviation(at), states[i]);
    }
  }
  return judged;
}

std::string outside_words(const JudgedPoint& point) {
  std::vector<std::string> words;
  for (std::size_t i = 0; i < 9; ++i) {
    if (point[i].outside())
      words.push_back(fmt::format("{} {:+.1f} standard deviations from the baseline ({})",
                                  kIntrinsicSymbols[i], point[i].z, point[i].broken()));
  }
  return fmt::format("{}", fmt::join(words, "; "));
}

std::string against_point(const CheckBaseline& baseline, const CheckRun& run, const std::string& last_date) {
  std::vector<std::string> problems;
  add_differences(baseline.first(), run, problems);
  for (const CheckRun& one : baseline.runs)
    if (one.sha256 == run.sha256) problems.push_back(run.file + ": is a run of the baseline");
  if (run.date < last_date)
    problems.push_back(fmt::format(
        "{}: measured at {}, before the last of the chart, {}; required: runs in the order of their time",
        run.file, run.date, last_date));
  return fmt::format("{}", fmt::join(problems, "; "));
}

}  // namespace abcal
