#include "app/laboratory/certificate/laboratory_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/app/certificate/certificate_fixtures.h"

namespace abcal {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

std::vector<std::string> problems_of(const std::string& text) {
  std::vector<std::string> problems;
  for (const Problem& problem : parse_laboratory_file(text, "lab.toml").problems)
    problems.push_back(to_string(problem));
  return problems;
}

TEST(LaboratoryFileTest, TheExampleIsGoodAndRead) {
  const ReadLaboratoryFile read = parse_laboratory_file(example_laboratory(), "lab.toml");
  EXPECT_THAT(read.problems, IsEmpty());
  EXPECT_EQ(read.file.laboratory.contact.name, "Example laboratory");
  EXPECT_EQ(read.file.persons.size(), 2U);
  EXPECT_EQ(read.file.equipment.size(), 3U);
  EXPECT_EQ(format_date(*read.file.equipment[0].due), "2030-12-31");
  EXPECT_EQ(read.file.decision->kind, DecisionKind::kGuardBand);
  EXPECT_EQ(read.file.limits.size(), 3U);
  EXPECT_FALSE(read.file.limits[2].lower);
  EXPECT_THAT(read.file.units, ElementsAre("mg/g_n"));
}

TEST(LaboratoryFileTest, AnEmptyFileNamesEverythingThatIsMandatory) {
  const std::vector<std::string> problems = problems_of("schema = \"abcal.laboratory/1\"\n");
  const std::string all = testing::PrintToString(problems);
  for (const char* item : {"[laboratory] name", "[laboratory] city", "[laboratory] country_code",
                           "[laboratory] street", "[customer] name", "[customer] city", "[job] condition",
                           "who may measure", "who may approve", "the angle of the stage traceable"})
    EXPECT_THAT(all, HasSubstr(item));
}

TEST(LaboratoryFileTest, AllProblemsAtOnceWithTheirLines) {
  std::string text = example_laboratory();
  text =
      replaced(text, "country_code = \"DE\"                         # ISO 3166-1", "country_code = \"XQ\"");
  text = replaced(text, "due = 2030-12-31 ", "due = \"2030-12-31\" ");
  text = replaced(text, "quantity = \"gravity\"", "quantity = \"weight\"");
  text = replaced(text, "certificate = \"EX-TEMP-11\"", "certifikate = \"EX-TEMP-11\"");
  text = replaced(text, "quantity = \"offset_w\"", "quantity = \"offset_x\"");
  const auto problems = problems_of(text);
  ASSERT_EQ(problems.size(), 6U) << testing::PrintToString(problems);
  EXPECT_THAT(problems[0], AllOf(HasSubstr("line "), HasSubstr("country_code"), HasSubstr("XQ")));
  EXPECT_THAT(problems[1], AllOf(HasSubstr("due"), HasSubstr("a date without quotes")));
  EXPECT_THAT(problems[2], AllOf(HasSubstr("quantity"), HasSubstr("weight")));
  EXPECT_THAT(problems[3], AllOf(HasSubstr("[equipment] certificate"), HasSubstr("nothing")));
  EXPECT_THAT(problems[4], AllOf(HasSubstr("certifikate"), HasSubstr("did you mean \"certificate\"")));
  EXPECT_THAT(problems[5], HasSubstr("offset_x"));
}

TEST(LaboratoryFileTest, BlanksAreNoAnswer) {
  EXPECT_THAT(problems_of(replaced(example_laboratory(), "\"no visible damage\"", "\" \"")),
              ElementsAre(HasSubstr("[job] condition")));
}

TEST(LaboratoryFileTest, OnePersonCannotMeasureAndApprove) {
  std::string text = example_laboratory();
  text = replaced(text, "may = [\"measure\"]", "may = []");
  EXPECT_THAT(problems_of(text), ElementsAre(HasSubstr("two persons: the one who measured cannot approve")));
}

TEST(LaboratoryFileTest, LimitsNeedARuleThatWasAgreed) {
  std::string text = example_laboratory();
  EXPECT_THAT(problems_of(replaced(text, "agreement = \"order ORD-17\"", "agreement = \"\"")),
              ElementsAre(HasSubstr("where the customer agreed")));
  EXPECT_THAT(problems_of(replaced(text, "rule = \"guard_band\"", "rule = \"test_uncertainty_ratio\"")),
              ElementsAre(HasSubstr("[limit] lower")));
  EXPECT_THAT(problems_of(replaced(text, "upper = 1.02", "upper = 0.9")),
              ElementsAre(HasSubstr("lower < upper")));
}

TEST(LaboratoryFileTest, WhatIsNoTomlOrNoFileIsSaid) {
  // The line that is no TOML comes first; all that the file lacks besides follows.
  EXPECT_THAT(problems_of("[laboratory"),
              Contains(HasSubstr("line 1: found \"[laboratory\"; required: a section")));
  EXPECT_THAT(problems_of("[laboratory").front(), HasSubstr("line 1"));
  EXPECT_THAT(problems_of("  \n"), ElementsAre(HasSubstr("nothing in it")));
  EXPECT_THAT(to_string(read_laboratory_file("/no/such/file.toml").problems.at(0)),
              HasSubstr("no such file"));
}

TEST(DateTest, IsoDatesOnly) {
  EXPECT_EQ(format_date(*parse_date("2026-03-01T12:00:00.000Z")), "2026-03-01");
  for (const char* text : {"", "2026", "2026-13-01", "2026-02-30", "01.03.2026", "2026-0a-01"})
    EXPECT_FALSE(parse_date(text)) << text;
}

}  // namespace
}  // namespace abcal
