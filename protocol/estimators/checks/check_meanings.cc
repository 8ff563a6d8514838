#include "protocol/estimators/checks/check_meanings.h"

#include <algorithm>
#include <array>
#include <utility>

namespace abcal {
namespace {

using Meaning = std::pair<std::string_view, std::string_view>;

template <std::size_t n>
std::string_view look_up(const std::array<Meaning, n>& meanings, std::string_view name) {
  const auto* const found =
      std::find_if(meanings.begin(), meanings.end(), [&](const Meaning& m) { return m.first == name; });
  return found == meanings.end() ? std::string_view() : found->second;
}

}  // namespace

std::string_view meaning_of_check(std::string_view check) {
  static constexpr std::array<Meaning, 20> kMeanings{{
      {"mounting slip", "Did the accelerometer turn on the platter between two angles, and stay so?"},
      {"missed step of axis X", "Was axis X off from some angle on, without its encoder seeing it?"},
      {"missed step of axis Z", "Was axis Z off from some angle on, without its encoder seeing it?"},
      {"jump of an output", "Did one output change by a constant from some angle on?"},
      {"change of a gain", "Did the gain of one output change from some angle on?"},
      {"single angle", "Do the readings of one angle belong to another angle?"},
      {"single output", "Was one output disturbed or stuck at one angle?"},
      {"single readings", "Were the outputs disturbed or stuck at one angle?"},
      {"drift", "Did this output drift over the run by more than its tolerance and its noise explain?"},
      {"gain", "Did the gain of this output change between the visits to the check poses?"},
      {"offset", "Did the offset of this output change between the visits to the check poses?"},
      {"turn at the check poses",
       "Did the accelerometer turn on the platter between visits to the check poses?"},
      {"check poses", "Were the readings at the check poses compared between their visits?"},
      {"stuck output", "Did this output change at all during the dwells?"},
      {"temperature", "How far was the temperature from that of the first angle?"},
      {"full scale", "How far are the sensitivities from the nominal one: unit, full scale, scale factor?"},
      {"directions of the outputs", "How far do the outputs point from the axes that the mounting names?"},
      {"joint fit", "Do the readings follow the model of the three experiments at all?"},
      {"stated sizes of effects",
       "Does the joint fit of the same readings contradict a stated uncertainty on which this result rests?"},
      {"changes during the run", "Were slips, missed steps and disturbed angles looked for?"},
  }};
  // The names of these end with an output.
  for (const std::string_view of_an_output : {"drift", "gain", "offset", "stuck output"})
    if (check.starts_with(of_an_output) && look_up(kMeanings, check).empty())
      return look_up(kMeanings, of_an_output);
  return look_up(kMeanings, check);
}

std::string_view meaning_of_flag(std::string_view flag) {
  static constexpr std::array<Meaning, 10> kMeanings{{
      {"not quiet", "An output had a slope, or more spread than usual, until the longest wait: vibration."},
      {"lost readings", "Readings were lost during the dwell: cable, baud rate, or a busy computer."},
      {"clipped", "An output was at its full scale: a larger range is needed."},
      {"stuck output", "An output did not change at all during the dwell."},
      {"not finite", "Readings that were not finite numbers were left out."},
      {"outside the position window", "The encoder left the position window during the dwell."},
      {"temperature outside its limits", "The accelerometer was warmer or colder than the limits allow."},
      {"repeated", "The angle was measured again, after a disturbance or an interruption."},
      {"held for the temperature", "The run waited here for the temperature, then measured the angle again."},
      {"norm not that of gravity", "The norm of the readings is not that of local gravity: unit or scale."},
  }};
  return look_up(kMeanings, flag);
}

}  // namespace abcal
