#include "app/laboratory/compare/chart_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "app/results/analysis/result_text.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

std::string status(const ShownChart& chart, std::FILE* stream) {
  if (chart.blocked())
    return emphasised(stream, Emphasis::kBad,
                      "OUTSIDE: issue is blocked for this bench until a person with the right to approve "
                      "lifts it (abcal lab chart lift " +
                          chart.name + " --reason TEXT)") +
           "\n";
  const bool last_outside = !chart.points.empty() && chart.points.back().outside;
  return emphasised(stream, last_outside ? Emphasis::kBad : Emphasis::kGood,
                    chart.points.empty() ? "no points yet"
                    : last_outside       ? "the last point is outside; its block was lifted"
                                         : "in control") +
         "\n";
}

void add_rules(const ShownChart& chart, std::string& text) {
  const ChartRules& rules = chart.baseline.rules;
  text += fmt::format(
      "Limits in standard deviations of the baseline: single value {:.2f}; moving average (weight {:g}) "
      "{:.2f}; cumulative sum (allowance {:.2f}) {:.2f}\n"
      "False alarms: at most one in {:g} check runs on average for nine baselines of ten of {} runs, all "
      "properties and rules together\n",
      rules.shewhart, rules.ewma_weight, rules.ewma_edge(), rules.cusum_allowance, rules.cusum,
      chart.baseline.demand.run_length, chart.baseline.runs.size());
  text += "A lasting shift is seen after, on average:";
  for (const double shift : {1.0, 2.0, 3.0, 5.0, 10.0})
    text += fmt::format("{} {:.3g} runs ({:g} s)", shift == 1.0 ? "" : ",",
                        detection_run_length(rules, shift), shift);
  text += "\n";
}

}  // namespace

bool ShownChart::blocked() const {
  return std::any_of(blocks.begin(), blocks.end(), [](const Block& block) { return block.holds; });
}

std::vector<JudgedPoint> ShownChart::judged() const {
  std::vector<ChartValue> values;
  values.reserve(points.size());
  for (const Point& point : points) values.push_back(point.value);
  return judge_points(baseline, values);
}

std::string chart_text(const ShownChart& chart, std::FILE* stream) {
  const CheckBaseline& baseline = chart.baseline;
  const CheckRun& first = baseline.first();
  std::string text = fmt::format(
      "Chart {}: {} {} {} on {}{}, {} estimator\nBaseline of {} runs, {} to {}, approved by {} at {}{}\n",
      chart.name, first.maker, first.model, first.serial_number, first.bench.stage,
      first.bench.name.empty() ? "" : " (bench " + first.bench.name + ")", first.estimator,
      baseline.runs.size(), first.date, baseline.runs.back().date, chart.approved_by, chart.approved_utc,
      chart.retired.empty() ? "" : "; retired at " + chart.retired);
  add_rules(chart, text);
  const std::array<std::string, 9> units = baseline.units();
  text +=
      fmt::format("\n  {:<8}{:>18} {:>14} {:>18} .. {:<18} {}\n", "", "centre", "s", "from", "to", "unit");
  for (std::size_t i = 0; i < 9; ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    const double centre = baseline.centre(at), s = baseline.standard_deviation(at);
    const int decimals = std::max(0, decimals_for(s));
    text += fmt::format("  {:<8}{:>18.{}f} {:>14.2g} {:>18.{}f} .. {:<18.{}f} {}\n", kIntrinsicSymbols[i],
                        centre, decimals, s, centre - baseline.rules.shewhart * s, decimals,
                        centre + baseline.rules.shewhart * s, decimals, units[i]);
  }
  text += "\n";
  for (const ShownChart::Point& point : chart.points) {
    text += fmt::format("  {}  {}  {}{}  added by {}\n", point.identity, point.date,
                        emphasised(stream, point.outside ? Emphasis::kBad : Emphasis::kGood,
                                   point.outside ? "OUTSIDE: " + point.found : "inside"),
                        point.value.begins_anew ? " (average and sums begin anew)" : "", point.added_by);
  }
  for (const ShownChart::Block& block : chart.blocks) {
    text += fmt::format("  block since {}: {}{}\n", block.set_utc, block.found,
                        block.holds ? ""
                                    : fmt::format("; lifted by {} at {}: {}", block.lifted_by,
                                                  block.lifted_utc, block.reason));
  }
  for (const ShownChart::Waiting& run : chart.waiting)
    text += fmt::format("  {}  {}  measured by {}\n",
                        emphasised(stream, Emphasis::kWarning, "waits to be judged"), run.date, run.told_by) +
            fmt::format("    {}\n", command_to_add(chart.name, run.file));
  return text + status(chart, stream);
}

ShownChart shown_chart(lab::Register& opened, const std::string& name) {
  const lab::CheckStandard standard = opened.check_standard(name);
  ShownChart chart;
  chart.name = standard.name;
  chart.approved_by = standard.approved_by;
  chart.approved_utc = standard.approved_utc;
  chart.retired = standard.retired;
  chart.baseline = baseline_from_json(standard.baseline_json);
  for (const lab::CheckPoint& point : opened.check_points(name))
    chart.points.push_back({point.identity,
                            point.run_sha256,
                            point.date,
                            point.found,
                            point.added_by,
                            point.outside,
                            {values_from_json(point.values_json), point.begins_anew}});
  for (const lab::BenchBlock& block : opened.blocks())
    if (block.check_standard == name)
      chart.blocks.push_back(
          {block.found, block.set_utc, block.lifted_by, block.lifted_utc, block.reason, block.holds()});
  for (const lab::CheckRunNotice& run : opened.waiting_check_runs(name)) {
    const auto& baseline = chart.baseline.runs;
    if (std::none_of(baseline.begin(), baseline.end(),
                     [&](const CheckRun& one) { return one.sha256 == run.run_sha256; }))
      chart.waiting.push_back({run.file, run.date, run.run_sha256, run.told_by});
  }
  return chart;
}

