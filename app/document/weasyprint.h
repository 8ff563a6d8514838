#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "app/document/attachment.h"
#include "app/system/child_process.h"
#include "app/system/temporary_folder.h"

namespace abcal {

/// WeasyPrint, for require_installed() before anything is written.
extern const Tool kWeasyPrint;

/// Makes a PDF of a certificate's page: tagged (as PDF/UA-1 asks for, by WeasyPrint), and with the structure
/// of PDF/A-3 (output intent, metadata, attachments with their relation; by the helper program abcal-pdf).
/// Only a validator can show whether it conforms to either.
class PdfPrinter {
 public:
  /// Starts WeasyPrint, which takes half a second to load: make one, then the page.
  /// @throws ProgramMissing, std::runtime_error
  PdfPrinter();

  /// To be called once.
  /// @param cancelled  asked each 0.1 s; true ends it
  /// @throws ProgramMissing, RunInterrupted, std::runtime_error
  void print(const std::string& html, const std::filesystem::path& pdf,
             const std::optional<Attachment>& attachment, const std::function<bool()>& cancelled = {});

 private:
  TemporaryFolder folder_;
  ToolAwaitingInput weasyprint_;
};

/// How long the print of such a page usually takes, by its size.
double usual_print_duration_s(const std::string& html);

/// The data file inside a PDF of a PdfPrinter; empty: it has none.
/// @throws ProgramMissing, RunInterrupted, std::runtime_error (no PDF)
std::string attachment_of_pdf(const std::filesystem::path& pdf);

}  // namespace abcal
