#pragma once

#include <filesystem>
#include <functional>
#include <optional>

#include "app/document/attachment.h"
#include "app/document/document.h"

namespace abcal {

/// Writes a document as PDF: tagged, and with the structure of PDF/A-3 (output intent, metadata, an attached
/// file with its relation; by the helper program abcal-pdf, with cairo, Pango and qpdf). Only a validator can
/// show whether it conforms to a standard. The same document gives the same bytes.
/// @param cancelled  asked each 0.1 s; true ends it
/// @throws ProgramMissing, RunInterrupted, std::runtime_error
void write_pdf(const Document& document, const std::filesystem::path& pdf,
               const std::optional<Attachment>& attachment, const std::function<bool()>& cancelled = {});

}  // namespace abcal
