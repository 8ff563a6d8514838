#include "app/document/weasyprint.h"

#include <fmt/format.h>

#include <chrono>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "app/system/helper_program.h"
#include "app/system/temporary_folder.h"

namespace abcal {

const Tool kWeasyPrint{"weasyprint", "a PDF needs", "weasyprint"};

PdfPrinter::PdfPrinter()
    : weasyprint_(kWeasyPrint, {"--quiet", "--pdf-variant", "pdf/ua-1", "--base-url",
                                (folder_ / "page.html").string(), "-", (folder_ / "tagged.pdf").string()}) {}

void PdfPrinter::print(const std::string& html, const std::filesystem::path& pdf,
                       const std::optional<Attachment>& attachment, const std::function<bool()>& cancelled) {
  // A page of thousands of rows takes tens of seconds.
  constexpr std::chrono::minutes kLongest{5};
  if (const ToolResult result = weasyprint_.finish(html, kLongest, cancelled); result.exit_code != 0)
    throw std::runtime_error(
        fmt::format("weasyprint failed with exit code {}: {}", result.exit_code, result.words));
  std::vector<std::string> arguments{"finish", (folder_ / "tagged.pdf").string(), pdf.string()};
  const std::vector<std::string> attached = attachment_options(attachment);
  arguments.insert(arguments.end(), attached.begin(), attached.end());
  run_helper("abcal-pdf", "a PDF is finished by", arguments);
}

double usual_print_duration_s(const std::string& html) {
  // WeasyPrint 57 of Debian 12 took 1.8 s for a certificate of 71 kB, 2.1 s for a report of 232 kB (12 angles
  // a circle) and 3.0 s for one of 710 kB (360 angles a circle).
  constexpr double kLoading = 1.6, kPerByte = 2e-6;
  return kLoading + kPerByte * static_cast<double>(html.size());
}

std::string attachment_of_pdf(const std::filesystem::path& pdf) {
  const TemporaryFolder folder;
  const std::filesystem::path attached = folder / "attached";
  run_helper("abcal-pdf", "a PDF is read by", {"detach", "--", pdf.string(), attached.string()});
  std::ostringstream bytes;
  bytes << std::ifstream(attached, std::ios::binary).rdbuf();
  return bytes.str();
}

}  // namespace abcal
