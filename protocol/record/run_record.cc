#include "protocol/record/run_record.h"

#include <array>
#include <utility>

namespace abcal {

std::string describe_flags(std::uint32_t flags) {
  static constexpr std::array<std::pair<std::uint32_t, const char*>, 10> kWords{{
      {kFlagNotQuiet, "not quiet"},
      {kFlagLostReadings, "lost readings"},
      {kFlagClipped, "clipped"},
      {kFlagStuck, "stuck output"},
      {kFlagNotFinite, "not finite"},
      {kFlagOutsideWindow, "outside the position window"},
      {kFlagTemperature, "temperature outside its limits"},
      {kFlagRepeated, "repeated"},
      {kFlagHeld, "held for the temperature"},
      {kFlagNorm, "norm not that of gravity"},
  }};
  std::string text;
  for (const auto& [flag, word] : kWords) {
    if ((flags & flag) != 0) text.append(text.empty() ? "" : ", ").append(word);
  }
  return text;
}

}  // namespace abcal
