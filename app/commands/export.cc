#include <fmt/format.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/commands/commands.h"
#include "app/commands/table_options.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/temperature_points.h"
#include "app/results/export/formats.h"
#include "app/results/export/reading_noise.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"

namespace abcal {
namespace {

struct ExportCommand {
  std::vector<std::string> files;  ///< One; or the points of a series over temperature.
  std::string format;
  std::string estimator;
  std::string frame = "item";
  std::string output;
  TableOptions table;
  int item = 0;
  bool force = false;
};

CorrectionConstants constants_of_file(const ExportCommand& command) {
  const std::string& file = command.files.front();
  const int chosen = chosen_item(file, command.item);
  const AnalysedRun run = analyse_file_by(file, command.estimator, command.table);
  const AnalysedItem& item = run.item(chosen);
  say_how_read(file, item.stored.record);
  CorrectionConstants constants = constants_of(
      item.results.front(), command.frame == "item" ? ExportFrame::kItem : ExportFrame::kPlatter);
  const std::filesystem::path first_run = run.first_run(file);
  if (!RunFile::looks_like_run_file(first_run)) return constants;
  constants.noise = noise_of_readings(first_run, chosen);
  constants.performed = item.stored.header.created_utc;
  const RunItem& identity = item.stored.own_item();
  constants.full_scale = identity.full_scale;
  constants.item =
      fmt::format("{} {}, serial number {}", identity.maker, identity.model, identity.serial_number);
  return constants;
}

/// The text that a format writes, and the verdict on its result.
struct Exported {
  std::string text, verdict;
  std::string left_out;  ///< With the reason; empty: nothing.
};

Exported constants_of_series(const ExportCommand& command, const ExportFormat& format) {
  if (!format.write_over_temperature)
    throw std::invalid_argument(
        fmt::format("--as {}: found {} files, the points of a series over temperature; required: one file, "
                    "or the formats json, csv, mat, c, which hold constants over temperature",
                    format.name, command.files.size()));
  if (command.frame != "item" || !command.estimator.empty())
    throw std::invalid_argument(
        "--frame and --estimator: not with the points of a series over temperature; required: neither, as "
        "its polynomials are of what the mounting does not change, by the estimator that the runs declare");
  const auto chosen = static_cast<std::size_t>(chosen_item(command.files.front(), command.item)) - 1;
  const AnalysedSeries series = analyse_series({command.files.begin(), command.files.end()}).at(chosen);
  TemperatureConstants constants = temperature_constants(series.result, series.g_loc_mps2);
  constants.response_unit = series.response_unit;
  constants.item = series.item;
  constants.performed = series.performed;
  constants.source = fmt::format("{} and {} more runs", command.files.front(), command.files.size() - 1);
  constants.verdict = series.result.usable() ? "usable" : "doubtful";
  return {format.write_over_temperature(constants), constants.verdict, {}};
}

Exported exported(const ExportCommand& command, const ExportFormat& format) {
  if (command.files.size() > 1) return constants_of_series(command, format);
  const CorrectionConstants constants = constants_of_file(command);
  return {format.write(constants), constants.verdict, format.left_out ? format.left_out(constants) : ""};
}

void export_constants(const ExportCommand& command) {
  const ExportFormat& format = export_format(command.format);
  if (command.output.empty() && !format.is_text)
    throw std::invalid_argument(fmt::format("--as {}: is no text; required: --output FILE", format.name));
  if (!command.output.empty())
    require_writable({{"--output", command.output}}, {command.files.begin(), command.files.end()},
                     command.force);
  const Exported done = exported(command, format);
  if (done.verdict != "usable")
    print_warning(fmt::format("the result is {}: look at it with `abcal analyse {}` first", done.verdict,
                              with_table_options(command.files.front(), command.table)));
  if (!done.left_out.empty()) print_warning(done.left_out);
  if (command.output.empty()) {
    print_result("{}", done.text);
  } else {
    OutputFile(command.output).write(done.text);
  }
}

}  // namespace

CLI::App* add_export(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<ExportCommand>();
  CLI::App* command = parent.add_subcommand(
      "export", "Write the constants of a result in the form that another program reads");
  std::string formats;
  for (const ExportFormat& format : export_formats())
    formats += fmt::format("\n  {}: {}", format.name, format.words);
  command
      ->add_option("FILE", options->files,
                   "run file, table or measurement; several: the points of a series over temperature")
      ->required();
  command->add_option("--as", options->format, "format:" + formats)->required();
  command->add_option("--estimator", options->estimator, "instead of the one that the run declares")
      ->check(CLI::IsMember(std::vector<std::string>(kEstimatorNames.begin(), kEstimatorNames.end())));
  command
      ->add_option("--frame", options->frame,
                   "axes of the corrected readings: the item's own (item), or those of the stage's platter, "
                   "which corrects the mounting too (platter)")
      ->check(CLI::IsMember({"item", "platter"}))
      ->capture_default_str();
  command->add_option("--item", options->item, "of a run with several items: which one, from 1");
  add_table_options(*command, options->table);
  command->add_option("-o,--output", options->output, "file to write (default: standard output)");
  command->add_flag("--force", options->force, "replace a file that exists");
  command->callback([options, &exit_code] {
    export_constants(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
