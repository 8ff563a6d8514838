#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/commands/commands.h"
#include "app/commands/plan_reach.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/document/write_pdf.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/session/temperature_series.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/temperature_points.h"
#include "app/results/report/temperature_report.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/progress.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_label.h"

namespace abcal {
namespace {

struct TemperatureOptions {
  std::string bench_file, output, html, pdf;
  int item = 0;
  bool analyse_only = false, json = false;
  ReachOptions plan;
};

/// "BENCH-temperature" in the working folder, or the path of -o without its ending: the same in each call, so
/// that a series that ended early is continued.
std::filesystem::path stem_of(const TemperatureOptions& options) {
  std::filesystem::path stem =
      options.output.empty() ? std::filesystem::path(options.bench_file).stem().string() + "-temperature"
                             : options.output;
  if (stem.extension() == ".run") stem.replace_extension();
  return stem;
}

/// The bench of a series, with the plan of its points.
struct PlannedSeries {
  BenchConfig config;
  std::string plan_words;  ///< As TemperatureSeries::Request has them.
};

/// Finds the requested plan. A series that is continued keeps the plan of its first point, without a new
/// search.
PlannedSeries with_plan(const TemperatureOptions& options, BenchConfig config) {
  PlannedSeries series{std::move(config), question_words(options.plan)};
  ProtocolConfig& protocol = series.config.protocol;
  const std::filesystem::path first = series_paths(stem_of(options), 1).front();
  if (std::filesystem::exists(first)) {
    const RunHeader header = RunFile::load(first).header;
    const std::string kept = label_of(header.labels, kPlanLabel);
    if (!series.plan_words.empty() && series.plan_words != kept)
      throw std::invalid_argument(fmt::format(
          "{}: was measured with {}; found: {}; required: the same for all points of a series, or another "
          "name with -o",
          first.string(), kept.empty() ? "the plan of the bench file" : "a plan found for: " + kept,
          series.plan_words));
    if (kept.empty()) return series;
    const ProtocolConfig measured = parse_bench(header.bench_toml, first.string()).protocol;
    protocol.steps = measured.steps;
    protocol.step = measured.step;
    protocol.dwell_readings = measured.dwell_readings;
    series.plan_words = kept;
    return series;
  }
  if (series.plan_words.empty()) return series;
  const PlanPrediction found = find_plan(options.plan, series.config);
  protocol = found.protocol;
  print_log("Plan of each point, found for {}: 3 x {} angles of {:g} deg, {} readings at each; about {}\n",
            series.plan_words, protocol.steps, protocol.step.deg(), protocol.dwell_readings,
            describe_duration(found.duration.total_s()));
  return series;
}

std::vector<std::filesystem::path> measure(const TemperatureOptions& options, const BenchConfig& config) {
  const PlannedSeries planned = with_plan(options, config);
  std::optional<TerminalListener> terminal;
  TemperatureSeries::Options series;
  series.session.analyst = make_run_analyst();
  series.session.laboratory = laboratory_link();
  series.session.stop = interrupt_token();
  series.session.listener = [&](const SessionEvent& event) {
    if (std::holds_alternative<RunBeganEvent>(event) || !terminal)
      terminal.emplace(TerminalListener::Options{.title = "Calibrating", .introduce = false});
    terminal->on(event);
  };
  series.tell = [](const std::string& text) { print_log("{}\n", text); };
  try {
    return TemperatureSeries(std::move(series))
        .measure({planned.config, options.bench_file, stem_of(options), planned.plan_words});
  } catch (...) {
    print_log("The series goes on where it ended with: abcal temperature {}{}\n", options.bench_file,
              options.output.empty() ? std::string() : " -o " + options.output);
    throw;
  }
}

/// One report for the requested item, or one for each item.
std::vector<TemperatureReport> reports_of(const TemperatureOptions& options,
                                          const std::vector<std::filesystem::path>& paths) {
  std::vector<TemperatureReport> reports;
  for (AnalysedSeries& series : analyse_series(paths))
    reports.push_back(
        {paths, std::move(series.item), std::move(series.response_unit), std::move(series.result)});
  if (options.item != 0) reports = {reports.at(static_cast<std::size_t>(options.item) - 1)};
  return reports;
}

/// All foreseeable errors are reported before the first point is measured.
void check_item(const TemperatureOptions& options, const BenchConfig& config) {
  const auto count = static_cast<int>(config.items.size());
  const bool wants_pages = !options.html.empty() || !options.pdf.empty();
  if (options.item >= 0 && options.item <= count && (options.item != 0 || count == 1 || !wants_pages)) return;
  throw std::invalid_argument(fmt::format("{} has {} items; required: --item 1 to {}{}", options.bench_file,
                                          count, count, wants_pages ? ", whose page is written" : ""));
}

void write_pages(const TemperatureOptions& options, const Document& document) {
  if (!options.html.empty()) OutputFile(options.html).write(document_html(document));
  if (options.pdf.empty()) return;
  OutputFile file(options.pdf);
  write_pdf(document, file.temporary(), std::nullopt, [] { return interrupt_token().stop_requested(); });
  file.commit();
}

}  // namespace

CLI::App* add_temperature(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<TemperatureOptions>();
  CLI::App* command = parent.add_subcommand(
      "temperature", "Calibrate over temperature: a run at every set point of a thermal chamber");
  command->add_option("BENCH", options->bench_file, "bench file (TOML) with [chamber] and [temperature]")
      ->required();
  command->add_option(
      "-o,--output", options->output,
      "run files OUTPUT-01.run and so on (default: BENCH-temperature here); those that are there are kept");
  command->add_flag("--analyse", options->analyse_only, "measure nothing: analyse the points that are there");
  command->add_option("--item", options->item,
                      "of several items: whose report, from 1 (default: all; --html and --pdf: one)");
  add_question_options(*command, options->plan);
  command->add_option("--html", options->html, "write the report as one HTML page with figures");
  command->add_option("--pdf", options->pdf, "write the report as PDF");
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.temperature/1");
  command->callback([options, &exit_code] {
    const BenchConfig config = read_bench(options->bench_file, register_records());
    print_warnings(config);
    if (!options->plan.noise.empty() && !options->plan.asked())
      throw CLI::ValidationError("--noise goes with --reach or --time");
    if (!config.temperature.wanted())
      throw BenchError(options->bench_file, {{"[temperature] set_points_degc", "nothing",
                                              "the set points of the series (docs/temperature.md)"}});
    check_item(*options, config);
    const std::vector<std::filesystem::path> paths =
        options->analyse_only ? series_paths(stem_of(*options), series_points(config.temperature).size())
                              : measure(*options, config);
    const std::vector<TemperatureReport> reports = reports_of(*options, paths);
    write_pages(*options, temperature_document(reports.front()));
    if (options->json) {
      std::vector<nlohmann::ordered_json> objects;
      for (const TemperatureReport& report : reports) objects.push_back(temperature_json(report));
      print_result("{}\n", json_of_items(std::move(objects)).dump(2));
    } else {
      for (const TemperatureReport& report : reports)
        print_result("{}", document_text(temperature_document(report), stdout));
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
