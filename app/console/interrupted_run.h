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
  std::string file;  ///< Name in the run folder.
  Message words;     ///< Why it ended.
  std::size_t measured = 0, planned = 0;
  Message angle;          ///< First missing angle, in words; empty: all are measured.
  std::size_t items = 1;  ///< Number that still takes part.
  /// Who has taken note of the interruption, and when; empty: nobody yet.
  std::string acknowledged_by{}, acknowledged_utc{};
};

/// @param measured  positions in the plan
InterruptedRun describe_interrupted(std::string file, Message words, const std::vector<PlannedAngle>& plan,
                                    const std::set<std::size_t>& measured);

/// The newest run of a folder, if it ended early. The console offers to resume it after a restart of the
/// program or the computer.
std::optional<InterruptedRun> find_interrupted_run(const std::filesystem::path& folder);

/// Stores in an interrupted run that a person has taken note of it.
/// @param who  Asker::for_record()
/// @throws RunFileError, e.g. another program measures it
void acknowledge_interrupted_run(const std::filesystem::path& run, const std::string& utc,
                                 const std::string& who);

}  // namespace abcal::console
