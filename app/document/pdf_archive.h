#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/document/attachment.h"

namespace abcal {

/// Gives a tagged PDF the structure of PDF/A-3b (ISO 19005-3): output intent with an sRGB profile, metadata
/// that name PDF/A-3b and PDF/UA-1, and an attached file with its relation. The same input gives the same
/// bytes.
/// @throws std::runtime_error  with qpdf's message
void make_archive(const std::filesystem::path& tagged, const std::filesystem::path& output,
                  const std::optional<Attachment>& attachment);

/// The bytes of the attached file whose relation is Data; empty: none is attached.
/// @throws std::runtime_error  with qpdf's words
std::string attached_data(const std::filesystem::path& pdf);

}  // namespace abcal
