// abcal-hdf5: a record and its results as HDF5. A program of its own (started by
// app/results/report/hdf5_export.h), so that abcal need not load HDF5 and its dependencies.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "app/ground/system/output.h"
#include "app/ground/system/real_clock.h"
#include "app/ground/system/run_program.h"
#include "app/results/report/record_hdf5.h"

namespace {

void add_export(CLI::App& parent) {
  struct Options {
    std::string record, output, file_name, created_utc;
    std::vector<int> only;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("export", "Write a record and its results as HDF5");
  command->add_option("RECORD", options->record, "run file or CSV")->required();
  command->add_option("OUTPUT", options->output, "file to write; what is there is replaced")->required();
  command->add_option("--file-name", options->file_name, "what OUTPUT will be called (NeXus: file_name)")
      ->required();
  command->add_option("--created-utc", options->created_utc, "when it is made, in ISO 8601")->required();
  command->add_option("--item", options->only,
                      "an item, from 1; once for each that is wanted (default: all)");
  command->callback([options] {
    using namespace abcal;
    std::vector<ReportData> items = gather_items(options->record, RealClock().utc_now());
    std::erase_if(items, [&](const ReportData& data) {
      return !options->only.empty() && std::ranges::find(options->only, data.item) == options->only.end();
    });
    for (ReportData& data : items) data.created_utc = options->created_utc;
    write_hdf5(items, options->output, options->file_name);
  });
}

}  // namespace

int main(int argc, char** argv) {
  // If a file cannot be written, each destructor of HDF5 repeats the exception's message on that stream.
  abcal::silence_standard_error_stream();
  const int exit_code = abcal::run_program(
      argc, argv,
      {"abcal-hdf5", "abcal-hdf5 writes the HDF5 files of `abcal report --hdf5` and of the console.",
       [](CLI::App& app, int&) { add_export(app); }});
  // Every file is closed by now; if one could not be written, HDF5 crashes at the end of the program.
  std::fflush(nullptr);
  std::_Exit(exit_code);
}
