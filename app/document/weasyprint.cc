#include "app/document/weasyprint.h"

#include <stdexcept>
#include <string>
#include <vector>

namespace abcal {

const Tool kWeasyPrint{"weasyprint", "a PDF needs", "weasyprint"};

namespace {

/// WeasyPrint makes PDF/A from version 56 on; its help does not mention it before.
bool makes_pdf_a() {
  return run_tool(kWeasyPrint, {"--quiet", "--pdf-variant", "pdf/a-3b", "--version"}, ToolOutput::kHidden) ==
         0;
}

}  // namespace

void print_pdf(const std::filesystem::path& html, const std::filesystem::path& pdf,
               const std::optional<std::filesystem::path>& attachment) {
  std::vector<std::string> arguments{"--quiet"};
  if (attachment) arguments.insert(arguments.end(), {"--attachment", attachment->string()});
  if (makes_pdf_a()) arguments.insert(arguments.end(), {"--pdf-variant", "pdf/a-3b"});
  arguments.insert(arguments.end(), {html.string(), pdf.string()});
  if (const int code = run_tool(kWeasyPrint, arguments); code != 0)
    throw std::runtime_error("weasyprint failed with exit code " + std::to_string(code) +
                             "; its messages are above");
}

}  // namespace abcal
