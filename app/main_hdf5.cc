// abcal-hdf5: a record and its results as HDF5. Started by abcal (app/report/hdf5_export.h), which so need
// not load HDF5 and what that brings along.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "app/bench/real_clock.h"
#include "app/commands/run_program.h"
#include "app/report/record_hdf5.h"
#include "app/system/output.h"

namespace {

void add_export(CLI::App& parent) {
  struct Options {
    std::string record, output, file_name, created_utc;
    int item = 0;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("export", "Write a record and its results as HDF5");
  command->add_option("RECORD", options->record, "run file or CSV")->required();
  command->add_option("OUTPUT", options->output, "file to write; what is there is replaced")->required();
  command->add_option("--file-name", options->file_name, "what OUTPUT will be called (NeXus: file_name)")
      ->required();
  command->add_option("--created-utc", options->created_utc, "when it is made, in ISO 8601")->required();
  command->add_option("--item", options->item, "of a run with several items: which, from 1; 0: all");
  command->callback([options] {
    using namespace abcal;
    const auto now = RealClock().utc_now();
    if (options->item == 0 && items_of_file(options->record) > 1) {
      std::vector<ReportData> items = gather_items(options->record, now);
      for (ReportData& data : items) data.created_utc = options->created_utc;
      write_hdf5(items, options->output, options->file_name);
      return;
    }
    ReportData data = gather_report(options->record, now, options->item);
    data.created_utc = options->created_utc;
    write_hdf5(data, options->output, options->file_name);
  });
}

}  // namespace

int main(int argc, char** argv) {
  // Where a file cannot be written, each destructor of HDF5 says there what the exception says as well.
  abcal::silence_standard_error_stream();
  const int exit_code = abcal::run_program(
      argc, argv,
      {"abcal-hdf5", "abcal-hdf5 writes the HDF5 files of `abcal report --hdf5` and of the console.",
       [](CLI::App& app, int&) { add_export(app); }});
  // Every file is closed by now; where one could not be written, what HDF5 does at the end of a program
  // crashes.
  std::fflush(nullptr);
  std::_Exit(exit_code);
}
