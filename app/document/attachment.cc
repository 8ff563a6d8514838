#include "app/document/attachment.h"

namespace abcal {

std::vector<std::string> attachment_options(const std::optional<Attachment>& attachment) {
  if (!attachment) return {};
  return {attachment->kind == AttachmentKind::kData ? "--data" : "--supplement",
          std::filesystem::absolute(attachment->file).string()};
}

}  // namespace abcal
