#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "app/commands/validation/self_test.h"

namespace abcal {

/// How the tests of a version ended, by "Suite.Name".
struct TestResults {
  enum class Outcome { kPassed, kFailed, kSkipped };
  std::map<std::string, Outcome> outcomes;
  std::string last_utc;  ///< Time of the newest file; empty: no file states one.
};

/// Reads the files that GoogleTest wrote with GTEST_OUTPUT=xml:FOLDER/. A test with parameters passed if it
/// failed with none of them.
/// @throws std::invalid_argument if the folder has none
TestResults read_test_results(const std::filesystem::path& folder);

/// docs/validation.md: requirements, risks, tests.
std::string validation_page();

/// Facts that a validation file states in addition to its requirements.
struct ValidationFacts {
  std::string version, created_utc, host;
};

/// The validation file of a laboratory, in Markdown: as validation_page(), with the last result of each test
/// and the self-test of this installation.
/// @param results  null: the tests were not run
std::string validation_file(const ValidationFacts& facts, const std::vector<SelfCheck>& checks,
                            const TestResults* results);

}  // namespace abcal
