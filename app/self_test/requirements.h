#pragma once

#include <string>
#include <vector>

namespace abcal {

/// What the program must do, what happens if it does not, and the tests that fail then.
struct Requirement {
  std::string words, risk;
  std::vector<std::string> tests;  ///< "Suite.Name", as GoogleTest has them.
};

struct RequirementSection {
  std::string title;  ///< With the clause of ISO/IEC 17025.
  std::vector<Requirement> requirements;
};

/// The requirements of the software validation file (ISO/IEC 17025, 7.11.2). docs/validation.md is made from
/// them.
std::vector<RequirementSection> requirements();

}  // namespace abcal
