// The page of an issued certificate shows the calibrations that the certificate has.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class IssuedPagesTest : public testing::Test {
 protected:
  static std::string example(const char* name) {
    return test::read_file(test::source_folder() / "docs/examples" / name);
  }
  test::ProgramResult abcal(const std::vector<std::string>& words) {
    return test::run_program(words, folder.path());
  }
  /// The simulated example with few angles and readings, and with another offset of u.
  void measure(const std::string& run, const std::string& offset_u) {
    std::string bench = example("simulated.toml");
    for (const auto& [line, with] : {std::pair<std::string, std::string>{"steps = 72", "steps = 12"},
                                     {"step_deg = 5.0", "step_deg = 30.0"},
                                     {"dwell_readings = 1000", "dwell_readings = 50"},
                                     {"offset = \\[0.0054", "offset = [" + offset_u}})
      bench = std::regex_replace(bench, std::regex(line), with);
    test::write_file(folder / "bench.toml", bench);
    const test::ProgramResult result = abcal({"run", "bench.toml", "-o", run});
    ASSERT_EQ(result.exit_code, 0) << result.err;
  }

  test::TemporaryFolder folder;
};

TEST_F(IssuedPagesTest, APairIsShownWholeOrSaysThatItIsNot) {
  measure("found.run", "0.0154");
  measure("left.run", "0.0054");
  measure("other.run", "0.0055");
  test::write_file(folder / "lab.toml",
                   std::regex_replace(example("laboratory.toml"), std::regex("\ndeviations"),
                                      "\nadjustment = \"offset of u\"\ndeviations"));
  const test::TrainingRegister registered(folder.path());
  const test::ProgramResult issued =
      abcal({"issue", "left.run", "--as-found", "found.run", "--laboratory", "lab.toml", "--dcc", "a.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::string number = test::number_of(issued.out);

  const test::ProgramResult whole =
      abcal({"report", "left.run", "--as-found", "found.run", "--dcc", "b.xml"});
  EXPECT_EQ(whole.exit_code, 0) << whole.err;
  EXPECT_EQ(test::read_file(folder / "b.xml"), test::read_file(folder / "a.xml"));
  // The pages are those of the XML, which has both calibrations: with or without the option.
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{"report", "left.run", "--as-found", "found.run"}, {"report", "left.run"}}) {
    const std::string page = abcal(words).out;
    EXPECT_THAT(page, AllOf(HasSubstr(number), HasSubstr("as found"), HasSubstr("offset of u"),
                            HasSubstr("As left minus as found")));
    // Left as found but for the offset of u: differences of nothing have no sign.
    EXPECT_THAT(page, Not(testing::ContainsRegex(" [-\u2212]0\\.0+ ")));
  }

  const test::ProgramResult another =
      abcal({"report", "left.run", "--as-found", "other.run", "--html", "c.html"});
  EXPECT_EQ(another.exit_code, 1);
  EXPECT_THAT(another.err, AllOf(HasSubstr("other.run"), HasSubstr(number)));
  EXPECT_FALSE(std::filesystem::exists(folder / "c.html"));
}

}  // namespace
}  // namespace abcal
