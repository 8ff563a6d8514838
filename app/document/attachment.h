#pragma once

#include <filesystem>

namespace abcal {

/// What an attached file is to the page (AFRelationship of ISO 19005-3).
enum class AttachmentKind {
  kData,        ///< What the page was made of.
  kSupplement,  ///< Something beside it.
};

/// A file inside a PDF.
struct Attachment {
  std::filesystem::path file;
  AttachmentKind kind = AttachmentKind::kSupplement;
};

}  // namespace abcal
