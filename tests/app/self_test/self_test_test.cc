// The self-test of an installation, and the software validation file.
#include "app/commands/validation/self_test.h"

#include <fnmatch.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/commands/validation/requirements.h"
#include "app/commands/validation/validation_file.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(ValidationFileTest, ThePageIsWhatTheProgramPrints) {
  // Made with `abcal self-test --page > docs/validation.md`.
  EXPECT_EQ(test::read_file(test::source_folder() / "docs/validation.md"), validation_page());
}

/// Whether a source file defines a function: its name, with "(" behind it, on a line that is not indented.
bool defines(const std::string& source, const std::string& function) {
  const auto is_of_name = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; };
  std::istringstream lines(source);
  for (std::string line; std::getline(lines, line);) {
    if (line.empty() || !is_of_name(line.front())) continue;
    const std::size_t at = line.find(function + "(");
    if (at == std::string::npos || line.ends_with(';')) continue;
    if (at == 0 || (!is_of_name(line[at - 1]) && line[at - 1] != ':')) return true;
  }
  return false;
}

// That the tests execute it is verified by scripts/requirements_coverage.py.
TEST(ValidationFileTest, TheCodeOfEachRequirementIsInTheSources) {
  std::map<std::string, std::string> sources;
  const std::filesystem::path root = test::source_folder();
  for (const char* top : {"app", "drivers", "protocol", "sim"})
    for (const auto& entry : std::filesystem::recursive_directory_iterator(root / top))
      if (entry.path().extension() == ".cc")
        sources[std::filesystem::relative(entry.path(), root).string()] = test::read_file(entry.path());
  // The library for other programs has functions with the names of those that they call.
  std::erase_if(sources, [](const auto& source) { return source.first.starts_with("app/library/"); });
  ASSERT_GT(sources.size(), 100U);
  std::size_t named = 0;
  for (const RequirementSection& section : requirements()) {
    for (const Requirement& requirement : section.requirements) {
      for (const std::string& code : requirement.code) {
        ++named;
        const bool is_file = code.find('/') != std::string::npos;
        const auto count = std::ranges::count_if(sources, [&](const auto& source) {
          return is_file ? ::fnmatch(code.c_str(), source.first.c_str(), FNM_PATHNAME) == 0
                         : defines(source.second, code);
        });
        if (is_file) {
          EXPECT_GE(count, 1) << requirement.words << ": " << code;
        } else {
          EXPECT_EQ(count, 1) << requirement.words << ": " << code;
        }
      }
    }
  }
  EXPECT_GT(named, 50U);
}

TEST(ValidationFileTest, ItHasTheLastResultOfEachTest) {
  const test::TemporaryFolder folder;
  EXPECT_THROW(read_test_results(folder.path()), std::invalid_argument);
  test::write_file(folder / "a.xml", R"(<?xml version="1.0"?>
<testsuites timestamp="2026-03-01T12:00:00.000"><testsuite name="x">
<testcase classname="RodriguesTest" name="AgreesWithEigenAboutAnyAxis" status="run" result="completed"/>
<testcase classname="ControlChartTest" name="IndividualsAgreeWithTheHandbook" status="run" result="completed">
<failure message="m"/></testcase>
<testcase classname="OnBothDatabases/RegisterTest" name="ABackupIsRestoredOnEitherDatabase/Sqlite" status="run" result="completed"/>
<testcase classname="OnBothDatabases/RegisterTest" name="ABackupIsRestoredOnEitherDatabase/Postgresql" status="run" result="skipped"/>
</testsuite></testsuites>)");
  const TestResults results = read_test_results(folder.path());
  const std::vector<SelfCheck> checks{{"run", "simulated run", SelfCheck::Grade::kGood, "fine"}};
  const std::string file = validation_file({"1.0 (abc)", "2026-03-02T00:00:00Z", "host"}, checks, &results);
  EXPECT_THAT(file,
              AllOf(HasSubstr("- Program: abcal 1.0 (abc)"), HasSubstr("last run 2026-03-01T12:00:00.000"),
                    HasSubstr("| run: simulated run | good"), HasSubstr("| 1 of 5 passed; `StageModelTest."),
                    HasSubstr("`ControlChartTest.IndividualsAgreeWithTheHandbook` FAILED"),
                    Not(HasSubstr("`RegisterTest.ABackupIsRestoredOnEitherDatabase` skipped"))));
  EXPECT_THAT(validation_file({"1.0", "", ""}, checks, nullptr), HasSubstr("- Tests: not run here"));
}

