// The self-test of an installation, and the software validation file.
#include "app/self_test/self_test.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "app/self_test/validation_file.h"
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
  EXPECT_THAT(
      file, AllOf(HasSubstr("- Program: abcal 1.0 (abc)"), HasSubstr("last run 2026-03-01T12:00:00.000"),
                  HasSubstr("| run: simulated run | good"), HasSubstr("| 1 of 3 passed; `ForwardModelTest."),
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
