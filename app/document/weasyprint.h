#pragma once

#include <filesystem>
#include <optional>

#include "app/system/child_process.h"

namespace abcal {

/// WeasyPrint, for require_installed() before anything is written.
extern const Tool kWeasyPrint;

/// Makes a PDF of a page; with `attachment`, a file inside the PDF. PDF/A-3 (ISO 19005-3), which allows
/// attachments, where the installed WeasyPrint can make it.
/// @throws ProgramMissing, std::runtime_error
void print_pdf(const std::filesystem::path& html, const std::filesystem::path& pdf,
               const std::optional<std::filesystem::path>& attachment);

}  // namespace abcal
