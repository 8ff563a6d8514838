#include <fmt/format.h>

#include <memory>
#include <utility>

#include "app/commands/commands.h"
#include "app/export/formats.h"
#include "app/export/reading_noise.h"
#include "app/results/analyses.h"
#include "app/results/load_record.h"
#include "app/results/tray_results.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"

namespace abcal {
namespace {

struct ExportCommand {
  std::string file;
  std::string format;
  std::string estimator;
  std::string frame = "item";
  std::string output;
  int item = 0;
  bool force = false;
};

/// Of one of several items, as the common fit of all of them knows it.
CalibrationResult result_of_file(const ExportCommand& command, const LoadedRecord& loaded, int item) {
  const std::string estimator =
      command.estimator.empty() ? declared_estimator(loaded.record).name : command.estimator;
  if (estimator == "joint" && loaded.run && has_several_items(*loaded.run))
    return std::move(analyse_tray_run(command.file).tray.items[static_cast<std::size_t>(item - 1)].result);
  return analyse(loaded.record, estimator);
}

CorrectionConstants constants_of_file(const ExportCommand& command) {
  const int chosen = chosen_item(command.file, command.item);
  const LoadedRecord loaded = load_record(command.file, chosen);
  const CalibrationResult result = result_of_file(command, loaded, chosen);
  CorrectionConstants constants =
      constants_of(result, command.frame == "item" ? ExportFrame::kItem : ExportFrame::kPlatter);
  if (!loaded.run) return constants;
  constants.noise = noise_of_readings(command.file, chosen);
  constants.performed = loaded.run->header.created_utc;
  if (!loaded.run->header.items.empty()) {
    const RunItem& item = loaded.run->header.items[static_cast<std::size_t>(chosen - 1)];
    constants.item = fmt::format("{} {}, serial number {}", item.maker, item.model, item.serial_number);
  }
  return constants;
}

void export_constants(const ExportCommand& command) {
  const ExportFormat& format = export_format(command.format);
  if (command.output.empty() && !format.is_text)
    throw std::invalid_argument(fmt::format("--as {}: is no text; required: --output FILE", format.name));
  if (!command.output.empty())
    require_writable({{"--output", command.output}}, {command.file}, command.force);
  const CorrectionConstants constants = constants_of_file(command);
  const std::string text = format.write(constants);
  if (constants.verdict != "usable")
    print_warning(fmt::format("the result is {}: look at it with `abcal analyse {}` first", constants.verdict,
                              command.file));
  if (command.output.empty()) {
    print_result("{}", text);
  } else {
    OutputFile(command.output).write(text);
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
  command->add_option("FILE", options->file, "run file or CSV")->required();
  command->add_option("--as", options->format, "format:" + formats)->required();
  command->add_option("--estimator", options->estimator, "instead of the one that the run declares")
      ->check(CLI::IsMember(std::vector<std::string>(kEstimatorNames.begin(), kEstimatorNames.end())));
  command
      ->add_option(
          "--frame", options->frame,
          "axes of the corrected readings: the item's own (item), or those of the stage's platter, which "
          "corrects the mounting too (platter)")
      ->check(CLI::IsMember({"item", "platter"}))
      ->capture_default_str();
  command->add_option("--item", options->item, "of a run with several items: which one, from 1");
  command->add_option("-o,--output", options->output, "file to write (default: standard output)");
  command->add_flag("--force", options->force, "replace a file that exists");
  command->callback([options, &exit_code] {
    export_constants(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
