#include "protocol/record/run_record.h"

#include <algorithm>
#include <array>
#include <utility>

#include "drivers/text/names.h"
#include "protocol/plan/backlash.h"

namespace abcal {

constexpr auto kRoles = names<DwellRole>({{DwellRole::kPlan, "plan"},
                                          {DwellRole::kReturn, "return"},
                                          {DwellRole::kClosing, "closing"},
                                          {DwellRole::kCheck, "check"}});

std::string_view to_string(DwellRole role) {
  return kRoles.of(role, "unknown");
}

std::optional<DwellRole> dwell_role_from(std::string_view word) {
  return kRoles.value(word);
}

std::vector<const DwellRecord*> dwells_in_time(const RunRecord& record) {
  std::vector<const DwellRecord*> all;
  auto check = record.check_poses.begin();
  for (std::size_t i = 0; i <= record.dwells.size(); ++i) {
    for (; check != record.check_poses.end() && check->after <= i; ++check) all.push_back(&check->dwell);
    if (i < record.dwells.size()) all.push_back(&record.dwells[i]);
  }
  return all;
}

bool is_at_constant_rate(const RunRecord& record) {
  return std::ranges::any_of(record.dwells,
                             [](const DwellRecord& dwell) { return dwell.motion.has_value(); });
}

bool has_two_faces(const RunRecord& record) {
  return std::ranges::any_of(record.dwells, [](const DwellRecord& dwell) { return dwell.face == 2; });
}

bool has_angles(const RunRecord& record) {
  return std::ranges::any_of(record.dwells, [](const DwellRecord& dwell) { return dwell.experiment > 0; });
}

bool states_directions(const RunRecord& record) {
  return !record.dwells.empty() &&
         std::ranges::all_of(record.dwells, [](const DwellRecord& dwell) { return dwell.up.has_value(); });
}

bool backlash_is_left(const RunRecord& record) {
  if (!record.approach || *record.approach > Angle{}) return false;
  std::vector<std::array<Angle, 2>> poses;
  for (const DwellRecord* dwell : dwells_in_time(record))
    poses.push_back({dwell->commanded_x, dwell->commanded_z});
  return turns_both_ways(poses);
}

Message describe_flags(std::uint32_t flags) {
  struct FlagWords {
    std::uint32_t flag;
    Term words;
  };
  static constexpr std::array<FlagWords, 10> kWords{{
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
  std::vector<Message> found;
  for (const auto& [flag, words] : kWords)
    if ((flags & flag) != 0) found.push_back(words);
  return in_sequence(found, ", ");
}

}  // namespace abcal
