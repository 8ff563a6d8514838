#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/measure/session/bench_check.h"

namespace abcal::console {

/// The last check of a bench, kept in the run folder so that it is known after a restart.
struct LastCheck {
  std::string utc;
  std::string by;  ///< Who asked for it, in words.
  bool with_motion = false;
  std::size_t good = 0, warnings = 0, problems = 0;
};

/// Stores the outcome of a check. @return false if it cannot be stored, which does not fail the check
bool keep_check(const std::filesystem::path& runs, const std::filesystem::path& bench_file,
                const LastCheck& check);
/// The stored check of a bench; nullopt if there is none.
std::optional<LastCheck> last_check(const std::filesystem::path& runs,
                                    const std::filesystem::path& bench_file);

LastCheck count_findings(const std::vector<Finding>& findings);

}  // namespace abcal::console
