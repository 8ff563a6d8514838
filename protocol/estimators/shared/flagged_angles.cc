#include "protocol/estimators/shared/flagged_angles.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <vector>

#include "protocol/estimators/shared/objection.h"

namespace abcal {
namespace {

/// Largest share of repeated angles. A more frequent disturbance is also present below the limits, at the
/// other angles and when angles were measured again.
constexpr double kManyRepeated = 0.25;

int angles_with(const RunRecord& record, std::uint32_t flags) {
  return static_cast<int>(std::ranges::count_if(
      record.dwells, [flags](const DwellRecord& dwell) { return (dwell.flags & flags) != 0U; }));
}

}  // namespace

void count_flags(const RunRecord& record, Diagnostics& diagnostics) {
  for (std::uint32_t flag = 1; flag <= kAllFlags; flag *= 2) {
    if (const int angles = angles_with(record, flag); angles > 0)
      diagnostics.flags.push_back({describe_flags(flag).english(), angles});
  }
  diagnostics.angles_flagged = angles_with(record, ~kFlagNone);
}

Message words_about_flags(const RunRecord& record, std::uint32_t which) {
  std::uint32_t found = kFlagNone;
  for (const DwellRecord& dwell : record.dwells) found |= dwell.flags & which;
  std::vector<Message> words;
  if (found != kFlagNone) {
    const int angles = angles_with(record, which);
    words.push_back(Message("{flagged} of {all} angles {verb} flagged: {flags}", angles, record.dwells.size(),
                            angles == 1 ? Message("is") : Message("are"), describe_flags(found)));
  }
  const int repeated = angles_with(record, kFlagRepeated);
  if (repeated > kManyRepeated * static_cast<double>(record.dwells.size()))
    words.push_back(Message("{angles} of {all} angles had to be measured again (the run's events say why)",
                            repeated, record.dwells.size()));
  return in_sequence(words);
}

void object_to_flags(const RunRecord& record, std::uint32_t which, CalibrationResult& result) {
  if (result.verdict == Verdict::kNotUsable) return;
  const Message words = words_about_flags(record, which);
  if (!words.empty()) object_to(result, words);
}

}  // namespace abcal
