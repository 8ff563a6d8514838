#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/document/attachment.h"

namespace abcal {

/// Contents that the writer of a tagged PDF has left out.
struct PdfDescription {
  std::string language;              ///< ISO 639-1.
  std::string created_utc;           ///< ISO 8601; empty: no date.
  std::vector<std::string> figures;  ///< For readers who do not see them, in their order.
};

/// Gives a tagged PDF the structure of PDF/A-3b (ISO 19005-3): output intent with an sRGB profile, metadata
/// that name PDF/A-3b, and an attached file with its relation. The same input gives the same bytes.
/// @param tagged  the bytes of the PDF
/// @param description  language, date, descriptions of figures and the scope of heads of tables are added;
/// without it, the PDF has them, and its metadata name PDF/UA-1
/// @throws std::runtime_error  with qpdf's message
void make_archive(const std::string& tagged, const std::filesystem::path& output,
                  const std::optional<Attachment>& attachment,
                  const std::optional<PdfDescription>& description);

/// The bytes of the attached file whose relation is Data; empty: none is attached.
/// @throws std::runtime_error  with qpdf's words
std::string attached_data(const std::filesystem::path& pdf);

}  // namespace abcal
