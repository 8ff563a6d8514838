#include "protocol/estimators/checks/check_meanings.h"

#include <algorithm>
#include <array>
#include <string>
#include <vector>

namespace abcal {
namespace {

/// A check or a flag, and what it means.
struct Meaning {
  Term name;
  Term meaning;
};

/// Checks of the whole result.
constexpr std::array<Meaning, 16> kChecks{{
    {"mounting slip", "Did the accelerometer turn on the platter between two angles, and stay so?"},
    {"missed step of axis X", "Was axis X off from some angle on, without its encoder seeing it?"},
    {"missed step of axis Z", "Was axis Z off from some angle on, without its encoder seeing it?"},
    {"jump of an output", "Did one output change by a constant from some angle on?"},
    {"change of a gain", "Did the gain of one output change from some angle on?"},
    {"single angle", "Do the readings of one angle belong to another angle?"},
    {"single output", "Was one output disturbed or stuck at one angle?"},
    {"single readings", "Were the outputs disturbed or stuck at one angle?"},
    {"turn at the check poses",
     "Did the accelerometer turn on the platter between visits to the check poses?"},
    {"check poses", "Were the readings at the check poses compared between their visits?"},
    {"temperature", "How far was the temperature from that of the first angle?"},
    {"full scale", "How far are the sensitivities from the nominal one: unit, full scale, scale factor?"},
    {"directions of the outputs", "How far do the outputs point from the axes that the mounting names?"},
    {"joint fit", "Do the readings follow the model of the three experiments at all?"},
    {"stated sizes of effects",
     "Does the joint fit of the same readings contradict a stated uncertainty on which this result rests?"},
    {"changes during the run", "Were slips, missed steps and disturbed angles looked for?"},
}};

/// Checks of each output, by the name of the output.
struct CheckOfOutput {
  Sentence<char> name;
  Term meaning;
};
constexpr std::array<CheckOfOutput, 4> kChecksOfOutputs{{
    {"drift of {output}",
     "Did this output drift over the run by more than its tolerance and its noise explain?"},
    {"gain of {output} at the check poses",
     "Did the gain of this output change between the visits to the check poses?"},
    {"offset of {output} at the check poses",
     "Did the offset of this output change between the visits to the check poses?"},
    {"stuck output {output}", "Did this output change at all during the dwells?"},
}};

/// The name of a check as a message, and its meaning.
struct KnownCheck {
  Message name;
  Term meaning;
};
const std::vector<KnownCheck>& known_checks() {
  static const std::vector<KnownCheck> all = [] {
    std::vector<KnownCheck> list;
    for (const Meaning& each : kChecks) list.push_back({each.name, each.meaning});
    for (const CheckOfOutput& each : kChecksOfOutputs)
      for (const char output : {'u', 'v', 'w'}) list.push_back({Message(each.name, output), each.meaning});
    return list;
  }();
  return all;
}

const KnownCheck* find_check(std::string_view check) {
  const auto found =
      std::ranges::find_if(known_checks(), [&](const KnownCheck& each) { return each.name == check; });
  return found == known_checks().end() ? nullptr : &*found;
}

}  // namespace

Message name_of_check(std::string_view check) {
  const KnownCheck* const found = find_check(check);
  return found == nullptr ? Message::bare(std::string(check)) : found->name;
}

std::string_view meaning_of_check(std::string_view check) {
  const KnownCheck* const found = find_check(check);
  return found == nullptr ? std::string_view() : found->meaning.english();
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
  const auto* const found =
      std::ranges::find_if(kMeanings, [&](const Meaning& each) { return each.name == flag; });
  return found == kMeanings.end() ? std::string_view() : found->meaning.english();
}

}  // namespace abcal
