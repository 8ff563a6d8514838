#pragma once

#include <functional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"

namespace abcal {

/// One check of the installed program and its finding.
struct SelfCheck {
  enum class Grade {
    kGood,
    kNote,  ///< Something is absent that not everyone needs.
    kBad,
  };
  std::string group;  ///< "installation", "method", "run"
  std::string what;
  Grade grade = Grade::kBad;
  std::string found;  ///< In words.
};

/// Checks the installation (libraries, helper programs, schemas, tools, ports, disk, clock, register and key
/// if they are configured), the method (the paper's tables, local gravity), and a simulated run: its result
/// against its truth, its verification, and that a changed byte is found. Takes less than a minute. Reads the
/// environment variables of register and key once, and then runs without them.
/// @param tell  called with each check when it is done; may be empty
std::vector<SelfCheck> run_self_test(Clock::UtcTime now, const std::function<void(const SelfCheck&)>& tell);

/// Whether no check is bad.
bool all_good(const std::vector<SelfCheck>& checks);

}  // namespace abcal
