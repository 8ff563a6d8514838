// The first page of a report is for the customer: verdict, values with U, equation, one figure.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>
#include <string>

#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class FirstPageTest : public ProgramTest {
 protected:
  /// The page of a run, without its style sheet.
  std::string page_of_run(const std::string& more_of_bench = {}) {
    test::write_file(folder / "bench.toml", BenchText{}.text() + more_of_bench);
    const test::ProgramResult made = abcal({"run", "bench.toml", "-o", "a.run"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
    const test::ProgramResult report = abcal({"report", "a.run", "--html", "a.html"});
    EXPECT_EQ(report.exit_code, 0) << report.err;
    const std::string html = test::read_file(folder / "a.html");
    return html.substr(html.find("<body"));
  }
  static std::string first_section(const std::string& page) {
    const std::size_t from = page.find("<section");
    return page.substr(from, page.find("</section>") - from);
  }
};

TEST_F(FirstPageTest, HasVerdictValuesEquationDrawingAndOneFigureBeforeAllElse) {
  const std::string first = first_section(page_of_run());
  EXPECT_THAT(first, AllOf(HasSubstr("Usable (joint estimator): "), HasSubstr(" ± "),
                           HasSubstr("a = s⁻¹ (r − O)"), HasSubstr("95.45 %"), HasSubstr("glossary"),
                           HasSubstr("Deviation from an ideal accelerometer")));
  const std::size_t drawing = first.find("<figure>"), deviation = first.rfind("<figure>");
  ASSERT_NE(drawing, std::string::npos);
  EXPECT_LT(first.find("Stated mounting: u, v, w"), deviation);
  EXPECT_EQ(first.find("<figure>", drawing + 1), deviation);
}

TEST_F(FirstPageTest, NothingOnThePagesIsForTheOperator) {
  const std::string page = page_of_run();
  const auto says = [&](const char* words) { return page.find(words) != std::string::npos; };
  for (const char* words : {"so default sizes are used: ", "Not covered: ", "comes and goes"})
    EXPECT_TRUE(says(words)) << words;
  for (const char* words : {"[stage_uncertainty]", "[item_uncertainty]", "state them", "state its size"})
    EXPECT_FALSE(says(words)) << words;
}

TEST_F(FirstPageTest, NumbersAreTypesetAndNoZeroIsNegative) {
  const std::string page = page_of_run();
  const std::string text = std::regex_replace(page, std::regex("<[^>]*>"), "|");
  EXPECT_THAT(text, HasSubstr(" × 10⁻"));
  for (const char* bad : {R"([0-9]e[-+][0-9])", R"([|( ][-−]0(\.0*)?[|) ])"}) {
    std::smatch found;
    EXPECT_FALSE(std::regex_search(text, found, std::regex(bad)))
        << found.prefix().str().substr(found.prefix().length() - 60) << found.str();
  }
}

}  // namespace
}  // namespace abcal
