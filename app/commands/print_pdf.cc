#include "app/commands/print_pdf.h"

#include "app/system/progress.h"
#include "app/system/real_clock.h"

namespace abcal {

void print_pdf(PdfPrinter& printer, const std::string& html, const std::filesystem::path& pdf,
               const std::optional<Attachment>& attachment) {
  const RealClock clock;
  UsualDurationBar bar("Printing", usual_print_duration_s(html), clock);
  printer.print(html, pdf, attachment, [&bar] {
    bar.show();
    return false;
  });
}

}  // namespace abcal
