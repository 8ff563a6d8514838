#include "protocol/record/stage_record.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <set>

namespace abcal {
namespace {

struct PartWords {
  std::string_view name, words;
};
constexpr std::array<PartWords, kRepeatParts> kParts{
    PartWords{"step", "step errors, from visit to visit"},
    PartWords{"homing", "zeros, from homing to homing"},
    PartWords{"floor", "alignment, from run to run"},
    PartWords{"turn", "initial turns, from run to run"},
};
const PartWords& words_of(RepeatPart part) {
  return kParts[static_cast<std::size_t>(part)];
}

/// The stated size of an unknown: of the effect that its name begins with, or of a step error.
double stated_size_of(const EffectSizes& sizes, const StageState& state, Eigen::Index place) {
  if (place >= static_cast<Eigen::Index>(state.names.size())) return sizes.step.rad();
  const std::string& name = state.names[static_cast<std::size_t>(place)];
  if (const int part = repeat_part_of(name); part >= 0)
    return stated_size(sizes, static_cast<RepeatPart>(part));
  if (name.starts_with("wobble")) return sizes.wobble_urad * 1e-6;
  if (name.starts_with("eccentricity")) return sizes.step_eccentric.rad();
  return sizes.step_smooth.rad();
}

}  // namespace

AxisAngle visited_angle(int experiment, Angle alpha) {
  constexpr std::int64_t kTurn = 360'000'000;
  const std::int64_t angle = std::llround(alpha.deg() * 1e6) % kTurn;
  return {experiment == 3 ? 'Z' : 'X', angle < 0 ? angle + kTurn : angle};
}

std::string name_of_map(const AxisAngle& angle) {
  return fmt::format("fine map of {} at {:g} degrees", angle.axis, angle.degrees());
}

Eigen::Index StageState::place_of(std::string_view name) const {
  const auto found = std::find(names.begin(), names.end(), name);
  return found == names.end() ? -1 : found - names.begin();
}

Eigen::Index StageState::place_of(const AxisAngle& angle) const {
  const auto found = std::lower_bound(angles.begin(), angles.end(), angle);
  if (found == angles.end() || *found != angle) return -1;
  return static_cast<Eigen::Index>(names.size()) + (found - angles.begin());
}

std::string StageState::name_of(Eigen::Index place) const {
  const auto at = static_cast<std::size_t>(place);
  if (at < names.size()) return names[at];
  return name_of_map(angles[at - names.size()]);
}

int repeat_part_of(std::string_view unknown_name) {
  if (unknown_name == "F_X" || unknown_name == "F_Z") return static_cast<int>(RepeatPart::kHoming);
  if (unknown_name == "Zx" || unknown_name == "Zy" || unknown_name == "Xz")
    return static_cast<int>(RepeatPart::kFloor);
  if (unknown_name.size() > 1 && unknown_name[0] == 'd' && std::isdigit(unknown_name[1]) != 0)
    return static_cast<int>(RepeatPart::kTurn);
  return -1;
}

std::string_view to_string(RepeatPart part) {
  return words_of(part).name;
}

std::string_view in_words(RepeatPart part) {
  return words_of(part).words;
}

double stated_size(const EffectSizes& sizes, RepeatPart part) {
  switch (part) {
    case RepeatPart::kStep:
      return sizes.step.rad();
    case RepeatPart::kHoming:
      return sizes.zero.rad();
    case RepeatPart::kFloor:
      return sizes.alignment.rad();
    case RepeatPart::kTurn:
      return sizes.initial_turn.rad();
  }
  return 0.0;
}

SizeFound half_normal(double rms) {
  constexpr double kUpper = 1.959963984540054;  // 95 % of a half-normal distribution lie below it.
  return {0.0, rms, 0.0, kUpper * rms};
}

Repeatabilities stated_repeatabilities(const EffectSizes& sizes) {
  Repeatabilities out;
  for (const RepeatPart part : kAllRepeatParts)
    out[static_cast<std::size_t>(part)] = half_normal(stated_size(sizes, part));
  return out;
}

int StageRecord::runs() const {
  std::set<std::string> hashes;  // A run with several items is listed for each.
  for (const Learning& learning : learnings)
    for (const TeachingRun& run : learning.runs) hashes.insert(run.sha256);
  return static_cast<int>(hashes.size());
}

bool StageRecord::was_taught_by(std::string_view run_sha256) const {
  return std::ranges::any_of(learnings, [&](const Learning& learning) {
    return std::ranges::any_of(learning.runs,
                               [&](const TeachingRun& run) { return run.sha256 == run_sha256; });
  });
}

StageState state_after(const StageRecord& record, double months) {
  StageState out = record.state;
  const double growth2 = record.growth.rms * record.growth.rms * std::max(0.0, months);
  for (Eigen::Index i = 0; i < out.size(); ++i)
    out.covariance(i, i) += growth2 * std::pow(stated_size_of(record.sizes, out, i), 2);
  return out;
}

double validity_months(const StageRecord& record) {
  constexpr double kShare = 0.5;
  return std::pow(kShare / record.growth.upper, 2);
}

std::vector<std::string> differences(const StageIdentity& record, const StageIdentity& stage) {
  std::vector<std::string> out;
  const auto compare = [&](const std::string& what, const std::string& of_record,
                           const std::string& of_stage) {
    if (!of_record.empty() && !of_stage.empty() && of_record != of_stage)
      out.push_back(
          fmt::format("{}: the record is of \"{}\", this stage has \"{}\"", what, of_record, of_stage));
  };
  compare("maker", record.maker, stage.maker);
  compare("model", record.model, stage.model);
  compare("serial number", record.serial_number, stage.serial_number);
  compare("axes", record.axes, stage.axes);
  return out;
}

}  // namespace abcal
