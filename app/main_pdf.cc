// abcal-pdf: gives a PDF the structure of PDF/A-3. Started by abcal (app/document/weasyprint.h), so
// that abcal need not load the libraries for PDF and colours.
#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <string>

#include "app/document/pdf_archive.h"
#include "app/run_program.h"
#include "app/system/output_file.h"

namespace {

void add_finish(CLI::App& parent) {
  struct Options {
    std::string tagged, output, data, supplement;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("finish", "Add output intent, metadata and an attached file");
  command->add_option("TAGGED", options->tagged, "tagged PDF")->required();
  command->add_option("OUTPUT", options->output, "file to write")->required();
  CLI::Option* data = command->add_option("--data", options->data, "file of which the pages were made");
  command->add_option("--supplement", options->supplement, "another file to attach")->excludes(data);
  command->callback([options] {
    std::optional<abcal::Attachment> attachment;
    if (!options->data.empty()) attachment = {options->data, abcal::AttachmentKind::kData};
    if (!options->supplement.empty()) attachment = {options->supplement, abcal::AttachmentKind::kSupplement};
    abcal::make_archive(options->tagged, options->output, attachment);
  });
}

void add_detach(CLI::App& parent) {
  struct Options {
    std::string pdf, output;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("detach", "Write the attached file of which the pages were made");
  command->add_option("PDF", options->pdf, "PDF")->required();
  command->add_option("OUTPUT", options->output, "file to write; empty where nothing is attached")
      ->required();
  command->callback(
      [options] { abcal::OutputFile(options->output).write(abcal::attached_data(options->pdf)); });
}

}  // namespace

int main(int argc, char** argv) {
  return abcal::run_program(
      argc, argv, {"abcal-pdf", "abcal-pdf finishes the PDF files of abcal.", [](CLI::App& app, int&) {
                     add_finish(app);
                     add_detach(app);
                   }});
}
