#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <locale>
#include <numbers>
#include <random>
#include <string>
#include <tuple>
#include <vector>

#include "app/formats/dsi_unit.h"
#include "app/formats/typed_unit.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/dsi_list.h"

namespace abcal {
namespace {

TEST(DsiUnitTest, UnitsInTheNotationOfDsi) {
  EXPECT_EQ(unit_in_dsi("V").unit.text(), "\\volt");
  EXPECT_EQ(unit_in_dsi("mV/(m/s2)").unit.text(), "\\milli\\volt\\second\\tothe{2}\\metre\\tothe{-1}");
  EXPECT_EQ(unit_in_dsi("V/g_loc").unit.text(), "\\volt");
  EXPECT_EQ(unit_in_dsi("(V/V)/g_loc").unit.text(), "\\one");
  EXPECT_EQ(unit_in_dsi("degree").unit.text(), "\\degree");
  EXPECT_EQ(unit_in_dsi("m/s2/(m/s2)").unit.text(), "\\one");
  // A sensitivity of an output in m/s2, and an acceleration per output.
  EXPECT_EQ(unit_in_dsi("(m/s2)/g_n").unit.text(), "\\one");
  EXPECT_NEAR(unit_in_dsi("(m/s2)/g_n").factor, 1.0 / 9.80665, 1e-15);
  EXPECT_EQ(unit_in_dsi("(m/s2)/mV").unit.text(), "\\metre\\second\\tothe{-2}\\milli\\volt\\tothe{-1}");
  EXPECT_EQ((DsiUnit("\\volt").to_the(2) * DsiUnit("\\degree")).text(), "\\volt\\tothe{2}\\degree");
}

TEST(DsiUnitTest, UnitsOutsideTheSiAreDefined) {
  const UnitInDsi g = unit_in_dsi("g");
  EXPECT_EQ(g.unit.text(), "\\metre\\second\\tothe{-2}");
  EXPECT_EQ(g.factor, 9.80665);
  EXPECT_EQ(g.own->text(), "|g");
  EXPECT_THAT(g.definition, testing::HasSubstr("9.80665 m/s2"));
  const UnitInDsi per_g = unit_in_dsi("mV/g_n");
  EXPECT_EQ(per_g.own->text(), "|mV/g_n");
  EXPECT_DOUBLE_EQ(per_g.factor, 1.0 / 9.80665);
  // A limit per local gravity is a sensitivity, whose unit needs the value of local gravity.
  const UnitInDsi per_local = unit_in_dsi("V/g_loc", 9.81);
  EXPECT_EQ(per_local.own->text(), "|V/g_loc");
  EXPECT_EQ(per_local.unit.text(), "\\volt\\second\\tothe{2}\\metre\\tothe{-1}");
  EXPECT_DOUBLE_EQ(per_local.factor, 1.0 / 9.81);
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

TEST(DsiNumberTest, TwelveDigitsInAnyLocale) {
  const std::locale before = std::locale::global(std::locale(std::locale::classic(), new CommaPoint));
  EXPECT_EQ(dsi_number(0.1, "x"), "0.1");
  EXPECT_EQ(dsi_number(23.15 + 273.0, "x"), "296.15");  // 296.15 to the last bit is 296.14999999999998
  EXPECT_EQ(dsi_number(-9.80101, "x"), "-9.80101");
  EXPECT_EQ(dsi_number(1.0 / 3.0, "x"), "0.333333333333");
  EXPECT_EQ(dsi_number(1234567.5, "x"), "1234567.5");
  EXPECT_EQ(dsi_number(-0.0, "x"), "0");
  EXPECT_EQ(rounded_value(1234.5678, 0.125, "x").value, "1234.57");
  std::locale::global(before);
}

// Two significant digits of U, the value to the same place (ILAC-P14); zeros at the end are digits.
TEST(RoundedValueTest, TheValueHasThePlaceOfTheUncertainty) {
  const auto expect = [](double value, double expanded, const std::string& text, const std::string& u,
                         int place) {
    const RoundedValue rounded = rounded_value(value, expanded, "x");
    EXPECT_EQ(rounded.value, text);
    EXPECT_EQ(rounded.expanded, u);
    EXPECT_EQ(rounded.place, place);
  };
  expect(1.002119, 0.00012345, "1.00212", "0.00012", -5);
  expect(10.002782999999999, 0.0014, "10.0028", "0.0014", -4);
  expect(1.0020001, 0.00020, "1.00200", "0.00020", -5);
  expect(-0.0000001, 0.0012, "0.0000", "0.0012", -4);
  expect(90.0012, 0.0996, "90.00", "0.10", -2);  // 0.0996 is 0.10 in two digits
  expect(1.23456e-5, 4.5e-7, "1.235e-05", "4.5e-07", -8);
  expect(-1.5e-8, 3.0e-6, "0", "3.0e-06", -7);
  expect(9.9996e-6, 1.0e-8, "1.0000e-05", "1.0e-08", -9);
  expect(123456.0, 1234.0, "1.235e+05", "1.2e+03", 2);
}

TEST(RoundedValueTest, WithoutUncertaintyThereIsNoPlace) {
  EXPECT_EQ(rounded_value(1.5, 0.0, "x").value, "1.5");
  EXPECT_FALSE(rounded_value(1.5, 0.0, "x").place);
  EXPECT_THROW(rounded_value(1.0, -1.0, "x"), std::invalid_argument);
}

// Whatever the sizes: the text is within half of the last digit.
TEST(RoundedValueTest, RoundingIsWithinHalfOfTheLastDigit) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> mantissa(1.0, 10.0), exponent(-30.0, 30.0), sign(-1.0, 1.0);
  for (int i = 0; i < 20'000; ++i) {
    const double expanded = mantissa(random) * std::pow(10.0, std::floor(exponent(random)));
    const double value = sign(random) * expanded * std::pow(10.0, 5.0 * std::abs(sign(random)));
    const RoundedValue rounded = rounded_value(value, expanded, "x");
    const double half = 0.5 * std::pow(10.0, *rounded.place) * (1.0 + 1e-9);
    EXPECT_LE(std::abs(std::stod(rounded.value) - value), half) << value << " " << rounded.value;
    EXPECT_LE(std::abs(std::stod(rounded.expanded) - expanded), half) << expanded << " " << rounded.expanded;
  }
}

// The same output, per four accelerations.
TEST(TypedUnitTest, AUnitIsAnOutputAndWhatItIsPer) {
  for (const auto& [name, output, per] : std::vector<std::tuple<std::string, std::string, PerAcceleration>>{
           {"mV", "mV", PerAcceleration::kNone},
           {"mV/(m/s2)", "mV", PerAcceleration::kSi},
           {"mV/g_n", "mV", PerAcceleration::kStandard},
           {"(mV/V)/g_loc", "mV/V", PerAcceleration::kLocal},
           {"m/s2/(m/s2)", "m/s2", PerAcceleration::kSi},
           {"g/g", "g", PerAcceleration::kUnnamed},
           {"m/s2", "m/s2", PerAcceleration::kNone}}) {
    EXPECT_EQ(typed_unit(name).output, output);
    EXPECT_EQ(typed_unit(name).per, per) << name;
  }
  EXPECT_EQ(typed_unit("(mV/V)/g_loc").name(), "(mV/V)/g_loc");
  std::vector<std::string> readings;
  for (const TypedUnit& reading : readings_of(typed_unit("mg/g"))) readings.push_back(reading.name());
  EXPECT_THAT(readings, testing::ElementsAre("mg/g_n", "mg/g_loc"));
  EXPECT_EQ(readings_of(typed_unit("mg/g_n")).size(), 1U);
}

// 5.8e-4 between standard and local gravity, which is some 70 times the uncertainty of a sensitivity.
TEST(TypedUnitTest, UnitsOfOneKindHaveARatio) {
  constexpr double kGLoc = 9.80101;
  EXPECT_EQ(ratio_of_units("g/g_loc", "g/g_loc", kGLoc), 1.0);
  EXPECT_DOUBLE_EQ(*ratio_of_units("g/g_loc", "mg/g_n", kGLoc), 1e3 * 9.80665 / 9.80101);
  EXPECT_DOUBLE_EQ(*ratio_of_units("V/g_n", "mV/(m/s2)", kGLoc), 1e3 / 9.80665);
  EXPECT_DOUBLE_EQ(*ratio_of_units("degree", "mrad", kGLoc), std::numbers::pi / 0.18);
  EXPECT_FALSE(ratio_of_units("V", "V/g_n", kGLoc));
  EXPECT_FALSE(ratio_of_units("V/g_n", "LSB/g_n", kGLoc));
  EXPECT_FALSE(ratio_of_units("degree", "%", kGLoc));
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
