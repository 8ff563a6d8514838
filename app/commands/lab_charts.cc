#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/commands/lab.h"
#include "app/document/gnuplot.h"
#include "app/laboratory/compare/chart_report.h"
#include "app/laboratory/compare/check_chart.h"
#include "app/results/analysis/report_data.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"

namespace abcal {
namespace {

CheckRun read_check_run(const lab::Register& opened, const std::string& path, Clock::UtcTime now) {
  CheckRun run = check_run_of(gather_report(path, now));
  if (run.simulated && !opened.facts().training)
    throw CheckChartError(path +
                          ": its instruments are simulated; only a training register charts such a run");
  return run;
}

/// The item of a run as the register names it.
std::string item_of(lab::Register& opened, const CheckRun& run) {
  for (const lab::Item& item : opened.items())
    if (item.retired.empty() && item.maker == run.maker && item.model == run.model &&
        item.serial_number == run.serial_number)
      return item.identity;
  throw CheckChartError(fmt::format(
      "item {} {} {}: is not in the register; add it: abcal lab add item --maker \"{}\" --model \"{}\" "
      "--serial-number \"{}\"",
      run.maker, run.model, run.serial_number, run.maker, run.model, run.serial_number));
}

void print_chart(const ShownChart& chart, bool json) {
  if (json) {
    print_result("{}\n", chart_json(chart).dump(2));
  } else {
    print_result("{}", chart_text(chart, stdout));
  }
}

/// Whether the next point restarts average and sums: it is the first after a block was lifted.
bool begins_anew(const ShownChart& chart) {
  if (chart.points.empty() || chart.blocks.empty() || chart.blocked()) return false;
  return chart.points.back().outside;
}

struct ChartOptions {
  std::string name, run, reason, plot;
  std::vector<std::string> runs;
  double run_length = kUsualRunLength;
  bool json = false, force = false;
};

int approve(const LabOptions& shared, const ChartOptions& options) {
  lab::Register opened = open_register(shared);
  const auto now = RealClock().utc_now();
  const lab::LoggedIn by = lab::require_login(opened, now);
  std::vector<CheckRun> runs;
  for (const std::string& path : options.runs) runs.push_back(read_check_run(opened, path, now));
  const CheckBaseline baseline = make_baseline(std::move(runs), options.run_length);
  opened.add_check_standard(
      by, {options.name, item_of(opened, baseline.first()), baseline_json(baseline), {}, {}, {}},
      RealClock().utc_now());
  print_chart(shown_chart(opened, options.name), options.json);
  return kExitDone;
}

int add_point(const LabOptions& shared, const ChartOptions& options) {
  lab::Register opened = open_register(shared);
  const auto now = RealClock().utc_now();
  const lab::LoggedIn by = lab::require_login(opened, now);
  ShownChart chart = shown_chart(opened, options.name);
  const CheckRun run = read_check_run(opened, options.run, now);
  const std::string last_date =
      chart.points.empty() ? chart.baseline.runs.back().date : chart.points.back().date;
  if (const std::string why = against_point(chart.baseline, run, last_date); !why.empty())
    throw CheckChartError(why);
  const std::size_t points_before = chart.points.size();
  ShownChart::Point point;
  point.value = {run.values, begins_anew(chart)};
  chart.points.push_back(point);
  std::string found = outside_words(chart.judged().back());
  if (!run.doubtful.empty())
    found += (found.empty() ? "" : "; ") + fmt::format("its result is doubtful: {}", run.doubtful);

  lab::CheckPoint kept;
  kept.check_standard = options.name;
  kept.run_sha256 = run.sha256;
  kept.date = run.date;
  kept.values_json = values_json(run.values);
  kept.outside = !found.empty();
  kept.found = found;
  kept.begins_anew = point.value.begins_anew;
  lab::BenchBlock block;
  block.stage = run.bench.stage;
  block.bench = run.bench.name;
  opened.add_check_point(by, kept, points_before, block, RealClock().utc_now());
  print_chart(shown_chart(opened, options.name), options.json);
  return kept.outside ? kExitFailed : kExitDone;
}

int show(const LabOptions& shared, const ChartOptions& options) {
  if (!options.plot.empty()) require_writable({{"--plot", options.plot}}, {}, options.force);
  lab::Register opened = open_register(shared);
  const ShownChart chart = shown_chart(opened, options.name);
  if (!options.plot.empty()) OutputFile(options.plot).write(draw_svg(chart_script(chart), 800));
  print_chart(chart, options.json);
  return chart.blocked() ? kExitFailed : kExitDone;
}

void lift(const LabOptions& shared, const ChartOptions& options) {
  lab::Register opened = open_register(shared);
  const auto now = RealClock().utc_now();
  const lab::LoggedIn by = lab::require_login(opened, now);
  opened.lift_block(by, options.name, options.reason, now);
  print_result("the block of chart {} is lifted by {}: {}\n", options.name, by.name(), options.reason);
}

}  // namespace

void add_lab_charts(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  CLI::App* chart = parent.add_subcommand(
      "chart", "Control charts of check standards: an approved baseline, and later runs judged by it");
  chart->require_subcommand(1);
  const auto add_command = [&](const char* name, const char* words, bool with_json) {
    auto options = std::make_shared<ChartOptions>();
    CLI::App* command = chart->add_subcommand(name, words);
    command->add_option("NAME", options->name, "name of the chart")->required();
    if (with_json) command->add_flag("--json", options->json, "print one JSON object, schema abcal.chart/1");
    return std::pair{command, options};
  };

  auto [approving, approval] =
      add_command("approve", "Freeze the baseline of a new chart; needs the right to approve", true);
  approving
      ->add_option("RUN", approval->runs, fmt::format("at least {} runs of the item", kFewestBaselineRuns))
      ->required()
      ->expected(1, 1000);
  approving
      ->add_option("--run-length", approval->run_length,
                   fmt::format("check runs between two false alarms (default: {:g})", kUsualRunLength))
      ->check(CLI::Range(10.0, 1e5));
  approving->callback([shared, options = approval, &exit_code] { exit_code = approve(*shared, *options); });

  auto [adding, addition] = add_command(
      "add", "Judge a later run and keep it; outside: exit code 1, and issue is blocked for its bench", true);
  adding->add_option("RUN", addition->run, "run of the check standard")->required();
  adding->callback([shared, options = addition, &exit_code] { exit_code = add_point(*shared, *options); });

  auto [showing, shown] = add_command("show", "Show a chart; exit code 1 while it blocks its bench", true);
  showing->add_option("--plot", shown->plot, "draw it to this file (SVG)");
  showing->add_flag("--force", shown->force, "overwrite a file that exists");
  showing->callback([shared, options = shown, &exit_code] { exit_code = show(*shared, *options); });

  auto [lifting, lifted] =
      add_command("lift", "Lift the block of a chart; needs the right to approve", false);
  lifting->add_option("--reason", lifted->reason, "what was found and done")->required();
  lifting->callback([shared, options = lifted, &exit_code] {
    lift(*shared, *options);
    exit_code = kExitDone;
  });
}

}  // namespace abcal
