#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cfloat>
#include <charconv>
#include <cmath>
#include <limits>
#include <locale>

#include "app/certificate/dsi_list.h"
#include "app/units/dsi_unit.h"
#include "app/xml/xml_tree.h"

namespace abcal {
namespace {

TEST(DsiUnitTest, UnitsInTheNotationOfDsi) {
  EXPECT_EQ(unit_in_dsi("V").unit.text(), "\\volt");
  EXPECT_EQ(unit_in_dsi("mV/(m/s2)").unit.text(), "\\milli\\volt\\second\\tothe{2}\\metre\\tothe{-1}");
  EXPECT_EQ(unit_in_dsi("V/g_loc").unit.text(), "\\volt");
  EXPECT_EQ(unit_in_dsi("(V/V)/g_loc").unit.text(), "\\one");
  EXPECT_EQ(unit_in_dsi("degree").unit.text(), "\\degree");
  EXPECT_EQ(unit_in_dsi("m/s2/(m/s2)").unit.text(), "\\one");
  EXPECT_EQ((DsiUnit("\\volt").to_the(2) * DsiUnit("\\degree")).text(), "\\volt\\tothe{2}\\degree");
}

TEST(DsiUnitTest, UnitsOutsideTheSiAreDefined) {
  const UnitInDsi g = unit_in_dsi("g");
  EXPECT_EQ(g.unit.text(), "\\metre\\second\\tothe{-2}");
  EXPECT_EQ(g.factor, 9.80665);
  EXPECT_EQ(g.own->text(), "|g");
  EXPECT_THAT(g.definition, testing::HasSubstr("9.80665 m/s2"));
  const UnitInDsi per_g = unit_in_dsi("mV/g");
  EXPECT_EQ(per_g.own->text(), "|mV/g");
  EXPECT_DOUBLE_EQ(per_g.factor, 1.0 / 9.80665);
  EXPECT_FALSE(unit_in_dsi("V").own);
}

TEST(DsiUnitTest, WhatHasNoPhysicalUnitIsACount) {
  const UnitInDsi count = unit_in_dsi("LSB/(m/s2)");
  EXPECT_EQ(count.unit.text(), "\\second\\tothe{2}\\metre\\tothe{-1}");
  EXPECT_EQ(count.note, "1 stands for one LSB of the output.");
  EXPECT_EQ(unit_in_dsi("strange unit").unit.text(), "\\one");
}

/// A locale with a comma for the point and blanks between thousands.
class CommaPoint : public std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
  char do_thousands_sep() const override { return '.'; }
  std::string do_grouping() const override { return "\3"; }
};

TEST(DsiNumberTest, AllDigitsInAnyLocale) {
  const std::locale before = std::locale::global(std::locale(std::locale::classic(), new CommaPoint));
  for (const double value :
       {0.1, 1.0 / 3.0, -9.80101, 1e300, DBL_MAX, -DBL_TRUE_MIN, DBL_EPSILON, 123456789.0, 0.0}) {
    const std::string digits = dsi_number(value, "x");
    double read = 1.0;
    std::from_chars(digits.data(), digits.data() + digits.size(), read);
    EXPECT_EQ(read, value);
  }
  EXPECT_EQ(dsi_number(1234567.5, "x"), "1234567.5");
  std::locale::global(before);
}

TEST(DsiNumberTest, WhatIsNotFiniteIsNamed) {
  for (const double value :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    try {
      dsi_number(value, "offset of w");
      ADD_FAILURE();
    } catch (const NumberNotFinite& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr("offset of w"));
    }
  }
}

TEST(XmlTextTest, OnlyWhatXmlMayHold) {
  EXPECT_EQ(xml_safe("\u8a08 \U0001F4D0\t<&"), "\u8a08 \U0001F4D0\t<&");
  EXPECT_EQ(xml_safe("a\x01"), "a\ufffd");
  EXPECT_EQ(xml_safe("\xff"), "\ufffd");
  EXPECT_EQ(xml_safe("\xc1\x81"), "\ufffd\ufffd");  // "A" in too many bytes
  EXPECT_EQ(xml_safe("\xed\xa0\x80"), "\ufffd");    // half of a pair
  EXPECT_EQ(xml_safe("\xe8\xa8"), "\ufffd\ufffd");  // cut short
  EXPECT_EQ(one_line(" a \n\t b\r\n"), "a b");
  EXPECT_EQ(one_line(" \n"), "");
}

// docs/theory/uncertainty.md, p = 0.95, to the digits given there.
TEST(EllipsoidTest, FactorsOfTheTable) {
  const std::vector<std::pair<int, double>> table{{1, 1.960}, {2, 2.448}, {3, 2.795}, {4, 3.080},
                                                  {5, 3.327}, {6, 3.548}, {9, 4.113}, {12, 4.585}};
  for (const auto& [dimensions, factor] : table)
    EXPECT_NEAR(ellipsoid_factor(dimensions, 0.95), factor, 5.1e-4) << dimensions;
}

}  // namespace
}  // namespace abcal
