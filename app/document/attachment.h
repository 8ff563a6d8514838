#pragma once

#include <filesystem>

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

}  // namespace abcal
