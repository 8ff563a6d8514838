#include <fmt/format.h>

#include <memory>

#include "app/commands/commands.h"
#include "app/exit_code.h"
#include "app/output_file.h"
#include "app/real_clock.h"
#include "app/report/calibration_document.h"
#include "app/report/document_text.h"
#include "app/report/report_data.h"

namespace abcal {

CLI::App* add_report(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string file;
    bool force = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("report", "The report of a run or CSV, for people and programs");
  command->add_option("RUN", options->file, "run file, or CSV of averaged readings")->required();
  command->add_flag("--force", options->force, "overwrite files that exist");
  command->callback([options, &exit_code] {
    const ReportData data = gather_report(options->file, RealClock().utc_now());
    fmt::print("{}", document_text(calibration_document(data), stdout));
    exit_code = data.result().verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
  });
  return command;
}

}  // namespace abcal
