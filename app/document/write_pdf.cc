#include "app/document/write_pdf.h"

#include <string>
#include <vector>

#include "app/document/packed_document.h"
#include "app/system/helper_program.h"

namespace abcal {

void write_pdf(const Document& document, const std::filesystem::path& pdf,
               const std::optional<Attachment>& attachment, const std::function<bool()>& cancelled) {
  std::vector<std::string> arguments{"write", std::filesystem::absolute(pdf).string()};
  const std::vector<std::string> attached = attachment_options(attachment);
  arguments.insert(arguments.end(), attached.begin(), attached.end());
  run_helper_on(packed(document), "abcal-pdf", "a PDF is written by", arguments, cancelled);
}

}  // namespace abcal
