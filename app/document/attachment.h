#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace abcal {

/// Relation of an attached file to the page (AFRelationship of ISO 19005-3).
enum class AttachmentKind {
  kData,        ///< Source of the page.
  kSupplement,  ///< Additional to the page.
};

/// A file inside a PDF.
struct Attachment {
  std::filesystem::path file;
  AttachmentKind kind = AttachmentKind::kSupplement;
};

/// The options of abcal-pdf that attach a file.
std::vector<std::string> attachment_options(const std::optional<Attachment>& attachment);

}  // namespace abcal
