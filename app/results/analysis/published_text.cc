#include "app/results/analysis/published_text.h"

#include <fmt/format.h>

#include "app/results/analysis/result_text.h"

namespace abcal {
namespace {

std::string published_row(const char* name, const std::array<Quantity, 3>& values) {
  std::string text = fmt::format("  {:<5}", name);
  for (const Quantity& value : values) text += fmt::format(" {:>24}", value_with_uncertainty(value));
  return text + "\n";
}

}  // namespace

std::string published_text(const PublishedResult& published) {
  return fmt::format(
             "\nBy the published formula (not corrected for k2 and k3; std. unc. from readings, alignment, "
             "turns,\nzeros and steps), for comparison with ABC results of other laboratories:\n") +
         published_row("s_u", published.sensitivity_matrix[0]) +
         published_row("s_v", published.sensitivity_matrix[1]) +
         published_row("s_w", published.sensitivity_matrix[2]) + published_row("O", published.offset) +
         published_row("s", published.intrinsic_sensitivity) +
         published_row("phi", published.intrinsic_angle);
}

}  // namespace abcal