nlohmann::ordered_json chart_json(const ShownChart& chart) {
  Json json{{"schema", "abcal.chart/1"},
            {"name", chart.name},
            {"approved_by", chart.approved_by},
            {"approved_utc", chart.approved_utc},
            {"retired", chart.retired},
            {"blocked", chart.blocked()},
            {"baseline", Json::parse(baseline_json(chart.baseline))},
            {"units", chart.baseline.units()},
            {"detection_run_lengths", Json::array()},
            {"points", Json::array()},
            {"blocks", Json::array()},
            {"waiting", Json::array()}};
  for (const double shift : {1.0, 2.0, 3.0, 5.0, 10.0})
    json["detection_run_lengths"].push_back(
        {{"shift_standard_deviations", shift}, {"runs", detection_run_length(chart.baseline.rules, shift)}});
  const std::vector<JudgedPoint> judged = chart.judged();
  for (std::size_t k = 0; k < chart.points.size(); ++k) {
    const ShownChart::Point& point = chart.points[k];
    Json one{{"identity", point.identity}, {"run_sha256", point.run_sha256},
             {"date", point.date},         {"outside", point.outside},
             {"found", point.found},       {"begins_anew", point.value.begins_anew},
             {"added_by", point.added_by}, {"properties", Json::object()}};
    for (std::size_t i = 0; i < 9; ++i) {
      const JudgedValue& value = judged[k][i];
      one["properties"][kIntrinsicSymbols[i]] = {{"value", point.value.values(static_cast<Eigen::Index>(i))},
                                                 {"z", value.z},
                                                 {"ewma", value.ewma},
                                                 {"cusum_high", value.cusum_high},
                                                 {"cusum_low", value.cusum_low},
                                                 {"outside", value.outside()},
                                                 {"broken", value.broken()}};
    }
    json["points"].push_back(std::move(one));
  }
  for (const ShownChart::Block& block : chart.blocks)
    json["blocks"].push_back({{"found", block.found},
                              {"set_utc", block.set_utc},
                              {"holds", block.holds},
                              {"lifted_by", block.lifted_by},
                              {"lifted_utc", block.lifted_utc},
                              {"reason", block.reason}});
  for (const ShownChart::Waiting& run : chart.waiting)
    json["waiting"].push_back(
        {{"file", run.file}, {"date", run.date}, {"run_sha256", run.run_sha256}, {"told_by", run.told_by}});
  return json;
}

std::string command_to_add(const std::string& chart, const std::string& file) {
  const auto quoted = [](const std::string& word) {
    return word.find_first_of(" '\"$`\\&;()<>|*?") == std::string::npos ? word : fmt::format("\"{}\"", word);
  };
  return fmt::format("abcal lab chart add {} {}", quoted(chart), quoted(file));
}

std::string chart_script(const ShownChart& chart) {
  const CheckBaseline& baseline = chart.baseline;
  const std::vector<JudgedPoint> judged = chart.judged();
  std::string script = "set multiplot layout 3,3\nunset key\nset grid ytics\nset tics nomirror\n";
  const double limit = baseline.rules.shewhart, edge = baseline.rules.ewma_edge();
  for (std::size_t i = 0; i < 9; ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    const auto z_of = [&](const IntrinsicValues& values) {
      return (values(at) - baseline.centre(at)) / baseline.standard_deviation(at);
    };
    std::string before, after, averages, outside;
    double largest = limit;
    int number = 0;
    for (const CheckRun& run : baseline.runs)
      before += fmt::format("{} {:.6g}\n", ++number, z_of(run.values));
    for (const JudgedPoint& point : judged) {
      const JudgedValue& value = point[i];
      after += fmt::format("{} {:.6g}\n", ++number, value.z);
      averages += fmt::format("{} {:.6g}\n", number, value.ewma);
      if (value.outside()) outside += fmt::format("{} {:.6g}\n", number, value.z);
      largest = std::max(largest, std::abs(value.z));
    }
    // A block without rows is an error for gnuplot.
    for (std::string* rows : {&after, &averages, &outside})
      if (rows->empty()) *rows = "NaN NaN\n";
    script += fmt::format(
        "$before{0} << EOD\n{1}EOD\n$after{0} << EOD\n{2}EOD\n$average{0} << EOD\n{3}EOD\n$outside{0} << "
        "EOD\n{4}EOD\n",
        i, before, after, averages, outside);
    script += fmt::format(
        "set title '{1} (standard deviations)'\nset xrange [0:{2}]\nset yrange [{3:.6g}:{4:.6g}]\n"
        "plot {5:.6g} lc rgb 'red', {6:.6g} lc rgb 'red', {7:.6g} dt 2 lc rgb 'orange', {8:.6g} dt 2 lc rgb "
        "'orange', $before{0} using 1:2 with points pt 6 lc rgb 'gray40', $after{0} using 1:2 with points pt "
        "7 lc rgb 'black', $average{0} using 1:2 with lines lc rgb 'orange', $outside{0} using 1:2 with "
        "points pt 7 lc rgb 'red'\n",
        i, kIntrinsicSymbols[i], number + 1, -1.15 * largest, 1.15 * largest, limit, -limit, edge, -edge);
  }
  return script + "unset multiplot\n";
}

}  // namespace abcal
