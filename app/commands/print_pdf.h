#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/document/weasyprint.h"

namespace abcal {

/// Prints a page as PDF, and shows meanwhile how much time is left.
/// @throws as PdfPrinter::print()
void print_pdf(PdfPrinter& printer, const std::string& html, const std::filesystem::path& pdf,
               const std::optional<Attachment>& attachment);

}  // namespace abcal
