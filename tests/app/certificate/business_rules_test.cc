#include "app/laboratory/certificate/business_rules.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/app/certificate/certificate_fixtures.h"

namespace abcal {
namespace {

using testing::HasSubstr;

std::string check(const std::string& xml) {
  return to_string(check_business_rules(parse_xml(xml, "certificate")));
}

/// A hand-made certificate of this kind, not written by the program.
class BusinessRulesTest : public testing::Test {
 protected:
  void SetUp() override {
    ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/examples/abc_example_dcc_3.3.0.xml");
    xml = test::read_file(path);
  }
  /// The findings after one change.
  std::string after(const std::string& from, const std::string& to) const {
    return check(replaced(xml, from, to));
  }
  std::string xml;
};

TEST_F(BusinessRulesTest, AGoodCertificateBreaksNone) {
  EXPECT_EQ(check(xml), "");
}

TEST_F(BusinessRulesTest, EachRuleIsSeenWhenItIsBroken) {
  struct Break {
    const char *from, *to, *said;
  };
  const std::vector<Break> breaks{
      {"schemaVersion=\"3.3.0\"", "schemaVersion=\"3.2.1\"", "schemaVersion is not 3.3.0"},
      {"<dcc:city>Town<", "<dcc:city><", "empty, or blanks only"},
      {"<dcc:city>Town<", "<dcc:city> \n <", "blanks only"},
      {"<dcc:item>", "<dcc:item refId=\"nobody\">", "refId \"nobody\" is no id"},
      {"<dcc:item>", "<dcc:item id=\"lonely\">", "id \"lonely\" is referred to by no refId"},
      {"<dcc:content lang=\"en\">Serial", "<dcc:content lang=\"de\">Serial",
       "language \"de\" is not declared"},
      {"<dcc:content lang=\"en\">Serial no.</dcc:content>",
       "<dcc:content lang=\"en\">Serial no.</dcc:content><dcc:content lang=\"en\">again</dcc:content>",
       "language \"en\" appears twice"},
      {"<dcc:mandatoryLang", "<dcc:usedLangCodeISO639_1>de</dcc:usedLangCodeISO639_1><dcc:mandatoryLang",
       "no text in the declared language \"de\""},
      {"<dcc:mandatoryLang", "<dcc:usedLangCodeISO639_1>en</dcc:usedLangCodeISO639_1><dcc:mandatoryLang",
       "language \"en\" is declared twice"},
      {"<dcc:mandatoryLangCodeISO639_1>en", "<dcc:mandatoryLangCodeISO639_1>xx", "no language code"},
      {"<dcc:countryCodeISO3166_1>US", "<dcc:countryCodeISO3166_1>XQ", "no country code"},
      {"<dcc:endPerformanceDate>2026-01-07", "<dcc:endPerformanceDate>2026-01-06", "before it begins"},
      {"<si:unit>\\kelvin<", "<si:unit>\\kelvin \\metre<", "blanks in the unit"},
      {"<si:unitXMLList>\\degree<", "<si:unitXMLList>\\degree \\degree<", "2 units for 3 values"},
      {"<si:unitXMLList>\\degree<", "<si:unitXMLList>\\degree \\degree \\degree<",
       "the same unit is repeated"},
      {"s_ux s_uy s_uz", "s_ux  s_uy s_uz", "one blank between entries"},
      {"refType=\"basic_measuredValue abc_rowU\"", "refType=\" basic_measuredValue\"", "one blank between"},
      {"s_ux s_uy s_uz", "s_ux s_uy", "2 entries for 3 values"},
      {"<si:valueXMLList>90.012 89.987 90.003", "<si:valueXMLList>90.012 NaN 90.003",
       "NaN instead of a number"},
      {"<si:real><si:value>295.9</si:value><si:unit>\\kelvin</si:unit></si:real>",
       "<si:hybrid><si:real><si:value>295.9</si:value><si:unit>|old</si:unit></si:real></si:hybrid>",
       "\"|old\" is declared by no statement"},
      {"<dcc:conformity>pass</dcc:conformity>",
       "<dcc:conformity>pass</dcc:conformity><dcc:nonSIUnit>|old</dcc:nonSIUnit>", "go together"},
      {"<dcc:influenceConditions>", "<dcc:description/><dcc:usedNothing>", "influenceConditions are missing"},
  };
  for (const Break& one : breaks) {
    std::string broken = replaced(xml, one.from, one.to);
    if (std::string(one.to).find("usedNothing") != std::string::npos)
      broken = replaced(broken, "</dcc:influenceConditions>", "</dcc:usedNothing>");
    EXPECT_THAT(check(broken), HasSubstr(one.said)) << one.to;
  }
}

TEST_F(BusinessRulesTest, AllProblemsAtOnceWithTheirPlace) {
  std::string broken = replaced(xml, "<dcc:countryCodeISO3166_1>US", "<dcc:countryCodeISO3166_1>XQ");
  broken = replaced(broken, "<dcc:release>v1.0.0", "<dcc:release>1.0.0");
  const auto problems = check_business_rules(parse_xml(broken, "certificate"));
  ASSERT_EQ(problems.size(), 2U);
  EXPECT_THAT(problems[0].where, HasSubstr("coreData/dcc:countryCodeISO3166_1"));
  EXPECT_THAT(problems[1].where, HasSubstr("dcc:software/dcc:release"));
}

// Methods once for the whole measurement, or with every quantity.
TEST_F(BusinessRulesTest, MethodsOfEveryQuantityServeAsWell) {
  const auto begin = xml.find("<dcc:usedMethods>"), end = xml.find("</dcc:usedMethods>") + 18;
  const std::string methods = xml.substr(begin, end - begin);
  const std::string without = std::string(xml).erase(begin, end - begin);
  EXPECT_THAT(check(without), HasSubstr("dcc:usedMethods are missing"));
  std::string local;
  for (std::size_t at = 0;;) {
    const auto next = without.find("</si:realListXMLList></dcc:quantity>", at);
    if (next == std::string::npos) {
      local += without.substr(at);
      break;
    }
    local += without.substr(at, next + 21 - at) + methods;
    at = next + 21;
  }
  EXPECT_THAT(check(replaced(without, "</si:realListXMLList></dcc:quantity>",
                             "</si:realListXMLList>" + methods + "</dcc:quantity>")),
              HasSubstr("dcc:usedMethods are missing"));
  EXPECT_EQ(check(local).find("dcc:usedMethods"), std::string::npos) << check(local);
}

TEST_F(BusinessRulesTest, Releases) {
  for (const char* good : {"v 8.2", "A1", "v1.2.3.4"})
    EXPECT_EQ(after("<dcc:release>v1.0.0<", std::string("<dcc:release>") + good + "<"), "") << good;
  for (const char* bad : {"1.0.0", "2024b", "v1.0.0 (1a2b)", "v1234", "vv1", "v1.2.3.4.5"})
    EXPECT_THAT(after("<dcc:release>v1.0.0<", std::string("<dcc:release>") + bad + "<"), HasSubstr(bad));
}

}  // namespace
}  // namespace abcal
