#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "protocol/plan/rotation_plan.h"

namespace abcal::console {

/// A run that ended early and that a person may resume.
struct InterruptedRun {
  std::string file;   ///< Name in the run folder.
  std::string words;  ///< Why it ended.
  std::size_t measured = 0, planned = 0;
  std::string angle;      ///< First missing angle, in words; empty: all are measured.
  std::size_t items = 1;  ///< Number that still takes part.
};

/// @param measured  positions in the plan
InterruptedRun describe_interrupted(std::string file, std::string words,
                                    const std::vector<PlannedAngle>& plan,
                                    const std::set<std::size_t>& measured);

/// The newest run of a folder, if it ended early. The console offers to resume it after a restart of the
/// program or the computer.
std::optional<InterruptedRun> find_interrupted_run(const std::filesystem::path& folder);

}  // namespace abcal::console
