#include "drivers/instrument/halt.h"

#include <string_view>

namespace abcal {

std::string in_words(const HaltReport& report) {
  const auto word = [](AxisHalt axis) -> std::string_view {
    return axis == AxisHalt::kHalted ? "halted" : "unreachable, may be moving";
  };
  std::string text("axis X: ");
  text.append(word(report.axes[0])).append("; axis Z: ").append(word(report.axes[1]));
  return text;
}

}  // namespace abcal
