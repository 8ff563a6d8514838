// abcal-pdf: writes documents as PDF, and gives a PDF the structure of PDF/A-3. Started by abcal
// (app/document/write_pdf.h, app/document/weasyprint.h), so that abcal need not load the libraries for PDF,
// fonts and colours.
#include <CLI/CLI.hpp>
#include <iostream>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "app/document/document_pdf.h"
#include "app/document/packed_document.h"
#include "app/document/pdf_archive.h"
#include "app/run_program.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"

namespace {

/// Options of a PDF and of the file that is attached to it.
struct PdfOptions {
  std::string output, data, supplement;

  std::optional<abcal::Attachment> attachment() const {
    if (!data.empty()) return abcal::Attachment{data, abcal::AttachmentKind::kData};
    if (!supplement.empty()) return abcal::Attachment{supplement, abcal::AttachmentKind::kSupplement};
    return std::nullopt;
  }
};

void add_pdf_options(CLI::App& command, PdfOptions& options) {
  command.add_option("OUTPUT", options.output, "file to write")->required();
  CLI::Option* data = command.add_option("--data", options.data, "file of which the pages were made");
  command.add_option("--supplement", options.supplement, "another file to attach")->excludes(data);
}

void add_write(CLI::App& parent) {
  auto options = std::make_shared<PdfOptions>();
  CLI::App* command = parent.add_subcommand("write", "Write the document on standard input as PDF");
  add_pdf_options(*command, *options);
  command->callback([options] {
    const abcal::Document document =
        abcal::unpacked(std::string(std::istreambuf_iterator<char>(std::cin), {}));
    abcal::PdfDescription description{document.language, document.created_utc, {}};
    for (const abcal::Section& section : document.sections)
      for (const abcal::Block& block : section.blocks)
        if (const auto* figure = std::get_if<abcal::Figure>(&block))
          description.figures.push_back(figure->caption);
    abcal::make_archive(abcal::document_pdf(document), options->output, options->attachment(), description);
  });
}

void add_finish(CLI::App& parent) {
  struct Options : PdfOptions {
    std::string tagged;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("finish", "Add output intent, metadata and an attached file");
  command->add_option("TAGGED", options->tagged, "tagged PDF")->required();
  add_pdf_options(*command, *options);
  command->callback([options] {
    abcal::make_archive(abcal::read_file(options->tagged), options->output, options->attachment(),
                        std::nullopt);
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
      argc, argv,
      {"abcal-pdf", "abcal-pdf writes and finishes the PDF files of abcal.", [](CLI::App& app, int&) {
         add_write(app);
         add_finish(app);
         add_detach(app);
       }});
}
