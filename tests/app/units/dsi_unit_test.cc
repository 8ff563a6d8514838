#include "app/formats/dsi_unit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace abcal {
namespace {

using ::testing::HasSubstr;

void expect_same(const UnitMeaning& a, const UnitMeaning& b) {
  EXPECT_TRUE(a.same_kind(b)) << name_of(a) << " and " << name_of(b);
  EXPECT_NEAR(a.factor, b.factor, 1e-15 * b.factor);
}

TEST(DsiUnitTest, NamesOfInstrumentsAndStringsOfCertificatesMeanTheSame) {
  expect_same(meaning_of_response_unit("V"), meaning_of_d_si("\\volt"));
  expect_same(meaning_of_response_unit("mV"), meaning_of_d_si("\\milli\\volt"));
  expect_same(meaning_of_response_unit("\u03bcV"), meaning_of_d_si("\\micro\\volt"));
  expect_same(meaning_of_response_unit("uA"), meaning_of_d_si("\\micro\\ampere"));
  expect_same(meaning_of_response_unit("m/s2"), meaning_of_d_si("\\metre\\second\\tothe{-2}"));
  EXPECT_EQ(meaning_of_response_unit("g").factor, 9.80665);
  EXPECT_TRUE(meaning_of_response_unit("mg").same_kind(metre_per_second_squared()));
  EXPECT_NEAR(meaning_of_response_unit("mg").factor, 9.80665e-3, 1e-18);
}

TEST(DsiUnitTest, ASensitivityTimesAnAccelerationIsTheResponse) {
  expect_same(meaning_of_d_si("\\volt\\second\\tothe{2}\\metre\\tothe{-1}") * metre_per_second_squared(),
              meaning_of_d_si("\\volt"));
  expect_same(
      meaning_of_d_si("\\milli\\volt\\second\\tothe{2}\\metre\\tothe{-1}") * metre_per_second_squared(),
      meaning_of_response_unit("mV"));
  expect_same(meaning_of_d_si("\\one") * metre_per_second_squared(), metre_per_second_squared());
}

TEST(DsiUnitTest, PowersTakeTheirPrefixAlong) {
  EXPECT_NEAR(meaning_of_d_si("\\milli\\metre\\tothe{2}").factor, 1e-6, 1e-21);
  EXPECT_NEAR(meaning_of_d_si("\\degree").factor, std::acos(-1.0) / 180.0, 1e-18);
}

TEST(DsiUnitTest, CountsAreAKindOfTheirOwn) {
  EXPECT_TRUE(meaning_of_response_unit("counts").same_kind(meaning_of_response_unit("LSB")));
  EXPECT_FALSE(meaning_of_response_unit("LSB").same_kind(meaning_of_response_unit("V")));
  EXPECT_FALSE(meaning_of_response_unit("R").same_kind(meaning_of_response_unit("LSB")));
}

TEST(DsiUnitTest, RefusesWhatIsNotAUnit) {
  for (const char* wrong :
       {"", "V", "\\furlong", "\\volt\\tothe{x}", "\\tothe{2}", "\\milli", "\\volt\\tothe{1e3}"}) {
    EXPECT_THROW(meaning_of_d_si(wrong), std::invalid_argument) << wrong;
  }
  try {
    meaning_of_d_si("\\volt\\furlong");
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), HasSubstr("\\furlong"));
  }
}

}  // namespace
}  // namespace abcal
