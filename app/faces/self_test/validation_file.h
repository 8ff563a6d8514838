#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "app/faces/self_test/self_test.h"

namespace abcal {

/// How the tests of a version ended, by "Suite.Name".
struct TestResults {
  enum class Outcome { kPassed, kFailed, kSkipped };
  std::map<std::string, Outcome> outcomes;
  std::string last_utc;  ///< Of the newest of the files; empty: there is none.
};

/// Reads what GoogleTest wrote with GTEST_OUTPUT=xml:FOLDER/. A test with parameters passed if it passed with
/// each of them.
/// @throws std::invalid_argument if the folder has none
TestResults read_test_results(const std::filesystem::path& folder);

/// docs/validation.md: requirements, risks, tests.
std::string validation_page();

/// What a validation file says beside its requirements.
struct ValidationFacts {
  std::string version, created_utc, host;
};

/// The validation file of a laboratory, in Markdown: as validation_page(), with the last result of each test
/// and the self-test of this installation.
/// @param results  null: the tests were not run
std::string validation_file(const ValidationFacts& facts, const std::vector<SelfCheck>& checks,
                            const TestResults* results);

}  // namespace abcal