class SelfTestCommand : public ProgramTest {};

TEST_F(SelfTestCommand, ChecksThisInstallationAndSaysWhatItFound) {
  const auto tested = abcal({"self-test", "--json"});
  const auto json = nlohmann::json::parse(tested.out);
  EXPECT_EQ(json["schema"], "abcal.self_test/1");
  std::size_t of_the_run = 0;
  for (const auto& check : json["checks"]) {
    of_the_run += check["group"] == "run" ? 1U : 0U;
    // Ports and disk are those of the machine on which the test runs.
    if (check["group"] == "installation") continue;
    EXPECT_EQ(check["result"], "good") << check.dump();
  }
  EXPECT_EQ(of_the_run, 4U);
  for (const char* part : {"abcal-guard", "abcal-pdf", "abcal-sign", "abcal-hdf5", "abcal-transfer",
                           "abcal-witness", "schemas"}) {
    const auto& checks = json["checks"];
    const auto found = std::find_if(checks.begin(), checks.end(),
                                    [&](const nlohmann::json& check) { return check["what"] == part; });
    ASSERT_NE(found, checks.end()) << part;
    EXPECT_EQ((*found)["result"], "good") << found->dump();
  }
}

// An installation of which parts are missing, or left over from another version.
TEST_F(SelfTestCommand, ProgramsAndSchemasThatDoNotAnswerAreFound) {
  const std::filesystem::path bin = folder / "bin", helpers = folder / "libexec/abcal",
                              schemas = folder / "share/abcal/schemas/v3.3.0";
  for (const auto& made : {bin, helpers, schemas}) std::filesystem::create_directories(made);
  const std::filesystem::path program = test::abcal_program();
  std::filesystem::copy_file(program, bin / "abcal");
  std::filesystem::copy_file(program.parent_path() / "abcal-pdf", helpers / "abcal-pdf");
  test::write_file(helpers / "abcal-sign", "#!/bin/sh\necho abcal-sign 0.0.1\n");
  std::filesystem::permissions(helpers / "abcal-sign", std::filesystem::perms::owner_all);
  test::write_file(schemas / "dcc.xsd", "no schema");
  test::Program tested((bin / "abcal").string(), {"self-test"}, folder.path());
  EXPECT_EQ(tested.wait(), 1);
  EXPECT_THAT(
      tested.out(),
      AllOf(HasSubstr("good  installation: abcal-pdf: "),
            testing::ContainsRegex("bad  installation: abcal-sign: .*found exit code 0 and .abcal-sign "
                                   "0.0.1.; required: .abcal-sign [0-9.]+ .*install abcal anew"),
            testing::ContainsRegex("bad  installation: abcal-hdf5: .*"),
            testing::ContainsRegex("bad  installation: abcal-guard: .*"),
            testing::ContainsRegex("bad  installation: schemas: .*"), HasSubstr("NOT good")));
}

TEST_F(SelfTestCommand, ARegisterThatIsNotWholeIsFound) {
  ::setenv("ABCAL_REGISTER", (folder / "none.db").c_str(), 1);
  const auto tested = abcal({"self-test"});
  ::unsetenv("ABCAL_REGISTER");
  EXPECT_EQ(tested.exit_code, 1);
  EXPECT_THAT(tested.out, AllOf(HasSubstr("installation: register: register"), HasSubstr("no such file"),
                                HasSubstr("NOT good")));
}

}  // namespace
}  // namespace abcal
