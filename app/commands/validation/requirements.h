#pragma once

#include <string>
#include <vector>

namespace abcal {

/// A requirement of the program, the risk if it is not met, and the tests that then fail.
struct Requirement {
  std::string words, risk;
  /// Functions ("analyse_joint", "RunFile::load") and files ("drivers/*/codec.cc") that fulfil it. Each of
  /// the tests executes one of them, and each of them is executed by one of the tests
  /// (scripts/requirements_coverage.py). Empty where the requirement is about pages.
  std::vector<std::string> code;
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
